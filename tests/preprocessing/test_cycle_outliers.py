"""Cycles that differ from the others are named with the reason, and usual ones are not."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wrapjax.preprocessing.gait.cycle_outliers import (
    dropped_sentences,
    steps_of_other_foot,
    unusual_durations,
    unusual_moments,
)
from wrapjax.preprocessing.gait.force_plates import FootForces


def cycles_of(durations):
    ends = np.cumsum(durations)
    return tuple((float(end - one), float(end)) for end, one in zip(ends, durations, strict=True))


def test_a_double_stride_is_named():
    durations = np.full(12, 1.15) + 0.02 * np.random.default_rng(0).standard_normal(12)
    durations[4] = 2.3
    cycles = cycles_of(durations)
    found = unusual_durations(cycles)
    assert list(found) == [cycles[4]] and "2.3 s, 2 times" in found[cycles[4]]
    assert dropped_sentences(found)[0].endswith(found[cycles[4]])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(5, 60))
def test_usual_durations_are_kept(seed, count):
    durations = 1.1 * (1.0 + 0.015 * np.random.default_rng(seed).uniform(-1.7, 1.7, count))
    assert unusual_durations(cycles_of(durations)) == {}


def test_too_few_cycles_are_not_judged():
    assert unusual_durations(cycles_of([1.0, 1.0, 2.0])) == {}


def test_a_cycle_with_another_moment_is_named():
    rng = np.random.default_rng(1)
    cycles = cycles_of(np.full(15, 1.0))
    time = np.arange(0.0, 15.0, 0.01)
    wave = 80.0 * np.sin(2.0 * np.pi * time) + 4.0 * rng.standard_normal(15)[time.astype(int)]
    assert unusual_moments(cycles, time, {"ankle_moment": wave}) == {}
    wave[(time > 6.0) & (time < 7.0)] *= 0.3
    found = unusual_moments(cycles, time, {"knee_moment": np.sin(time), "ankle_moment": wave})
    assert list(found) == [cycles[6]] and "ankle_moment" in found[cycles[6]]


def test_a_plate_trodden_by_the_other_foot_is_named():
    time = np.arange(0.0, 6.0, 0.01)
    feet = {"l": np.zeros((3, time.size)), "r": np.zeros((3, time.size))}
    feet["l"][2], feet["r"][2] = -0.1, 0.1
    wrench = np.zeros((2, 6, time.size))
    loaded = (time % 1.0) < 0.6
    lateral = np.where((time > 2.0) & (time < 3.0), -0.1, 0.1)
    wrench[1, 4], wrench[1, 0] = 700.0 * loaded, -lateral * 700.0 * loaded
    forces = FootForces(("l", "r"), time, wrench)
    cycles = tuple((float(start), float(start + 1)) for start in range(6))
    found = steps_of_other_foot(cycles, "r", time, feet, forces, 200.0)
    assert list(found) == [(2.0, 3.0)] and "left foot" in found[2.0, 3.0]
