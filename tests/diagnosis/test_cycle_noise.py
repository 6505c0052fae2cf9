"""Estimation of the noise between cycles and of the size of input errors."""

import numpy as np
import pytest

from tests.diagnosis.noise import noise_of_width
from wrapjax.diagnosis.null_hypotheses.cycle_noise import cycle_noise
from wrapjax.diagnosis.null_hypotheses.error_sources import InputErrors, input_blocks, periodic_kernel

COORDINATES, PHASES = 2, 12
BETWEEN = np.array([[2.0, -0.5], [-0.5, 1.0]])


def found_on_average(share, cycles=8, draws=60):
    """Mean squared share, mean covariance, and variance by coordinate by input errors of expected size."""
    generator = np.random.default_rng(0)
    speeds = np.arange(cycles) % 2
    wave = 1.0 + 0.3 * np.cos(2 * np.pi * np.arange(PHASES) / PHASES)
    inputs = InputErrors(generator.normal(size=(2, cycles, COORDINATES, 1)) * wave, 0.1)
    blocks = input_blocks(inputs)
    truth = noise_of_width(BETWEEN, 0.05).block(PHASES) + share**2 * blocks
    factors = np.linalg.cholesky(truth)
    drawn = np.einsum("cij,ncj->nci", factors, generator.normal(size=(draws, *truth.shape[:2])))
    residuals = drawn.reshape(draws, cycles, COORDINATES, PHASES) + 5.0 * speeds[:, None, None]
    found = [cycle_noise(own, speeds, [inputs]) for own in residuals]
    by_input = np.diagonal(blocks, axis1=1, axis2=2).reshape(cycles, COORDINATES, PHASES).mean(axis=(0, 2))
    squares = np.mean([one.input_shares[0] ** 2 for one in found])
    return squares, np.mean([one.between for one in found], axis=0), by_input


@pytest.mark.parametrize("share", [0.0, 0.7, 1.5])
def test_noise_and_input_errors_add_up_to_the_variance(share):
    """On average, with as few as four cycles at each speed."""
    squares, between, by_input = found_on_average(share)
    whole = np.diag(BETWEEN) + share**2 * by_input
    np.testing.assert_allclose(np.diag(between) + squares * by_input, whole, rtol=0.1)


@pytest.mark.parametrize("share", [0.0, 0.7, 1.5])
def test_the_size_of_input_errors_is_estimated(share):
    squares, between, by_input = found_on_average(share, cycles=40, draws=20)
    assert np.sqrt(squares) == pytest.approx(share, abs=0.15)
    # Shares are on a grid, so that a small part of the input errors counts as noise.
    left = np.abs(np.diag(between) - np.diag(BETWEEN))
    assert np.all(left < 0.1 * np.diag(BETWEEN) + 0.15 * share**2 * by_input)


def test_inputs_without_influence_do_not_change_the_noise():
    generator = np.random.default_rng(1)
    residuals = generator.normal(size=(6, COORDINATES, PHASES))
    silent = InputErrors(np.zeros((1, 6, COORDINATES, PHASES)), 0.1)
    speeds = np.repeat([0, 1], 3)
    plain, with_silent = (cycle_noise(residuals, speeds, inputs) for inputs in ((), (silent,)))
    assert plain.input_shares == ()
    np.testing.assert_allclose(plain.spectrum, with_silent.spectrum)
    np.testing.assert_allclose(plain.between, with_silent.between)


@pytest.mark.parametrize("phases", [24, 25])
def test_noise_can_have_several_widths(phases):
    """The powers of slow and fast noise are both estimated."""
    generator = np.random.default_rng(2)
    kernel = 0.7 * periodic_kernel(phases, 0.15) + 0.3 * periodic_kernel(phases, 0.02)
    factor = np.linalg.cholesky(np.kron(BETWEEN, kernel))
    speeds = np.repeat([0, 1], 40)
    drawn = (generator.normal(size=(80, len(factor))) @ factor.T).reshape(80, COORDINATES, phases)
    found = cycle_noise(drawn, speeds).block(phases)[:phases, :phases] / BETWEEN[0, 0]
    waves = np.stack([np.cos(2 * np.pi * h * np.arange(phases) / phases) for h in range(phases // 2)])
    power = np.einsum("hp,pq,hq->h", waves, found, waves) / np.einsum("hp,pq,hq->h", waves, kernel, waves)
    assert np.all((power > 0.6) & (power < 1.7)) and 0.9 < power[1:4].mean() < 1.1


def test_harmonics_removed_by_filters_keep_some_noise():
    generator = np.random.default_rng(3)
    waves = np.stack([np.cos(2 * np.pi * h * np.arange(PHASES) / PHASES) for h in range(3)])
    drawn = generator.normal(size=(8, COORDINATES, 3)) @ waves
    noise = cycle_noise(drawn, np.repeat([0, 1], 4))
    values = np.linalg.eigvalsh(noise.block(PHASES))
    assert values[0] > 0.002 * np.diag(noise.block(PHASES)).min()


def test_single_cycles_at_each_speed_are_refused():
    with pytest.raises(ValueError, match=r"\[1, 1\]"):
        cycle_noise(np.zeros((2, 1, PHASES)), np.array([0, 1]))
