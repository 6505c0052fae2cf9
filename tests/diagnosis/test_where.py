"""Defends: what follows inputs because these have errors is noise, and nothing that a model could explain."""

import numpy as np
import pytest

from wrapjax.diagnosis.place import InputMade, where

CYCLES, COORDINATES, FRAMES = 12, 2, 51
SPEEDS = np.zeros(CYCLES, dtype=int)


@pytest.fixture(scope="module")
def recorded():
    """One input whose deviations from its mean cycle all go into the moments, and some noise."""
    generator = np.random.default_rng(0)
    phase = 2 * np.pi * np.linspace(0.0, 1.0, FRAMES)
    waves = np.stack([np.sin(phase), np.cos(phase)])
    inputs = (generator.normal(size=(CYCLES, 1, 2)) @ waves) + np.sin(2 * phase)
    apart = inputs - inputs.mean(axis=0)
    noise = 0.1 * generator.normal(size=(CYCLES, COORDINATES, FRAMES))
    return inputs, 2.0 * apart + noise, np.broadcast_to(4.0 * apart.var(axis=(0, 1)), (COORDINATES, FRAMES))


def found(recorded, of_errors):
    inputs, residual, _ = recorded
    made = None if of_errors is None else InputMade(of_errors, np.full(COORDINATES, 0.01))
    return where(residual, SPEEDS, np.full(CYCLES, 1.0), inputs, 8.0 * COORDINATES, made)


def share(recorded, of_errors):
    return found(recorded, of_errors).explainable.value


def test_what_follows_inputs_is_explainable_but_for_their_errors(recorded):
    made = recorded[2][:, :-1]
    whole = share(recorded, None)
    assert whole > 0.6
    assert share(recorded, made) < 0.1 * whole
    assert share(recorded, 0.0 * made) == whole
    assert 0.3 * whole < share(recorded, 0.5 * made) < 0.8 * whole


def test_what_errors_of_inputs_make_goes_over_to_noise(recorded):
    before, after = (found(recorded, given).budget for given in (None, 0.5 * recorded[2][:, :-1]))
    np.testing.assert_allclose(after.driven + after.noise, before.driven + before.noise, rtol=1e-9)
    assert after.driven.sum() < 0.8 * before.driven.sum()
    np.testing.assert_array_equal(after.repeatable, before.repeatable)
