"""Trials of other tasks than gait: windows on their own time, postures, rest, and moments of some joints."""

from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from tests.subject.synthetic import CHANNELS, CYCLES, write_subject
from tests.subject.task_folders import (
    ISOMETRIC,
    PASSIVE,
    SQUAT,
    add_trial,
    slow_angles,
    slow_emg,
    slow_moments,
    without_gait,
    write_mixed_subject,
)
from wrapjax.errors import InputError
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.subject.description import describe_subject, render_tables
from wrapjax.subject.subject import load_subject
from wrapjax.subject.trials import FRAMES
from wrapjax.subject.windows import SETTLING_SECONDS, WINDOW_SECONDS, counted_frames, window_limits


@given(st.floats(-5.0, 50.0), st.floats(0.05, 12.0))
def test_windows_count_every_moment_of_an_interval_once(start, duration):
    interval = (start, start + duration)
    limits, counted = window_limits(interval), counted_frames(interval)
    assert counted.shape == (len(limits), FRAMES)
    times = np.array([np.linspace(*one, FRAMES) for one in limits])[counted]
    assert np.all(np.diff(times) > 0.0)
    assert np.diff(times).max(initial=0.0) < 0.01 + 1e-4
    assert times[0] == start and abs(times[-1] - interval[1]) < 0.01 + 1e-4


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    return load_subject(write_mixed_subject(tmp_path_factory.mktemp("mixed") / "subject"))


def test_gait_cycles_are_the_same_with_and_without_other_tasks(mixed, tmp_path):
    alone = load_subject(write_subject(tmp_path / "alone")).trials
    gait = mixed.trials.select(mixed.trials.is_gait)
    assert gait.names == alone.names and gait.uses == alone.uses
    for part in ("time", "angles", "angular_velocities", "moments", "speeds"):
        np.testing.assert_array_equal(getattr(gait, part), getattr(alone, part))
    first = gait.emg_starts[0]
    np.testing.assert_array_equal(gait.emg[..., first:], alone.emg)
    np.testing.assert_allclose(gait.emg_time[:, first:], alone.emg_time, atol=1e-12)
    np.testing.assert_array_equal(gait.emg[..., :first], np.repeat(alone.emg[..., :1], first, axis=-1))
    assert alone.is_gait_only and not mixed.trials.is_gait_only


def test_windows_keep_the_interval_s_own_time(mixed):
    trials = mixed.trials
    squat = trials.select(np.array(trials.recordings) == "squat")
    assert squat.names == ("squat/01", "squat/02", "squat/03", "squat/04")
    assert set(squat.tasks) == {"movement"}
    np.testing.assert_allclose(np.diff(squat.time, axis=1), WINDOW_SECONDS / 100, rtol=1e-9)
    np.testing.assert_allclose(squat.time[:, 0], [2.5, 3.5, 4.0, 5.2], atol=1e-12)
    for row, time in enumerate(squat.time):
        inside = time <= 6.0
        np.testing.assert_allclose(squat.angles[row][:, inside], slow_angles(time[inside]), atol=1e-6)
        known = np.isfinite(squat.moments[row]).all(axis=0)
        np.testing.assert_allclose(squat.moments[row][:, known], slow_moments(time[known]), atol=1e-6)
    assert squat.counted.sum() == 251 + 41
    before = squat.emg_time[:, squat.padding]
    np.testing.assert_allclose(before, squat.time[:, 0], atol=1e-12)
    assert squat.padding == round(SETTLING_SECONDS / 0.01)
    early = squat.emg_time[0] <= 5.9
    np.testing.assert_allclose(squat.emg[0][:, early], slow_emg(squat.emg_time[0][early]), atol=1e-5)


def test_rest_posture_and_moments_of_one_joint(mixed):
    trials = mixed.trials
    knee = trials.of_task("passive")
    assert len(knee) == 4
    floor = np.percentile(trials.emg[[task != "passive" for task in trials.tasks]], 1.0, axis=(0, 2))
    np.testing.assert_allclose(knee.emg, np.broadcast_to(floor[:, None], knee.emg.shape))
    np.testing.assert_allclose(knee.angles[:, 0], np.radians(10.0))
    assert np.all(knee.angular_velocities[:, 0] == 0.0)
    assert np.isnan(knee.moments[:, 0]).all()
    assert np.isfinite(knee.moments[:, 1]).sum() == 371
    assert any("knee_angle_l alone" in note for note in mixed.notes)


def test_a_folder_of_validation_trials_alone_is_read(tmp_path):
    folder = write_subject(tmp_path)
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('use = "calibration"', 'use = "validation"'))
    assert set(load_subject(folder).trials.uses) == {"validation"}


def test_a_folder_without_gait_is_read_and_described(tmp_path):
    folder = without_gait(write_mixed_subject(tmp_path))
    subject = load_subject(folder)
    assert set(subject.trials.tasks) == {"passive", "movement"}
    assert subject.trials.coordinates == ("hip_flexion_l", "knee_angle_l")
    text = render_tables(describe_subject(subject))
    assert "passive" in text and "movement" in text and "nan" not in text


def test_a_coordinate_without_posture_takes_the_model_s_default_where_no_moment_is_matched(tmp_path):
    folder = write_subject(tmp_path)
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('"hip_flexion_l", "knee_angle_l"]', '"knee_angle_l"]'))
    settings = PASSIVE.replace("posture = { hip_flexion_l = 10.0 }\n", "")
    knee = ("knee_angle_l",)
    add_trial(folder, "knee", settings, emg=None, angle_columns=knee, moment_columns=knee)
    subject = load_subject(folder)
    assert subject.trials.coordinates == ("hip_flexion_l", "knee_angle_l")
    np.testing.assert_array_equal(subject.trials.of_task("passive").angles[:, 0], 0.1)
    assert any("default" in note and "hip_flexion_l" in note for note in subject.notes)


def test_raw_emg_outside_gait_is_filtered_at_6_hz_or_as_told(tmp_path):
    """A modulation at 4 Hz passes 6 Hz and not 2 Hz."""
    rate, duration = 1000.0, 6.0
    time = np.arange(round(duration * rate) + 1) / rate
    carrier = np.random.default_rng(1).standard_normal((2, time.size))
    folder = add_trial(write_subject(tmp_path), "ramp", ISOMETRIC)
    without_gait(folder)
    table = read_storage(folder / "trials/ramp/emg.sto")
    volts = 1e-4 * carrier * (1.0 + np.cos(2.0 * np.pi * 4.0 * time))
    write_storage(folder / "trials/ramp/emg.sto", replace(table, time=time, values=volts.T))
    file = folder / "subject.toml"
    file.write_text(file.read_text().replace('kind = "envelope"', 'kind = "raw"'))

    def modulation() -> float:
        trials = load_subject(folder).trials
        wave = np.exp(-2j * np.pi * 4.0 * trials.emg_time[0])
        return abs(np.mean(wave * trials.emg[0, 0])) / trials.emg[0, 0].mean()

    usual = modulation()
    file.write_text(file.read_text().replace(ISOMETRIC, f"{ISOMETRIC}\nemg_low_pass_hz = 2.0"))
    assert modulation() < 0.1 < 0.3 < usual


def _fails(folder, *parts):
    with pytest.raises(InputError) as caught:
        load_subject(folder)
    for part in parts:
        assert part in str(caught.value), str(caught.value)


KNEE = {"angle_columns": ("knee_angle_l",), "moment_columns": ("knee_angle_l",)}
BAD = {
    "outside": (SQUAT.replace("5.6]", "9.0]"), {}, ["interval 2 [5.2, 9] s", "outside the recording", "6 s"]),
    "overlap": (SQUAT.replace("[5.2", "[4.5"), {}, ["[2.5, 5] and [4.5, 5.6]", "do not overlap"]),
    "reversed": (SQUAT.replace("[2.5, 5.0]", "[5.0, 2.5]"), {}, ["t0 before t1"]),
    "no interval": ('task = "movement"', {}, ["expected either interval", "found neither"]),
    "cycle in a squat": (f"{SQUAT}\ncycle = [1.0, 2.0]", {}, ["is for gait"]),
    "interval in gait": ('task = "gait"\ninterval = [1.0, 2.0]', {}, ["tasks other than gait"]),
    "no task": ("interval = [1.0, 2.0]", {}, ["task", "an interval without it"]),
    "unknown task": (SQUAT.replace("movement", "isometrc"), {}, ["did you mean 'isometric'"]),
    "posture of unknown": (SQUAT + "\nposture = { hip_flexion_r = 1.0 }", {}, ["'hip_flexion_r' is not in"]),
    "posture of recorded": (SQUAT + "\nposture = { hip_flexion_l = 1.0 }", {}, ["which it holds"]),
    "posture no number": (SQUAT + '\nposture = { hip_flexion_l = "1" }', {}, ["from -360 to 360 degrees"]),
    "posture no table": (SQUAT + "\nposture = 3", {}, ["expected a table"]),
    "lacking angle": (
        SQUAT,
        {"angle_columns": ("knee_angle_l",)},
        ["column hip_flexion_l: is not in the file", "posture = { hip_flexion_l"],
    ),
    "no moment": (SQUAT, {"moments": lambda time: 0.0 * slow_moments(time)}, ["found none", "not zero"]),
    "N cm": (
        PASSIVE,
        {"moments": lambda time: 100.0 * slow_moments(time), "emg": None, **KNEE},
        ["found 1200", "2 N m per kg", "'passive'", "N cm"],
    ),
    "sign": (
        PASSIVE,
        {"moments": lambda time: -slow_moments(time), "emg": None, **KNEE},
        ["falls as the angle rises", "a sign opposite", "knee_angle_l_moment"],
    ),
    "rest in a squat": (SQUAT, {"emg": None}, ["emg", "found nothing"]),
    "samples": (f"{SQUAT}\neffective_samples = -1", {}, ["effective_samples", "from 0"]),
    "low pass": (f"{SQUAT}\nemg_low_pass_hz = 0", {}, ["emg_low_pass_hz", "0.5 to 100 Hz"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case, tmp_path):
    settings, options, parts = BAD[case]
    _fails(add_trial(write_subject(tmp_path), "task", settings, **options), *parts)


def test_activity_in_a_passive_trial_is_noted_with_its_channel(tmp_path):
    def emg(time):
        return np.array([0.1 + 0.0 * time, 0.1 + 0.3 * (time > 2.0)])

    knee = {"angle_columns": ("knee_angle_l",), "moment_columns": ("knee_angle_l",)}
    folder = add_trial(write_subject(tmp_path), "knee", PASSIVE, emg=emg, **knee)
    notes = [note for note in load_subject(folder).notes if "passive" in note]
    assert len(notes) == 1
    assert "SemiTen" in notes[0] and "RecFem" not in notes[0] and "'knee'" in notes[0]


def test_selection_keeps_tasks_and_conditions_together(mixed):
    chosen = mixed.trials.select([5, 0])
    assert chosen.tasks == (mixed.trials.tasks[5], "gait")
    assert chosen.emg_starts.tolist() == [0, mixed.trials.emg_starts[0]]
    assert len(CYCLES) == 2 and tuple(CHANNELS) == mixed.trials.channels
