"""Findings in recordings: each fault added to one stretch is named with its channel, and no other."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.subject.synthetic import CHANNELS, COORDINATES, PERIOD, angles, write_subject
from tests.subject.task_folders import ISOMETRIC, SQUAT, add_trial
from wrapjax.cli.command_line import main
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.path_sources.moment_capacity import unrecorded_capacity
from wrapjax.preprocessing.checks import recording_findings as recording_findings_module
from wrapjax.preprocessing.checks.recording_findings import recording_findings
from wrapjax.report.check_page import finding_figure
from wrapjax.report.style import VERMILION
from wrapjax.subject.subject import load_subject

CYCLES = 16
RATE = 200.0


@pytest.fixture
def folder(tmp_path):
    """Subject with one recording of 16 cycles, whose EMG has bursts at different phases, and some noise."""
    write_subject(tmp_path)
    rng = np.random.default_rng(5)
    time = np.arange(round((CYCLES + 1.5) * PERIOD * RATE)) / RATE
    phase = time / PERIOD % 1.0
    size = 1.0 + 0.1 * np.interp(time, np.arange(40) * 0.6, rng.standard_normal(40))
    bursts = [np.exp(-0.5 * ((phase - place) / 0.08) ** 2) for place in (0.3, 0.7)]
    emg = 0.02 + 0.6 * size * np.array(bursts)
    emg += 0.003 * np.abs(rng.standard_normal(emg.shape))
    place = tmp_path / "trials" / "walk_a"
    write_storage(place / "emg.sto", Storage("emg", tuple(CHANNELS), time, emg.T))
    write_storage(place / "angles.sto", Storage("angles", COORDINATES, time, angles(time).T))
    moments = np.array([30.0 * np.sin(6.0 * time), 20.0 * np.cos(6.0 * time)])
    labels = tuple(f"{name}_moment" for name in COORDINATES)
    write_storage(place / "moments.sto", Storage("moments", labels, time, moments.T))
    file = tmp_path / "subject.toml"
    text = file.read_text()
    start, end = text.index("[[trial]]"), text.rindex("[[trial]]")
    cycles = [[round(0.5 + k * PERIOD, 3), round(0.5 + (k + 1) * PERIOD, 3)] for k in range(CYCLES)]
    file.write_text(text[:end].replace("[[0.5, 1.7], [1.7, 2.9]]", str(cycles)))
    assert start < end
    return tmp_path


def change(folder, function, name="emg"):
    """Change the EMG of the interval from 6 to 12 s."""
    file = folder / "trials" / "walk_a" / f"{name}.sto"
    table = read_storage(file)
    values = table.values.copy()
    inside = (table.time > 6.0) & (table.time < 12.0)
    values[inside] = function(values[inside], table.time[inside])
    write_storage(file, replace(table, values=values))
    return recording_findings(load_subject(folder))


def test_clean_recordings_have_no_findings(folder, tmp_path):
    assert recording_findings(load_subject(folder)) == ()


def added(values, time):
    return values + np.array([0.08, 0.0])


def lost(values, time):
    return np.column_stack([values[:, 0], np.full(len(values), 0.02)])


def clipped(values, time):
    return np.column_stack([np.where(values[:, 0] > 0.5, 0.9, values[:, 0]), values[:, 1]])


def hum(values, time):
    return values + np.outer(np.sin(2.0 * np.pi * 50.0 * time), [0.0, 0.05])


FAULTS = {
    "baseline": (added, ("RecFem",), "never falls below 0.1"),
    "lost channel": (lost, ("SemiTen",), "lost its signal"),
    "swapped channels": (
        lambda values, time: values[:, ::-1],
        ("RecFem", "SemiTen"),
        "look swapped in 4 of 16",
    ),
    "saturation": (clipped, ("RecFem",), "stays at 0.9"),
    "mains": (hum, ("SemiTen",), "at 50 Hz"),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_one_stretch_is_named(folder, kind):
    function, channels, words = FAULTS[kind]
    found = [one for one in change(folder, function) if one.kind == kind]
    assert len(found) == 1
    assert found[0].subjects == channels and words in found[0].sentence and "walk_a" in found[0].sentence
    panels = finding_figure(found[0], load_subject(folder)).axes
    assert [panel.get_title(loc="left") for panel in panels] == list(channels)
    if found[0].cycles:
        concerned = [line for line in panels[0].lines if line.get_color() == VERMILION]
        assert len(concerned) == len(found[0].cycles) and len(concerned) in (4, 5)


def test_a_third_channel_is_not_named_with_two_that_were_exchanged(folder):
    """A quiet channel with the signal of a loud one also fits the pattern of any other loud one better."""
    trials = load_subject(folder).trials.only_gait()
    rng = np.random.default_rng(2)
    phase = np.linspace(0.0, 1.0, trials.emg.shape[-1])
    bursts = np.exp(-0.5 * ((phase - np.array([[0.3], [0.6], [0.4]])) / 0.08) ** 2)
    size = np.array([0.6, 0.04, 0.25]) * (1.0 + 0.15 * rng.standard_normal((len(trials), 3)))
    emg = 0.02 + size[..., None] * bursts
    emg[4:9, :2] = emg[4:9, 1::-1]
    channels = ("loud", "quiet", "other")
    found = list(recording_findings_module._swapped_channels(replace(trials, emg=emg, channels=channels)))
    assert [one.subjects for one in found] == [("loud", "quiet")]


def test_recordings_of_one_cycle_each_differ_as_much_as_their_quiet_levels_do(folder):
    trials = load_subject(folder).trials.only_gait()
    names = tuple(f"walk_{number}" for number in range(len(trials)))
    floors = 0.05 + 0.02 * np.random.default_rng(4).standard_normal(len(trials))
    phase = np.linspace(0.0, 1.0, trials.emg.shape[-1])
    emg = floors[:, None, None] + 0.4 * np.exp(-0.5 * ((phase - 0.5) / 0.08) ** 2)
    each = replace(trials, recordings=names, emg=emg, channels=("quiet",))
    assert list(recording_findings_module._baselines(each)) == []
    emg[3] += 0.2
    found = list(recording_findings_module._baselines(replace(each, emg=emg)))
    assert [(one.recording, one.cycles) for one in found] == [("walk_3", (trials.names[3],))]


def test_a_baseline_of_one_recording_is_named(folder):
    other = folder / "trials" / "walk_a" / "emg.sto"
    table = read_storage(other)
    raised = replace(table, values=table.values + np.array([0.0, 0.061]))
    write_storage(folder / "trials" / "again.sto", raised)
    file = folder / "subject.toml"
    text = file.read_text()
    again = text[text.index("[[trial]]") :].replace('"walk_a"', '"again"')
    file.write_text(text + "\n" + again.replace("trials/walk_a/emg.sto", "trials/again.sto"))
    found = recording_findings(load_subject(folder))
    assert [(one.kind, one.recording, one.subjects) for one in found] == [("baseline", "again", ("SemiTen",))]
    assert "16 of 16 cycles" in found[0].sentence


def test_a_held_contraction_is_no_baseline(folder):
    """A ramp of effort rests at its ends, not in every second."""

    def ramp(time):
        effort = np.clip(2.0 - np.abs(time - 4.1) / 0.9, 0.0, 1.0)
        return np.stack([0.02 + 0.8 * effort, 0.02 + 0.0 * effort])

    add_trial(folder, "ramp", ISOMETRIC.replace("[2.6, 5.3]", "[2.3, 5.9]"), emg=ramp)
    assert [one for one in recording_findings(load_subject(folder)) if one.kind == "baseline"] == []


def test_muscles_that_hold_the_body_in_a_squat_have_no_baseline(folder):
    add_trial(folder, "squat", SQUAT, emg=lambda time: 0.3 + 0.2 * np.sin(np.stack([time, 2.0 * time])))
    assert [one for one in recording_findings(load_subject(folder)) if one.kind == "baseline"] == []


@pytest.mark.parametrize(("late", "found"), [("recfem", ()), ("semiten", (("RecFem", "SemiTen"),))])
def test_channels_exchanged_in_all_cycles_are_named(folder, monkeypatch, late, found):
    """The rectus femoris channel of the folder is active at 88 % of the cycle, the other at 28 %."""
    early = "semiten" if late == "recfem" else "recfem"
    usual = {late: ((80.0, 96.0),), early: ((20.0, 36.0),)}
    monkeypatch.setattr("wrapjax.subject.gait_activity.USUAL_ACTIVITY", usual)
    findings = recording_findings(load_subject(folder))
    assert tuple(one.subjects for one in findings) == found
    assert all("in all cycles" in one.sentence for one in findings)


@pytest.mark.parametrize(("force", "expected"), [(30.0, []), (90.0, ["pelvis residual"])])
def test_residuals_of_inverse_dynamics_are_compared_with_weight(folder, force, expected):
    file = folder / "trials" / "walk_a" / "moments.sto"
    table = read_storage(file)
    columns = (*table.columns, "pelvis_ty_force")
    values = np.column_stack([table.values, np.full(table.time.size, force)])
    write_storage(file, replace(table, columns=columns, values=values))
    subject = load_subject(folder)
    assert recording_findings(subject) == ()
    with_forces = tuple(replace(entry, ground_forces=file) for entry in subject.recordings)
    found = recording_findings(replace(subject, recordings=with_forces))
    assert [one.kind for one in found] == expected
    for one in found:
        (panel,) = finding_figure(one, replace(subject, recordings=with_forces)).axes
        assert panel.get_title(loc="left") == "pelvis_ty_force"
        assert max(np.max(line.get_ydata()) for line in panel.lines) == force


def test_check_writes_a_page_with_each_finding_and_refuses_to_replace_one(folder, tmp_path, capsys):
    change(folder, added)
    out = tmp_path / "checked"
    assert main(["check", str(folder), "--out", str(out), "--quiet"]) == 0
    page = (out / "report.html").read_text()
    assert "1 finding in the recordings" in page and "never falls below 0.1" in page
    assert "Baseline: RecFem" in page and "<script" not in page
    (finding,) = json.loads((out / "check.json").read_text())["Findings in the recordings"]
    assert finding["kind"] == "baseline"
    assert main(["check", str(folder), "--out", str(out), "--quiet"]) == 2
    assert "--force" in capsys.readouterr().err


def test_capacity_without_electrodes(folder):
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('RecFem = ["recfem_l"]\n', ""))
    rows = {(one.coordinate, one.sign): one for one in unrecorded_capacity(load_subject(folder))}
    assert set(rows) == {(name, sign) for name in COORDINATES for sign in (1, -1)}
    # The muscle in front of the joints flexes the hip and extends the knee; the other one is behind both.
    for one in rows.values():
        assert one.share < 0.05 or (one.share > 0.95 and one.muscles == ("recfem_l",))
    assert rows["hip_flexion_l", 1].share != rows["hip_flexion_l", -1].share
