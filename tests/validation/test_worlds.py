"""The eight development worlds of the blind bank, and that the other banks are as before."""

import hashlib
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from validation.blind import gait
from validation.blind.__main__ import main
from validation.blind.anatomy import CHANNELS, COORDINATES, reference_leg
from validation.blind.background import background_of, with_background
from validation.blind.effects import EFFECTS
from validation.blind.families import BANKS, FAMILIES
from validation.blind.folder import write_folder
from validation.blind.library import Library
from validation.blind.make import variants_of
from validation.blind.noise import noisy_envelopes
from validation.blind.oracle import cycles, signal
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import _with_hidden_errors, draw_person
from validation.blind.plan import BANK_SIZES, Bank, bank_of, banks_of, plan_cases, settings_of, with_targets
from validation.blind.world import record
from validation.blind.worlds import USUAL_EMG, WORLDS, GeometrySettings, default_world
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def people():
    """Draw one person of a world with short walks, once."""
    drawn = {}

    def person(name):
        if name not in drawn:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(gait, "DURATION", 6.0)
                drawn[name] = draw_person("one", (WORLDS[name].seed, 0, 1), WORLDS[name], paretic=True)
        return drawn[name]

    return person


def test_worlds_differ_and_the_first_two_are_those_of_the_development_bank():
    assert len(WORLDS) == 8 == len({world.seed for world in WORLDS.values()})
    assert not {world.seed for world in WORLDS.values()} & {bank.seed for bank in BANK_SIZES.values()}
    plain = [replace(world, name="", seed=0, summary="") for world in WORLDS.values()]
    assert len(set(plain)) == 8
    assert plain[:2] == [replace(default_world(family), name="") for family in BANKS["development"]]
    families = {world.family for world in WORLDS.values()}
    assert families == {"thelen", "spline", "polynomial", "gordon"} and families.isdisjoint(BANKS["test"])
    channels = [len(CHANNELS) - len(world.emg.unrecorded) for world in WORLDS.values()]
    assert min(channels) == 9 and len(set(channels)) == 3
    assert all(set(world.emg.unrecorded) < set(CHANNELS) for world in WORLDS.values())


@pytest.mark.parametrize(
    ("name", "expected"),
    [("test", "341b67af009cc795"), ("second_test", "41ebbc4bc51b66e1"), ("development", "dfb292047525fd0a")],
)
def test_plans_of_other_banks_are_unchanged(name, expected):
    """Compare with hashes from before the worlds; an effect added to the simulator changes them."""
    bank = bank_of(name)
    planned = plan_cases(bank, variants_of(settings_of(bank, 0)))
    # Fields of a planned case are printed exactly.
    assert hashlib.sha256(repr(planned).encode()).hexdigest()[:16] == expected


def test_default_settings_draw_as_before():
    """Compare draws with the formulas from before the worlds."""
    rng, again = np.random.default_rng(4), np.random.default_rng(4)
    leg = reference_leg(70.0, 1.72)
    first = _with_hidden_errors(leg, rng, GeometrySettings()).muscles[0].points[0][1]
    assert first == tuple(np.array(leg.muscles[0].points[0][1]) + 0.0012 * again.standard_normal(3))
    emg = np.abs(np.sin(np.arange(2000) / 300.0))[None, None]
    # The generator is at the same place only if nothing else was drawn.
    points = sum(len(muscle.points) for muscle in leg.muscles) - 1
    again = np.random.default_rng(4)
    again.standard_normal(3 * (1 + points))
    [(again.standard_normal(), again.standard_normal(3)) for _ in leg.cylinders]
    burst, pause = (gait.smooth_noise(again, emg.shape, 0.030 * gait.RATE) for _ in range(2))
    noisy = np.abs(emg * (1.0 + 0.1 * burst) + 0.10 * 0.1 * pause)
    expected = np.maximum(gait.lowpass(noisy, 6.0, gait.RATE), 0.0)
    assert np.array_equal(noisy_envelopes(emg, 0.1, rng), expected)


@pytest.mark.parametrize("name", ["polynomial", "gordon"])
def test_curves_of_new_families(name):
    family = FAMILIES[name]
    curves, length = family.curves(), np.linspace(0.3, 1.9, 321)
    active, passive = curves.active(length), curves.passive(length)
    assert active.max() == pytest.approx(1.0, abs=0.01) and 0.9 < length[active.argmax()] < 1.1
    assert active.min() >= -1e-6 and active[[0, -1]].max() < 0.01
    assert np.all(np.diff(passive) >= 0.0) and curves.passive(np.array(1.0)) < 0.02
    velocity = curves.velocity(np.linspace(-1.0, 1.0, 201))
    assert np.all(np.diff(velocity) >= 0.0) and velocity[0] < 0.05 and 1.2 < velocity[-1] < 1.8
    assert curves.velocity(np.array(0.0)) == pytest.approx(1.0, abs=0.01)
    for bend in (0.0, 0.3, 0.6):
        bent = family.shape(np.linspace(0.0, 1.5, 151), np.array(bend))
        assert bent[0] == 0.0 and bent[100] == pytest.approx(1.0) and np.all(np.diff(bent) > 0.0)


def test_cases_are_spread_evenly_over_worlds():
    banks = banks_of("worlds", 160)
    assert [bank.world for bank in banks] == list(WORLDS)
    assert all((b.none, b.single, b.outside, b.pair, b.people) == (7, 9, 2, 2, 6) for b in banks)
    planned = [plan_cases(bank, variants_of(WORLDS[bank.world])) for bank in banks]
    assert len({case.id for part in planned for case in part}) == 160
    people = [{case.person for case in part} for part in planned]
    assert len(set.union(*people)) == sum(map(len, people)) == 48
    # Together, worlds have every effect two or three times.
    single = [case.causes[0][0] for part in planned for case in part if case.tier == "single"]
    assert set(np.unique(single, return_counts=True)[1]) <= {2, 3} and set(single) == set(EFFECTS)
    for bank, part in zip(banks, planned, strict=True):
        settings = WORLDS[bank.world]
        assert {case.level for case in part} == set(settings.emg.levels)
        words = {word for case in part for _, variant in case.causes for word in variant}
        assert not words & set(settings.emg.unrecorded)
    # A world is the same without the others, and sums to the whole with an uneven number.
    assert banks_of("worlds", 160, "stiff_knee") == banks[4:5]
    assert sum(len(bank) for bank in banks_of("worlds", 163)) == 163


def test_single_causes_are_never_below_2():
    bank = replace(banks_of("worlds", 160)[3], single=40)
    variants = variants_of(WORLDS[bank.world])
    entries = tuple((name, variant) for name in EFFECTS for variant in variants[name])
    # Half of the effects are too weak for every stratum.
    reach = np.array([2.0 if list(EFFECTS).index(name) % 2 else 30.0 for name, _ in entries])
    library = Library(entries, np.zeros((1, len(entries))), np.tile(reach, (3, 1)))
    planned = with_targets(bank, plan_cases(bank, variants), dict.fromkeys(bank.persons, library))
    single = [case for case in planned if case.tier == "single"]
    assert [case.stratum for case in single].count("above_5") == 28
    assert all(case.targets[0] > 2.0 for case in single) and len(single) == 40
    assert all(reach[entries.index(case.causes[0])] > 8.0 for case in single)
    assert all(case.person % 2 for case in single if EFFECTS[case.causes[0][0]].paretic_only)


@pytest.mark.parametrize("arguments", [("--bank", "worlds", "--cases", "20"), ("--world", "thelen")])
def test_impossible_banks_are_refused(arguments, tmp_path, capsys):
    assert main(["make", *arguments, "--out", str(tmp_path / "bank")]) == 1
    assert "worlds" in capsys.readouterr().err and not (tmp_path / "bank").exists()


_QUICK = ("gross_misfit",)


@pytest.mark.parametrize(
    "name", [name if name in _QUICK else pytest.param(name, marks=pytest.mark.slow) for name in WORLDS]
)
def test_each_world_makes_a_valid_folder(name, people, tmp_path):
    who, settings = people(name), WORLDS[name]
    found = record(with_background(who.world, background_of(who, (1, 2))))
    recorded = {"moments": found.moments, "emg": found.emg, "pose": found.pose, "ground": found.ground}
    emg, calibration = settings.emg, settings.gait.calibration
    used = cycles(who.world)
    folder = tmp_path / "case"
    write_folder(
        folder, who.nominal, True, who.world.walk.speeds, used, recorded, calibration, emg.unrecorded
    )
    written = tomllib.loads((folder / "subject.toml").read_text(encoding="utf-8"))
    assert list(written["emg"]["channels"]) == [c for c in CHANNELS if c not in emg.unrecorded]
    assert {trial["speed_m_s"] for trial in written["trial"]} == set(who.world.walk.speeds)
    subject = load_subject(folder)
    assert len(subject.recordings) == len(written["trial"])
    driven = {muscle for group in written["emg"]["channels"].values() for muscle in group}
    assert len(driven) == 19 - sum(len(CHANNELS[channel]) for channel in emg.unrecorded)
    forward = np.ptp(who.world.walk.pose[:, 3], axis=-1)
    assert np.all((forward > 2.0) == settings.gait.overground)
    assert np.all(np.isfinite(found.moments)) and np.abs(found.moments).max() < 4.0 * who.world.leg.mass


def test_effects_on_unrecorded_channels_have_no_signal(people):
    world = people("knee_and_ankle_emg").world
    missing = list(CHANNELS).index("GlutMed")

    def louder(now, emg):
        out = emg.copy()
        out[:, missing] *= 2.0
        return out

    assert not np.abs(signal(replace(world, recorded_emg=(louder,)), world)).any()


def test_unmodelled_moments_are_large_and_equal_in_all_cycles(people):
    who = people("gross_misfit")
    plain = replace(who, world=replace(who.world, settings=default_world("gordon")))
    assert background_of(plain, (1, 2)) is None
    unmodelled = replace(WORLDS["gross_misfit"], geometry=GeometrySettings())
    alone = replace(who, world=replace(who.world, settings=unmodelled))
    rest = background_of(alone, (1, 2)).moments
    assert np.array_equal(rest, background_of(alone, (1, 2)).moments)
    assert not np.allclose(rest, background_of(alone, (1, 3)).moments, atol=1.0)
    rms = np.sqrt((rest**2).mean(axis=(0, 2)))
    assert rms.shape == (len(COORDINATES),) and np.all((rms >= 8.0) & (rms <= 12.0))
    walk = who.world.walk
    phases = np.linspace(0.0, 1.0, 50)
    for recording in range(3):
        whole = np.arange(np.ceil(walk.phase[recording, 0]), np.floor(walk.phase[recording, -1]))
        curves = [
            [np.interp(first + phases, walk.phase[recording], row) for row in rest[recording]]
            for first in whole
        ]
        assert len(curves) > 1 and np.ptp(curves, axis=0).max() < 1.0


def test_faulty_laboratory_has_a_raised_channel(people):
    who = people("faulty_laboratory")
    emg = background_of(who, (1, 2)).emg
    raised = emg[1, list(CHANNELS).index("Soleus")]
    assert np.all(raised == 0.06) and emg.sum() == pytest.approx(raised.sum())


def test_stiff_knee_bends_less_than_others(people):
    stiff, other = (np.ptp(people(name).world.walk.angles[:, 3]) for name in ("stiff_knee", "gross_misfit"))
    assert stiff < 0.75 * other
    assert (
        max(people("stiff_knee").world.walk.speeds) < min(people("gross_misfit").world.walk.speeds[:2]) + 0.2
    )


def test_same_seed_draws_the_same_person(people):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait, "DURATION", 6.0)
        again = draw_person("one", (WORLDS["gross_misfit"].seed, 0, 1), WORLDS["gross_misfit"], paretic=True)
    assert np.array_equal(again.world.drive, people("gross_misfit").world.drive)
    assert again.nominal == people("gross_misfit").nominal


def test_baseline_noise_raises_pauses():
    emg = np.zeros((1, 1, 4000))
    noisy = replace(USUAL_EMG, baseline=0.05)
    loud, quiet = (noisy_envelopes(emg, 0.1, np.random.default_rng(1), s).mean() for s in (noisy, USUAL_EMG))
    assert loud > 4.0 * quiet > 0.0


def test_outside_mechanisms_of_worlds_avoid_unrecorded_channels():
    variants = variants_of(WORLDS["knee_and_ankle_emg"])
    assert ("GlutMed",) not in variants["potentiation"] and variants["potentiation"]
    assert all(variants[name] for name in {**EFFECTS, **OUTSIDE})
    assert Bank("test", 1, 4, 1, 1, 1, 1).persons == range(4)
