"""Simulated walking, effects, detectability, and case folders of the blind bank."""

import json
from dataclasses import replace

import numpy as np
import pytest

from validation.blind.anatomy import COORDINATES
from validation.blind.case import find_amount, make_case
from validation.blind.effects import EFFECTS
from validation.blind.families import FAMILIES, activate
from validation.blind.library import Library, imitations, ties
from validation.blind.noise import EMG_LEVELS, moment_noise
from validation.blind.oracle import cycles, difference, flat, oracles
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import bursts, draw_person
from validation.blind.plan import Bank, PlannedCase, bank_of, plan_cases, with_targets
from validation.blind.seal import digest
from validation.blind.world import joint_moments, record
from validation.blind.worlds import WORLDS
from wrapjax.subject.subject import load_subject

BANK = Bank("development", 9, 4, 4, 2, 2, 2)
#: Effects that need few OpenSim computations.
QUICK = ("slow_fibers", "missing_drive", "emg_drift", "joint_damping", "ankle_foot_orthosis")
LEVEL = EMG_LEVELS[1]


@pytest.fixture(scope="module")
def who():
    return draw_person("somebody", (5, 0, 1), WORLDS["thelen"], paretic=True)


@pytest.fixture(scope="module")
def base(who):
    return record(who.world)


@pytest.fixture(scope="module")
def oracle(who):
    return oracles(who.world, (LEVEL,))


@pytest.fixture(scope="module")
def library(who, oracle):
    entries = [(EFFECTS[name], EFFECTS[name].variants(who.world)[0]) for name in QUICK]
    signals = np.stack(
        [flat(who.world, difference(who.world, e, 0.4 * e.most, v)[1]) for e, v in entries], axis=1
    )
    reach = np.sqrt(np.einsum("ij,ij->j", signals, oracle[LEVEL].whiten(signals))) / 0.4
    return Library(tuple((e.id, v) for e, v in entries), signals, np.tile(reach, (3, 1)))


@pytest.mark.slow
def test_a_person_walks_once_more_with_the_same_muscles_and_habits(who):
    """For pairs of conditions: other cycles, and nothing else."""
    again = draw_person("somebody", (5, 0, 1), WORLDS["thelen"], paretic=True, session=(5, 5, 1))
    assert again.nominal == who.nominal and again.world.leg == who.world.leg
    for name, values in vars(who.world.muscles).items():
        np.testing.assert_array_equal(getattr(again.world.muscles, name), values, err_msg=name)
    first, second = (one.world.walk.angles.mean(axis=-1) for one in (who, again))
    np.testing.assert_allclose(first, second, atol=np.radians(1.5))
    assert np.abs(who.world.walk.phase - again.world.walk.phase).max() > 0.02
    peaks = [np.percentile(one.world.drive, 99.5, axis=(0, 2)) for one in (who, again)]
    np.testing.assert_allclose(np.log(peaks[1] / peaks[0]), 0.0, atol=0.4)
    assert np.abs(peaks[1] / peaks[0] - 1.0).max() > 1e-3


def test_moments_are_in_the_range_of_walking(who):
    """Compare with wide ranges of recorded walkers at 0.5 to 1.3 m/s: peaks in N m/kg."""
    world = who.world
    used = slice(500, 6000)
    moments = joint_moments(world)[..., used] / world.leg.mass
    ranges = {
        "hip_flexion_r": ((-1.3, -0.25), (0.4, 1.7)),
        "hip_adduction_r": ((-1.8, -0.5), (0.0, 0.8)),
        "knee_angle_r": ((-1.4, -0.25), (0.05, 0.8)),
        "ankle_angle_r": ((-1.8, -0.8), (-0.05, 0.4)),
    }
    for name, ((least, low), (high, most)) in ranges.items():
        values = moments[:, COORDINATES.index(name)]
        assert least < values.min() < low, name
        assert high < values.max() < most, name


def test_cycle_noise_is_in_the_recorded_range(who):
    """Compare with recorded walkers: 4 to 10 N m at hip, knee and ankle, 1 to 3 N m elsewhere."""
    world = who.world
    recorded = joint_moments(world) + moment_noise(world.walk, world.leg.mass, np.random.default_rng(3))
    for recording, pairs in enumerate(cycles(world)):
        times = [np.linspace(start, end, 101) for start, end in pairs]
        same = np.array([[np.interp(t, world.walk.time, row) for row in recorded[recording]] for t in times])
        apart = np.sqrt(same.var(axis=0, ddof=1).mean(axis=1))
        assert np.all(apart > [2.5, 2.5, 0.8, 2.5, 2.5, 0.7])
        assert np.all(apart < [11, 11, 5, 11, 11, 5])


def test_emg_bursts_are_at_typical_phases(who):
    world = who.world
    phase = world.walk.phase[1] % 1.0
    soleus, tibialis, vasti = world.drive[1, 10], world.drive[1, 11], world.drive[1, 8]
    assert soleus[(phase > 0.3) & (phase < 0.5)].mean() > 4 * soleus[phase > 0.7].mean()
    assert tibialis[phase > 0.85].mean() > 1.5 * tibialis[(phase > 0.3) & (phase < 0.5)].mean()
    assert vasti[phase < 0.2].mean() > 2 * vasti[(phase > 0.6) & (phase < 0.75)].mean()
    assert bursts(world.walk).min() > 0.0 and world.drive.min() >= 0.0


def test_moments_follow_inverse_dynamics(who):
    world = who.world
    away = joint_moments(world) - world.inverse
    assert np.sqrt((away[..., 500:6000] ** 2).mean(axis=(0, 2))).max() < 0.25 * world.leg.mass
    mine, theirs = joint_moments(world), world.inverse
    correlation = [np.corrcoef(mine[:, k].ravel(), theirs[:, k].ravel())[0, 1] for k in (0, 1, 3, 4)]
    assert min(correlation) > 0.9


@pytest.mark.parametrize("name", QUICK)
def test_quick_effects_vanish_at_zero(who, base, name):
    effect = EFFECTS[name]
    changed = record(effect.apply(who.world, 0.0, effect.variants(who.world)[0]))
    assert np.array_equal(changed.emg, base.emg) and np.array_equal(changed.pose, base.pose)
    assert np.allclose(changed.moments, base.moments, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in {**EFFECTS, **OUTSIDE} if n != "bound_pressure"])
def test_all_effects_vanish_at_zero_and_are_finite(who, base, name):
    effect = {**EFFECTS, **OUTSIDE}[name]
    for variant in effect.variants(who.world):
        still = record(effect.apply(who.world, 0.0, variant))
        assert np.abs(still.moments - base.moments).max() < 1e-4
        strong = record(effect.apply(who.world, effect.most, variant))
        assert np.isfinite(strong.moments).all()


def test_amount_reaches_target_d_star(who, oracle, library):
    effect = EFFECTS["ankle_foot_orthosis"]
    effect_size, reached = find_amount(who.world, oracle[LEVEL], effect, (), 1, 6.0, None)
    assert 5.2 < reached < 6.8 and 0.0 < effect_size < effect.most


def test_d_star_excludes_what_calibration_absorbs(who, oracle):
    """Compare a signal that an EMG gain absorbs with one of equal size at a joint."""
    world = who.world
    gain = record(replace(world, muscles=replace(world.muscles, scale=world.muscles.scale * 1.05)))
    absorbed = flat(world, gain.moments - record(world).moments)
    assert np.sqrt(absorbed @ oracle[LEVEL].whiten(absorbed)) < 0.5
    rms = np.sqrt(np.mean(absorbed**2))
    _, spring = difference(world, EFFECTS["joint_damping"], 1.0, ())
    spring = flat(world, spring)
    spring *= rms / np.sqrt(np.mean(spring**2))
    assert np.sqrt(spring @ oracle[LEVEL].whiten(spring)) > 1.0


def test_ties_are_mutual(who, oracle, library):
    """Check that a weak effect is tied with all others and a strong one with none."""
    world = who.world
    _, strong = difference(world, EFFECTS["ankle_foot_orthosis"], 3.0, ())
    strong = flat(world, strong)
    known = {name for name, _ in library.entries} - {"ankle_foot_orthosis"}

    def tied(seen):
        return set(ties(imitations(library, oracle[LEVEL], "ankle_foot_orthosis", seen))) & known

    assert not tied(strong)
    assert tied(1e-3 * strong) == known


def test_activation_dynamics_of_families():
    """Check rise time, the fall about four times as slow, and the range 0 to 1."""
    step = 0.002
    pulse = np.zeros((1, 1, 1000))
    pulse[..., 100:500] = 1.0
    for family in FAMILIES.values():
        a = activate(family, pulse, np.array([[0.02]]), np.array([[4.0]]), step)[0, 0]
        up = np.argmax(a > 0.63) - 100
        down = np.argmax(a[500:] < 0.37)
        assert 0.008 < up * step < 0.04 and 1.8 < down / up < 7.0, family.name
        assert a.min() >= 0.0 and a.max() <= 1.0 + 1e-9


def _case(who, oracle, library, folder, order, tier, causes):
    signs, targets = (1,) * len(causes), (6.0,) * len(causes)
    identity = f"{order:012d}"
    planned = PlannedCase(order, identity, 0, tier, LEVEL, causes, signs, targets, "above_5")
    make_case(BANK, planned, who, library, oracle, folder)
    return identity


def test_cases_differ_in_signals_only(who, oracle, library, tmp_path):
    """Check that names, sizes and time stamps are equal in all cases, and no file contains a cause."""
    causes = [(), (("ankle_foot_orthosis", ()),), (("emg_drift", ("Soleus",)),)]
    library = replace(
        library, entries=tuple((n, ("Soleus",) if n == "emg_drift" else v) for n, v in library.entries)
    )
    names = [
        _case(who, oracle, library, tmp_path, order, "single" if some else "none", some)
        for order, some in enumerate(causes)
    ]
    listings = []
    for name in names:
        root = tmp_path / "cases" / name
        files = [path for path in sorted(root.rglob("*")) if path.is_file()]
        stats = [(path.relative_to(root).as_posix(), path.stat()) for path in files]
        listings.append([(place, stat.st_size, int(stat.st_mtime)) for place, stat in stats])
        whole = b"".join(path.read_bytes() for path in files).decode()
        assert not any(word in whole for word in EFFECTS)
    assert listings[0] == listings[1] == listings[2]
    truth = json.loads((tmp_path / "truth" / f"{names[1]}.json").read_text())
    assert truth["causes"][0]["parameters"].keys() == {"dorsiflexion_stiffness"}
    assert 5.0 < truth["d_star"] < 7.0 and 0 < truth["floor_Nm2"]["held_out_speed"] < 100

    assert len(load_subject(tmp_path / "cases" / names[0]).recordings) == 5  # trials by speed and use

    again = tmp_path / "again"
    _case(who, oracle, library, again, 1, "single", causes[1])
    for part in ("cases", "truth"):
        paths = [p for p in (again / part).rglob("*") if p.is_file()]
        assert paths and all(
            digest(p) == digest(tmp_path / part / p.relative_to(again / part)) for p in paths
        )


def test_plans_are_balanced_and_match_strata():
    bank = bank_of("test")
    variants = {name: (("a",), ("b",)) for name in {**EFFECTS, **OUTSIDE}}
    planned = plan_cases(bank, variants)
    assert planned == plan_cases(bank, variants)
    single = [case for case in planned if case.tier == "single"]
    counts = np.unique([case.causes[0][0] for case in single], return_counts=True)[1]
    assert counts.max() <= 0.05 * len(single) and counts.size == len(EFFECTS) >= 30
    assert len({case.person for case in planned}) == 40
    assert len({cause for case in planned if case.tier == "outside" for cause, _ in case.causes}) == 12
    entries = tuple((name, v) for name in EFFECTS for v in variants[name])
    reach = np.tile(np.linspace(1.0, 40.0, len(entries)), (3, 1))
    library = Library(entries, np.zeros((1, len(entries))), reach)
    single = [c for c in with_targets(bank, planned, dict.fromkeys(range(40), library)) if c.tier == "single"]
    targets = np.array([case.targets[0] for case in single])
    assert np.mean(targets > 5) == pytest.approx(0.5, abs=0.01)
    assert np.mean((targets > 2) & (targets < 5)) == pytest.approx(0.3, abs=0.01)
    # Sorted by id, cases of all tiers are mixed.
    listed = [case.tier for case in sorted(planned, key=lambda case: case.id)]
    for tier in ("single", "none", "outside", "pair"):
        assert np.mean([kind == tier for kind in listed[:360]]) == pytest.approx(
            listed.count(tier) / 720, abs=0.06
        )
