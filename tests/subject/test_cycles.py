"""Cutting of recordings into gait cycles: times, interpolated values, derivatives and padding."""

import numpy as np
import pytest

from tests.subject.synthetic import (
    CYCLES,
    PERIOD,
    angles,
    angular_velocities,
    emg,
    moments,
    write_subject,
)
from wrapjax.io.storage import Storage, read_storage, write_storage
from wrapjax.subject.cycles import cycle_times, padding_frames, resample
from wrapjax.subject.subject import load_subject
from wrapjax.subject.trials import FRAMES


@pytest.fixture
def subject(tmp_path):
    return load_subject(write_subject(tmp_path / "subject"))


def test_padding_spans_0_2_s_of_the_shortest_cycle_in_multiples_of_10_frames():
    assert padding_frames([(0.0, 1.0)]) == 20
    assert padding_frames([(0.0, 0.99)]) == 30  # 20.2 frames
    assert padding_frames([(0.07, 0.57)]) == 40  # 0.49999999999999994 s
    assert padding_frames([(0.0, 2.0), (2.0, 3.0)]) == 20
    assert padding_frames([(9.49, 10.59)]) == 20  # 18.2 frames


def test_times_are_even_and_include_both_ends_of_the_cycle():
    times = cycle_times([(0.5, 1.7), (1.7, 2.9)], 2)
    assert times.shape == (2, FRAMES + 4)
    np.testing.assert_array_equal(times[:, 2], [0.5, 1.7])
    np.testing.assert_array_equal(times[:, -3], [1.7, 2.9])
    np.testing.assert_allclose(np.diff(times, axis=1), 0.012, rtol=1e-9)


def test_values_and_derivatives_of_unevenly_sampled_signals():
    rng = np.random.default_rng(3)
    time = np.sort(np.concatenate([[0.0, 2.0], rng.uniform(0.0, 2.0, 400)]))
    at = cycle_times([(0.3, 1.7)])
    values, rates = resample(time, np.array([np.sin(5.0 * time), time**2]), at)
    assert values.shape == (1, 2, FRAMES)
    np.testing.assert_allclose(values[0], [np.sin(5.0 * at[0]), at[0] ** 2], atol=1e-6)
    np.testing.assert_allclose(rates[0], [5.0 * np.cos(5.0 * at[0]), 2.0 * at[0]], atol=1e-3)


def test_edge_values_are_held():
    values, _ = resample(np.arange(5.0), np.arange(5.0)[None] ** 2, np.array([[-1.0, 4.0, 7.0]]))
    np.testing.assert_allclose(values[0, 0], [0.0, 16.0, 16.0], atol=1e-12)


def test_names_uses_and_speeds_of_cycles(subject):
    trials = subject.trials
    assert trials.names == ("walk_a/01", "walk_a/02", "walk_b")
    assert trials.recordings == ("walk_a", "walk_a", "walk_b")
    assert trials.uses == ("calibration", "calibration", "validation")
    np.testing.assert_array_equal(trials.speeds, [1.1, 1.1, np.nan])
    np.testing.assert_allclose(trials.time[:, [0, -1]], [*CYCLES["walk_a"], *CYCLES["walk_b"]], atol=1e-12)


def test_signals_agree_with_the_analytic_ones(subject):
    trials = subject.trials
    for index, time in enumerate(trials.time):
        np.testing.assert_allclose(trials.angles[index], angles(time), atol=1e-7)
        np.testing.assert_allclose(trials.angular_velocities[index], angular_velocities(time), atol=1e-5)
        np.testing.assert_allclose(trials.moments[index], moments(time), atol=1e-5)
        np.testing.assert_allclose(trials.emg[index], emg(trials.emg_time[index]), atol=1e-6)
    assert trials.padding == 20
    np.testing.assert_allclose(np.diff(trials.emg_time, axis=1), PERIOD / 100, rtol=1e-9)
    np.testing.assert_allclose(trials.emg_time[:, 20:-20], trials.time, atol=1e-12)
    assert subject.notes == ()


def test_edge_value_of_short_emg_is_held_and_noted(tmp_path):
    folder = write_subject(tmp_path / "subject")
    path = folder / "trials" / "walk_b" / "emg.sto"
    whole = read_storage(path)
    keep = whole.time >= 0.55
    write_storage(path, Storage(whole.name, whole.columns, whole.time[keep], whole.values[keep]))
    subject = load_subject(folder)
    before = subject.trials.emg_time[2] <= 0.55
    assert 5 < before.sum() < subject.trials.padding
    np.testing.assert_allclose(
        subject.trials.emg[2][:, before], np.repeat(emg(np.array([0.55])), before.sum(), axis=1), atol=1e-9
    )
    assert len(subject.notes) == 1
    assert "walk_b" in subject.notes[0] and "1 of 1 cycles" in subject.notes[0] and "held" in subject.notes[0]


def test_selecting_trials(subject):
    trials = subject.trials
    assert trials.used_for("validation").names == ("walk_b",)
    assert trials.used_for("calibration").angles.shape == (2, 2, FRAMES)
    swapped = trials.select([2, 0])
    assert swapped.names == ("walk_b", "walk_a/01")
    np.testing.assert_array_equal(swapped.moments, trials.moments[[2, 0]])
    assert swapped.coordinates == trials.coordinates
    assert len(trials.select(np.array([False, False, False]))) == 0
