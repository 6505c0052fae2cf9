"""Differences between cycles that errors of the inputs cause are noise, not explainable error."""

import numpy as np
import pytest

from wrapjax.diagnosis.localization import split_error, without_input_errors
from wrapjax.diagnosis.null_hypotheses.noise_floor import (
    RepeatedCycles,
    cycle_errors,
    explainable_share,
    input_driven_variance,
    noise_floor,
)

CYCLES, COORDINATES, FRAMES = 12, 2, 51
SPEEDS = np.zeros(CYCLES, dtype=int)


@pytest.fixture(scope="module")
def recorded():
    """One input whose deviations from its mean cycle drive the moments, and some noise."""
    generator = np.random.default_rng(0)
    phase = 2 * np.pi * np.linspace(0.0, 1.0, FRAMES)
    waves = np.stack([np.sin(phase), np.cos(phase)])
    inputs = (generator.normal(size=(CYCLES, 1, 2)) @ waves) + np.sin(2 * phase)
    deviations = inputs - inputs.mean(axis=0)
    noise = 0.1 * generator.normal(size=(CYCLES, COORDINATES, FRAMES))
    variance = np.broadcast_to(4.0 * deviations.var(axis=(0, 1)), (COORDINATES, FRAMES))
    return inputs, 2.0 * deviations + noise, variance


def driven(recorded, error_variance=None):
    inputs, residual, _ = recorded
    variance = input_driven_variance(residual, inputs, SPEEDS)
    return variance if error_variance is None else without_input_errors(variance, error_variance)


def share(recorded, error_variance=None):
    residual = recorded[1]
    by_speed = driven(recorded, error_variance).mean(axis=(1, 2))
    floor = noise_floor(residual, SPEEDS, 8.0 * COORDINATES, by_speed)
    return explainable_share(cycle_errors(residual), floor, SPEEDS).value


def test_input_driven_error_is_explainable_except_for_input_errors(recorded):
    by_errors = recorded[2][:, :-1]
    without_errors = share(recorded)
    assert without_errors > 0.6
    assert share(recorded, by_errors) < 0.1 * without_errors
    assert share(recorded, 0.0 * by_errors) == without_errors
    assert 0.3 * without_errors < share(recorded, 0.5 * by_errors) < 0.8 * without_errors


def test_variance_by_input_errors_is_counted_as_noise(recorded):
    before, after = (
        split_error(recorded[1], SPEEDS, driven(recorded, given))
        for given in (None, 0.5 * recorded[2][:, :-1])
    )
    np.testing.assert_allclose(after.driven + after.noise, before.driven + before.noise, rtol=1e-9)
    assert after.driven.sum() < 0.8 * before.driven.sum()
    np.testing.assert_array_equal(after.repeatable, before.repeatable)


def test_only_speeds_with_two_cycles_are_repeated():
    repeated = RepeatedCycles.of(np.array([0, 1, 2, 2, 0]))
    np.testing.assert_array_equal(repeated.cycles, [0, 2, 3, 4])
    np.testing.assert_array_equal(repeated.speeds, [0, 2])
    np.testing.assert_array_equal(repeated.number, [0, 1, 1, 0])
    np.testing.assert_array_equal(repeated.by_speed(np.array([[[1.0]], [[3.0]]])), [1.0, 0.0, 3.0])
