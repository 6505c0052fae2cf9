"""Static optimization balances moments with the least squared activations within the bounds."""

import numpy as np
import pytest
from scipy.optimize import minimize

from wrapjax.contact_forces.static_optimization import share_moments

MUSCLES, COORDINATES, FRAMES = 5, 3, 4


@pytest.fixture(scope="module")
def leg():
    """Moment arms and forces of muscles, and moments that some of them can balance."""
    generator = np.random.default_rng(3)
    arm = generator.uniform(-0.05, 0.05, (MUSCLES, COORDINATES, FRAMES))
    active = generator.uniform(300.0, 2000.0, (MUSCLES, FRAMES))
    true = generator.uniform(-0.4, 1.0, (MUSCLES, FRAMES)).clip(0.0)
    missing = np.einsum("mcf,mf->cf", arm, true * active)
    return missing, arm, active


def test_two_muscles_share_in_proportion_to_their_moments():
    """Least squares gives activations proportional to the moments at full activation."""
    arm = np.array([[[0.04]], [[0.02]]])
    force = np.array([[1000.0], [500.0]])
    found = share_moments(np.array([[20.0]]), arm, force, residual_scale=1e-4)
    capacity = (arm[:, 0, 0] * force[:, 0]).round(12)
    np.testing.assert_allclose(found.activation[:, 0], 20.0 * capacity / (capacity**2).sum(), rtol=1e-6)
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-6)


@pytest.mark.parametrize("scale", [0.3, 10.0])
def test_it_agrees_with_a_general_optimizer(leg, scale):
    missing, arm, active = leg
    found = share_moments(missing, arm, active, residual_scale=scale)
    for frame in range(FRAMES):

        def effort(a, frame=frame):
            given = arm[:, :, frame].T @ (a * active[:, frame])
            return (a**2).sum() + (((missing[:, frame] - given) / scale) ** 2).sum()

        def slope(a, frame=frame):
            given = arm[:, :, frame].T @ (a * active[:, frame])
            by_moment = 2.0 * (given - missing[:, frame]) / scale**2
            return 2.0 * a + active[:, frame] * (arm[:, :, frame] @ by_moment)

        best = minimize(
            effort,
            np.full(MUSCLES, 0.3),
            jac=slope,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * MUSCLES,
            options={"ftol": 1e-13, "maxiter": 500},
        )
        assert effort(found.activation[:, frame]) <= best.fun + 1e-9 * max(1.0, best.fun)
        np.testing.assert_allclose(found.activation[:, frame], best.x, atol=1e-4)


def test_residuals_are_the_remaining_moments(leg):
    missing, arm, active = leg
    found = share_moments(5.0 * missing, arm, active)
    given = np.einsum("mcf,mf->cf", arm, found.activation * active)
    np.testing.assert_allclose(found.residual, 5.0 * missing - given, atol=1e-10)
    assert found.activation.min() >= 0.0
    assert found.activation.max() <= 1.0
    assert np.abs(found.residual).max() > 1.0  # Five times the moments are more than the muscles can balance.


def test_residuals_remain_only_where_muscles_are_too_weak():
    arm, force = np.full((1, 1, 1), 0.05), np.full((1, 1), 1000.0)
    found = share_moments(np.full((1, 1), 80.0), arm, force, residual_scale=1.0)
    np.testing.assert_allclose(found.activation, 1.0)
    np.testing.assert_allclose(found.residual, 30.0)


def test_without_muscles_all_moments_remain():
    found = share_moments(np.ones((2, 3)), np.zeros((0, 2, 3)), np.zeros((0, 3)))
    assert found.activation.shape == (0, 3)
    np.testing.assert_array_equal(found.residual, 1.0)
