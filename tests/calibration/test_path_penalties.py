"""Path modes have unit penalty, and limits apply to moment arms that keep their sign."""

import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.calibration.path_penalties import FIBER_LENGTH_RANGE, path_limits
from wrapjax.geometry.paths import PathState
from wrapjax.path_sources.polynomial_paths import path_modes

COORDINATES = ("hip_flexion_l", "knee_angle_l")
MUSCLES, TERMS, TRIALS, FRAMES = 2, 5, 2, 30


def smooth(generator, *shape):
    """Draw smooth signals with a mean and a shape."""
    time = np.linspace(0.0, 2.0 * np.pi, FRAMES)
    level, wave, phase = generator.normal(size=(3, *shape, 1))
    return level + wave * np.sin(time + phase)


@pytest.fixture(scope="module")
def paths():
    generator = np.random.default_rng(4)
    nominal = PathState(
        jnp.asarray(0.4 + 0.02 * smooth(generator, MUSCLES, TRIALS)),
        jnp.zeros((MUSCLES, TRIALS, FRAMES)),
        jnp.asarray(0.05 + 0.01 * smooth(generator, MUSCLES, TRIALS, 2)),
    )
    by_coefficient = PathState(
        jnp.asarray(smooth(generator, MUSCLES, TERMS, TRIALS)),
        jnp.zeros((MUSCLES, TERMS, TRIALS, FRAMES)),
        jnp.asarray(smooth(generator, MUSCLES, TERMS, TRIALS, 2)),
    )
    used = np.array([[True] * 5, [True] * 3 + [False] * 2])
    return nominal, by_coefficient, used


def penalty(nominal, length, arm, coefficients):
    """Compute the terms of Meyer et al.: mean and shape of length and arms relative to their ranges."""
    total = np.sum((coefficients / 3e-3) ** 2)
    span = max(np.ptp(nominal.length), 0.01)
    total += (length.mean() / span) ** 2 + np.mean(((length - length.mean()) / (0.25 * span)) ** 2)
    for place, shape in enumerate((0.25, 0.125)):
        span = max(np.ptp(nominal.moment_arm[:, place]), 0.01)
        own = arm[:, place]
        total += (own.mean() / (0.5 * span)) ** 2 + np.mean(((own - own.mean()) / (shape * span)) ** 2)
    return total


def test_penalty_of_a_change_is_the_squared_norm_of_its_mode_coefficients(paths):
    nominal, by_coefficient, used = paths
    modes = path_modes(nominal, by_coefficient, used, COORDINATES)
    generator = np.random.default_rng(5)
    for muscle in range(MUSCLES):
        changes = generator.normal(size=TERMS) * used[muscle]
        coefficients = modes[muscle] @ changes
        length = np.tensordot(coefficients, by_coefficient.length[muscle], axes=1)
        arm = np.tensordot(coefficients, by_coefficient.moment_arm[muscle], axes=1)
        own = PathState(nominal.length[muscle], nominal.velocity[muscle], nominal.moment_arm[muscle])
        np.testing.assert_allclose(penalty(own, length, arm, coefficients), changes @ changes, rtol=1e-9)


def test_a_muscle_has_as_many_modes_as_coefficients(paths):
    nominal, by_coefficient, used = paths
    modes = path_modes(nominal, by_coefficient, used, COORDINATES)
    assert (modes[1, 3:] == 0.0).all() and (modes[1, :, 3:] == 0.0).all()
    assert np.linalg.matrix_rank(modes[1]) == 3 and np.linalg.matrix_rank(modes[0]) == 5


def test_arms_that_cross_zero_or_are_zero_have_no_limit():
    arm = np.full((3, 1, 2, 4), 0.03)
    arm[0, 0, 1] = -0.02
    arm[1, 0, 0, 2] = -0.001
    arm[2, 0, 1] = 0.0
    length = jnp.full((3, 1, 4), 0.3)
    fiber_long, fiber_short, sign = path_limits(PathState(length, length, jnp.asarray(arm)))
    turned = np.where(arm == 0.0, 0.01, -arm).reshape(3, -1)
    above = np.asarray(sign.excess(jnp.asarray(turned))).reshape(3, 2, 4) > 0.0
    np.testing.assert_array_equal(above.all(axis=2), [[True, True], [False, True], [True, False]])
    # The excess is in cm.
    np.testing.assert_allclose(np.asarray(sign.excess(jnp.asarray(turned)))[0, :4], 3.0)
    shortest, longest = FIBER_LENGTH_RANGE
    values = jnp.array([[longest], [shortest], [1.0]])
    np.testing.assert_allclose(fiber_long.excess(values)[:, 0], [0.0, shortest - longest, 1.0 - longest])
    np.testing.assert_allclose(fiber_short.excess(values)[:, 0], [shortest - longest, 0.0, shortest - 1.0])
