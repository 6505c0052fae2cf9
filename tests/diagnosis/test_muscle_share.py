"""Muscle forces that remove the error: resolved with distinct moment arms, distributed with parallel ones."""

import numpy as np
import pytest

from wrapjax.diagnosis.localization import muscle_share

CYCLES, PHASES = 4, 25
SPEEDS = np.array([0, 1, 0, 1])
#: Moment arms about hip, knee and ankle, m; those of the last two muscles are parallel.
MUSCLES = ("hamstring", "quadriceps", "soleus", "gastrocnemius")
ARMS = np.array([[-0.05, 0.03, 0.0], [0.0, -0.04, 0.0], [0.0, 0.0, -0.05], [0.0, 0.0, -0.04]])
FORCES = np.array([1200.0, 2000.0, 2000.0, 2500.0])
BUMP = np.exp(5.0 * (np.cos(2 * np.pi * (np.arange(PHASES) / PHASES - 0.4)) - 1.0))


def shared(place, size=100.0):
    """Share of a force error of one muscle, twice as large at the second speed."""
    missing = size * (1.0 + SPEEDS)[:, None] * BUMP[None]
    residual = ARMS[place][None, :, None] * missing[:, None, :]
    generator = np.random.default_rng(0)
    residual = residual + 0.05 * generator.normal(size=residual.shape)
    arms = np.broadcast_to(ARMS[:, None, :, None], (4, CYCLES, 3, PHASES))
    return muscle_share(MUSCLES, residual, arms, FORCES, np.full(3, 0.05), SPEEDS)


@pytest.mark.parametrize("place", [0, 1])
def test_a_force_error_is_found_in_its_muscle(place):
    """With its sign, in newtons, at each speed."""
    found = shared(place)
    np.testing.assert_allclose(found.force[place], [100.0 * BUMP, 200.0 * BUMP], atol=10.0)
    others = np.delete(found.force, place, axis=0)
    assert np.abs(others).max() < 15.0
    assert found.resolution[place] > 0.9


def test_muscles_with_parallel_arms_share_an_error_at_low_resolution():
    found = shared(2)
    moment = np.tensordot(ARMS[2:, 2], found.force[2:], axes=1)
    np.testing.assert_allclose(moment, ARMS[2, 2] * np.array([100.0 * BUMP, 200.0 * BUMP]), atol=0.4)
    # Each gets a part in proportion to its prior variance.
    np.testing.assert_allclose(found.force[3], found.force[2] * 0.04 * 2500**2 / (0.05 * 2000**2))
    np.testing.assert_allclose(found.resolution[2:], 0.5, atol=0.03)
    assert found.resolution[:2].min() > 0.9
    assert shared(3).force[2] == pytest.approx(0.8 * found.force[2], abs=5.0)


def test_noise_is_not_attributed_to_muscles():
    """Where moments differ between cycles by more than plausible forces cause, resolution is low."""
    generator = np.random.default_rng(1)
    residual = generator.normal(size=(CYCLES, 3, PHASES))
    arms = np.broadcast_to(ARMS[:, None, :, None], (4, CYCLES, 3, PHASES))
    found = muscle_share(MUSCLES, residual, arms, FORCES, np.full(3, 100.0), SPEEDS)
    assert found.resolution.max() < 0.1
    assert np.abs(found.force / FORCES[:, None, None]).max() < 0.005
