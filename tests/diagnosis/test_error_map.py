"""The map of the repeatable error: unbiased in size, and not dominated by noise."""

import numpy as np
import pytest

from wrapjax.diagnosis.localization import binned, repeatable_error_map

CYCLES, COORDINATES, FRAMES = 6, 3, 101
SPEEDS = np.repeat([0, 1], CYCLES)
PHASE = np.linspace(0.0, 2.0 * np.pi, FRAMES)


def repeating(generator):
    """Repeatable error, smooth over the cycle, a little different at the second speed."""
    waves = np.stack([np.sin(PHASE), np.cos(2.0 * PHASE), np.sin(3.0 * PHASE)])
    effect_sizes = generator.normal(size=(COORDINATES, 3))
    return np.stack([effect_sizes, effect_sizes + 0.2 * generator.normal(size=effect_sizes.shape)]) @ waves


def noisy(generator, sd):
    """Noise of each cycle, smooth as well, so that averaging over a bin does not remove it."""
    waves = np.stack([wave(k * PHASE) for k in range(1, 9) for wave in (np.sin, np.cos)])
    return sd * generator.normal(size=(2 * CYCLES, COORDINATES, len(waves))) @ waves / np.sqrt(len(waves) / 2)


def test_without_noise_the_map_is_the_repeatable_error():
    """The same error at both speeds, as the means of the speeds are pooled."""
    mean = np.broadcast_to(repeating(np.random.default_rng(0))[:1], (2, COORDINATES, FRAMES))
    found = repeatable_error_map(mean[SPEEDS], SPEEDS, np.zeros_like(mean))
    np.testing.assert_allclose(found, np.sqrt(binned(mean**2)), rtol=1e-9)


@pytest.mark.parametrize("sd", [1.0, 2.0])
def test_noise_is_removed_from_the_map(sd):
    """The map is closer to the true error than the mean cycles are, and its total is right."""
    errors, plain, sizes, wanted = 0.0, 0.0, 0.0, 0.0
    for seed in range(20):
        generator = np.random.default_rng(seed)
        mean = repeating(generator)
        cycles = mean[SPEEDS] + noisy(generator, sd)
        own = np.stack([cycles[speed == SPEEDS].mean(axis=0) for speed in (0, 1)])
        found = repeatable_error_map(cycles, SPEEDS, np.full(mean.shape, sd**2))
        true = np.sqrt(binned(mean**2))
        errors += np.sum((found - true) ** 2)
        plain += np.sum((np.sqrt(binned(own**2)) - true) ** 2)
        sizes += np.sum(found**2)
        wanted += np.sum(true**2)
    assert errors < 0.8 * plain
    assert sizes == pytest.approx(wanted, rel=0.1)


def test_noise_alone_gives_a_small_map():
    generator = np.random.default_rng(1)
    found = repeatable_error_map(noisy(generator, 1.0), SPEEDS, np.ones((2, COORDINATES, FRAMES)))
    assert np.sqrt(np.mean(found**2)) < 0.5 / np.sqrt(CYCLES) and np.isfinite(found).all()


def test_no_bin_exceeds_its_mean_squared_error():
    """An error at one speed only does not appear at the other."""
    cycles = np.where(SPEEDS[:, None, None] == 0, 0.0, np.ones((2 * CYCLES, COORDINATES, FRAMES)))
    found = repeatable_error_map(cycles, SPEEDS, np.zeros((2, COORDINATES, FRAMES)))
    assert found[0].max() == 0.0 and found[1].min() > 0.9 and found[1].max() <= 1.0


def test_without_error_the_map_is_zero():
    cycles = np.zeros((2 * CYCLES, COORDINATES, FRAMES))
    np.testing.assert_array_equal(
        repeatable_error_map(cycles, SPEEDS, np.zeros((2, COORDINATES, FRAMES))), 0.0
    )
