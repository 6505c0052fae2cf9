"""Known errors added to recordings, and the summary of their diagnoses."""

import re
import shutil
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from validation.recorded import __main__ as recorded
from validation.recorded import knock_outs as knock_outs_module
from validation.recorded.manipulations import (
    Manipulation,
    knock_outs,
    manipulations_of,
    with_crosstalk,
    with_delay,
    with_drift,
    with_exchanged,
    with_filter,
    with_gain,
    with_late_forces,
    with_lost_channel,
    with_moved_pressure,
    with_offset,
    with_skin_slide,
    with_spring,
    with_wrong_mass,
    write_manipulation,
)
from validation.recorded.recordings import Recording, read_recordings
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, read_storage

TIME = np.linspace(1.0, 2.0, 201)
EMG = ("Sol", "TibAnt")


def table(columns, values, in_degrees=False):
    return Storage("table", tuple(columns), TIME, np.stack(values, axis=1), in_degrees)


def recording(order, speed, **tables):
    return Recording(speed, ((1.0, 2.0),), (order,), **{"forces": None, **tables}, files={})


@pytest.fixture
def cycles():
    """Build two cycles for each of two speeds, with a rising channel and a constant one."""
    emg = table(EMG, [TIME, np.ones_like(TIME)])
    moments = table(["ankle_angle_l_moment"], [np.sin(40.0 * TIME)])
    angles = table(["ankle_angle_l"], [np.full_like(TIME, 10.0)], in_degrees=True)
    return [
        recording(order, speed, emg=emg, moments=moments, angles=angles)
        for order, speed in ((0, 0.5), (1 / 3, 0.5), (2 / 3, 0.8), (1, 0.8))
    ]


def inner(cycle, channel="Sol"):
    """Return a channel without the ends, where shifted values are extrapolated."""
    return cycle.emg.values[20:-20, EMG.index(channel)]


def test_delays_differ_by_speed_with_zero_mean(cycles):
    slow, _, _, fast = with_delay(cycles, 0.040)
    assert inner(slow) == pytest.approx(TIME[20:-20] - 0.020)
    assert inner(fast) == pytest.approx(TIME[20:-20] + 0.020)


def test_drift_is_a_ramp_over_cycles_in_one_channel(cycles):
    found = with_drift(cycles, "Sol", 0.6)
    assert [c.emg.values[0, 0] / TIME[0] for c in found] == pytest.approx([0.7, 0.9, 1.1, 1.3])
    assert all((inner(c, "TibAnt") == 1.0).all() for c in found)


def test_crosstalk_adds_the_recorded_signal(cycles):
    first = with_crosstalk(cycles, "Sol", "TibAnt", 0.3)[0]
    assert inner(first, "TibAnt") == pytest.approx(1.0 + 0.3 * TIME[20:-20])
    assert (inner(first) == TIME[20:-20]).all()


def test_spring_changes_measured_moments(cycles):
    first = with_spring(cycles, "ankle_angle_l", 1.5)[0]
    assert first.moments.values - cycles[0].moments.values == pytest.approx(-15.0)
    radians = replace(cycles[0], angles=replace(cycles[0].angles, in_degrees=False))
    (turned,) = with_spring([radians], "ankle_angle_l", 1.5)
    assert turned.moments.values - radians.moments.values == pytest.approx(-15.0 * np.rad2deg(1.0))


def test_filter_smooths_one_signal_and_mass_scales_moments(cycles):
    first = with_filter(cycles, "moments", 3.0)[0]
    assert np.ptp(first.moments.values[50:-50]) < 0.5 * np.ptp(cycles[0].moments.values)
    assert first.emg is cycles[0].emg
    assert with_wrong_mass(cycles, 1.15)[0].moments.values == pytest.approx(1.15 * cycles[0].moments.values)


def test_offsets_gains_and_losses_concern_the_slowest_speed(cycles):
    raised = with_offset(cycles, "TibAnt", 0.1, slowest_only=True)
    assert [c.emg.values[0, 1] for c in raised] == pytest.approx([1.1, 1.1, 1.0, 1.0])
    assert [c.emg.values[0, 1] for c in with_offset(cycles, "TibAnt", 0.1, slowest_only=False)] == [1.1] * 4
    assert [c.emg.values[0, 1] for c in with_gain(cycles, "TibAnt", 1.3)] == pytest.approx(
        [1.3, 1.3, 1.0, 1.0]
    )
    assert not with_lost_channel(cycles, "Sol")[0].emg.values[:, 0].any()


def test_exchanged_channels_have_the_values_of_each_other(cycles):
    first = with_exchanged(cycles, "Sol", "TibAnt")[0]
    np.testing.assert_array_equal(first.emg.values, cycles[0].emg.values[:, ::-1])


def test_skin_slides_by_the_given_angle_in_the_unit_of_the_table(cycles):
    waving = replace(
        cycles[0], angles=table(["ankle_angle_l"], [10.0 * np.sin(20.0 * TIME)], in_degrees=True)
    )
    moved = with_skin_slide([waving], "ankle_angle_l", 4.0)[0].angles.values - waving.angles.values
    assert np.abs(moved).max() == pytest.approx(4.0)
    radians = replace(waving, angles=replace(waving.angles, in_degrees=False))
    moved = with_skin_slide([radians], "ankle_angle_l", 4.0)[0].angles.values - radians.angles.values
    assert np.abs(moved).max() == pytest.approx(np.deg2rad(4.0))


def test_forces_are_late_and_moved_forward():
    forces = table(["r_vy", "r_px", "r_pz"], [TIME, 2.0 * TIME, np.ones_like(TIME)])
    one = recording(0.0, 1.0, emg=forces, moments=forces, angles=forces, forces=forces)
    (late,), (moved,) = with_late_forces([one], 0.02), with_moved_pressure([one], 0.03)
    assert late.forces.values[20:, 0] == pytest.approx(TIME[20:] - 0.02)
    assert (moved.forces.values - forces.values).T[:, 0] == pytest.approx([0.0, 0.03, 0.0])


def test_what_is_possible_depends_on_the_recording(data_folder):
    """Several speeds, neighboring channels, external loads."""
    from wrapjax.diagnosis.effects.catalogue import CATALOGUE

    effects = {}
    for folder in (data_folder / name for name in recorded.PEOPLE):
        every = manipulations_of(folder)
        assert len({one.name for one in every}) == len(every)
        effects[folder.name] = {one.effect for one in every}
        assert effects[folder.name] <= set(CATALOGUE)
    assert {"speed_dependent_delay", "emg_channel_loss"} <= effects["s1_left"]
    assert "cop_offset" not in effects["s1_left"] | effects["healthy_treadmill"]
    assert {"cop_offset", "force_latency", "segment_inertia"} <= effects["healthy_running"]
    assert {one.effect for one in knock_outs()} == {"missing_drive", None}


def test_source_files_are_unchanged_and_hidden_channel_is_removed(s1_left, tmp_path):
    source, folder = tmp_path / "source", tmp_path / "made"
    shutil.copytree(s1_left, source, ignore=shutil.ignore_patterns("reference_geometry"))
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    (hidden,) = (one for one in knock_outs() if one.hidden == "TibPost")
    write_manipulation(source, folder, hidden)
    assert "TibPost =" not in (folder / "subject.toml").read_text()
    assert "TibAnt =" in (folder / "subject.toml").read_text()
    drifted = next(one for one in manipulations_of(source) if one.name == "drift_2")
    write_manipulation(source, folder, drifted)
    ratio = [
        read_storage(folder / own).values[:, 11].max() / read_storage(source / own).values[:, 11].max()
        for own in ("trials/walk_0p5_1/emg.sto", "trials/walk_0p8_4/emg.sto")
    ]
    assert ratio == pytest.approx([0.7, 1.3])
    assert {path: path.read_bytes() for path in source.rglob("*") if path.is_file()} == before
    with pytest.raises(InputError, match="no channel 'Nobody'"):
        write_manipulation(source, folder, Manipulation("x", "", list, None, hidden="Nobody"))


def test_a_recording_of_several_trials_is_read_once_with_its_cycles_in_time(data_folder):
    (one,) = read_recordings(data_folder / "healthy_running")
    assert len(one.cycles) == 11 and one.cycles == tuple(sorted(one.cycles)) and one.has_loads
    assert one.orders[0] == 0.0 and one.orders[-1] == 1.0
    assert one.order_at(np.array([0.0, np.mean(one.cycles[3]), 99.0])) == pytest.approx([0.0, 0.3, 1.0])


@pytest.mark.slow
def test_moved_pressure_changes_moments_by_the_lever_of_the_force(data_folder, tmp_path):
    """The moment of the vertical force about the ankle, by its displacement: by hand, within 10 %."""
    source, meters = data_folder / "healthy_running", 0.02
    moved = Manipulation("x", "", partial(with_moved_pressure, meters=meters), "cop_offset")
    write_manipulation(source, tmp_path / "made", moved)
    before, after = (read_recordings(folder)[0] for folder in (source, tmp_path / "made"))
    place = before.moments.columns.index("ankle_angle_r_moment")
    change = (after.moments.values - before.moments.values)[:, place]
    vertical = np.interp(
        before.moments.time,
        before.forces.time,
        before.forces.values[:, before.forces.columns.index("ground_force_vy")],
    )
    inside = np.any([(before.moments.time > a) & (before.moments.time < b) for a, b in before.cycles], axis=0)
    expected = -meters * vertical[inside]
    assert np.abs(expected).max() > 20.0
    assert np.sqrt(np.mean((change[inside] - expected) ** 2)) < 0.1 * np.sqrt(np.mean(expected**2))


def test_mass_factors_change_the_model_and_unknown_bodies_are_refused(s1_left, tmp_path):
    heavier = Manipulation("x", "", list, "segment_inertia", mass_factors={"tibia_l": 1.3})
    write_manipulation(s1_left, tmp_path / "made", heavier)

    def masses(folder):
        return [
            float(text) for text in re.findall(r"<mass>(.*?)</mass>", (folder / "model.osim").read_text())
        ]

    ratio = np.array(masses(tmp_path / "made")) / np.maximum(masses(s1_left), 1e-300)
    assert sorted(set(np.round(ratio[np.array(masses(s1_left)) > 0], 9))) == [1.0, 1.3]
    with pytest.raises(InputError, match="no body 'tail'"):
        write_manipulation(s1_left, tmp_path / "made", replace(heavier, mass_factors={"tail": 2.0}))


def row(effect, rise, accepted=(), family="", person="one"):
    ordered = dict(sorted(rise.items(), key=lambda one: -one[1]))
    outcome = "named" if accepted else "unknown"
    return recorded.Row(person, f"{effect}!", effect, 3.0, ordered, outcome, accepted, family)


def test_rises_are_counted_by_effect_or_family_and_wrong_names_by_family():
    rows = [
        row("emg_drift", {"emg_drift": 20.0, "cop_offset": 1.0}, ("emg_drift",)),
        row("emg_drift", {"emg_drift": 1.0, "emg_offset": 4.0}, ("emg_offset",)),
        row("emg_drift", {"emg_drift": 1.0, "cop_offset": 4.0}, ("cop_offset",), person="two"),
        row("cop_offset", {"emg_drift": 1.0, "cop_offset": 4.0}, family="emg", person="two"),
        row("missing_drive", {"emg_drift": 1.0}, person="two"),
    ]
    assert [one.right for one in rows] == [True, True, False, True, False]
    assert [one.named_wrongly for one in rows] == [False, False, True, True, False]
    text = recorded.table(rows)
    assert "| one | emg_drift! | `emg_drift`: 3.0, +20.0, 1 | `emg_drift` +20.0 | named emg_drift |" in text
    assert "`missing_drive`: not testable" in text
    assert "rises most in 60% of 5" in text and "one 2 of 2, two 1 of 3" in text
    assert "`emg`, would be right in 60%" in text and "Named wrongly: 2 of 5" in text
    assert "33% to 100% by resampling people" in text
    assert "resampling" not in recorded.table(rows[:2]), "one person has no interval"


def test_knock_outs_are_listed_with_the_excitation_of_the_hidden_channel():
    groups = [
        {"group": "sart", "own": False, "correlation": 0.1, "correlation_delayed": 0.2},
        {"group": "tibpost", "own": True, "correlation": 0.7, "correlation_delayed": 0.85},
    ]
    said = {"outcome": "tie", "named": [], "ties": [["missing_drive", "cop_offset"]]}
    text = knock_outs_module.table([{"says": "no electrode", **said, "drive": {"groups": groups}}])
    assert "| tie missing_drive, cop_offset | 0.70, 0.85 (tibpost, rank 2 of 2 groups) |" in text


def test_unknown_manipulation_is_an_input_error(s1_left, monkeypatch, tmp_path, capsys):
    arguments = ["recorded", "--subjects", str(s1_left), "--out", str(tmp_path), "--only", "nobody"]
    monkeypatch.setattr("sys.argv", arguments)
    assert recorded.main() == 2
    assert "no manipulation 'nobody'" in capsys.readouterr().err


def test_excitation_is_compared_with_earlier_emg():
    """Check that excitation may lag behind EMG but not lead it; zero excitation has no correlation."""
    from validation.recorded.knock_outs import PHASES, correlations

    emg = np.exp(-(((np.linspace(0.0, 1.0, PHASES) - 0.4) / 0.05) ** 2))
    later, earlier = (np.append(np.roll(emg[:-1], shift), emg[0]) for shift in (5, -5))
    assert correlations(emg, emg)["correlation"] == pytest.approx(1.0)
    assert correlations(later, emg)["correlation"] < 0.7
    assert correlations(later, emg)["correlation_delayed"] == pytest.approx(1.0)
    assert correlations(earlier, emg)["correlation_delayed"] < 0.7
    assert correlations(0.0 * emg, emg) == {"correlation": None, "correlation_delayed": None}


def test_an_effect_that_is_testable_with_the_error_alone_had_no_evidence_before(monkeypatch):
    """A channel is tested for its loss only where it was lost: the rise of that effect is its evidence."""
    decision = SimpleNamespace(outcome="unknown", accepted=(), family="")
    monkeypatch.setattr(recorded, "decision_on", lambda case, constants: decision)
    scored = {
        "one.untouched": SimpleNamespace(evidence={"emg_drift": 4.0}, detectability={"emg_drift": 3.0}),
        "one.lost": SimpleNamespace(
            evidence={"emg_drift": 4.5, "emg_channel_loss": 2.0},
            detectability={"emg_drift": 2.0, "emg_channel_loss": 1.5},
        ),
    }
    jobs = {
        name: (Manipulation(name, name, list, effect), None)
        for name, effect in (("one.untouched", None), ("one.lost", "emg_channel_loss"))
    }
    (found,) = recorded._rows("one", jobs, scored)
    assert found.rise == {"emg_channel_loss": 2.0, "emg_drift": 0.5} and found.right
    assert found.detectability == 1.5
