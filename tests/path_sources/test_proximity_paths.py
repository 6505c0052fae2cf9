"""Tests of paths whose proximity to barriers is that of exact paths, and their derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.paths import AdjustablePath
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.proximity_paths import ARM_DEVIATION, LENGTH_DEVIATION, with_exact_proximity

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")
MOMENTS = ("knee_angle_l", "hip_flexion_l", "subtalar_angle_l")
CHANGES = jnp.zeros((2, 6)).at[0].set(jnp.array([3e-4, -3e-4, 3e-4, 0.006, -0.006, 0.006]))


@pytest.fixture(scope="module")
def motion():
    """Two cycles of four frames: angles and angular velocities."""
    generator = np.random.default_rng(3)
    low, high = np.array([-0.3, -0.1, -0.1, 0.1, -0.2]), np.array([0.4, 0.1, 0.1, 0.9, 0.2])
    angles = low[:, None] + (high - low)[:, None] * generator.uniform(size=(2, 5, 4))
    return angles, generator.normal(size=(2, 5, 4))


@pytest.fixture(scope="module")
def combined(s1_left, motion):
    """Fixed paths with the proximity of exact paths; changes of the exact paths are deviations from them."""
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    every_third = tuple(one[:, :, ::3] for one in motion)
    exact = wrapped_paths(engine, *every_third, MOMENTS, ("PS_at_brim_l",))[0]
    fixed = replace(wrapped_paths(engine, *motion, MOMENTS, ())[0].nominal, proximity=None)
    none = jax.tree.map(lambda leaf: jnp.zeros((2, 6, *leaf.shape[1:])), fixed)
    return with_exact_proximity(AdjustablePath(fixed, none), exact, 3)


def test_proximity_combines_barriers_and_deviations_of_exact_paths(combined):
    fixed, exact = combined.paths.nominal, combined.exact
    at = jax.jit(lambda changes: combined.at(changes))
    state, derivatives = jax.jit(lambda changes: combined.linearized(changes))(CHANGES)
    changed = jax.jit(lambda changes: exact.at(changes))(CHANGES)
    np.testing.assert_array_equal(state.length, fixed.length)
    length, arm = changed.length - exact.nominal.length, changed.moment_arm - exact.nominal.moment_arm
    assert np.isfinite(changed.proximity).all()
    assert np.abs(length).max() > 3e-5 and np.abs(arm).max() > 3e-5
    deviation = (length / LENGTH_DEVIATION) ** 2 + np.sum((arm / ARM_DEVIATION) ** 2, axis=2)
    expected = np.sqrt(changed.proximity**2 + deviation)
    frames = [0, 0, 0, 1]
    np.testing.assert_allclose(state.proximity, expected[..., frames], atol=1e-11)
    np.testing.assert_allclose(combined.nominal.proximity, exact.nominal.proximity[..., frames], atol=1e-11)
    for mode in range(6):
        step = jnp.zeros((2, 6)).at[0, mode].set(1e-7)
        difference = (at(CHANGES + step).proximity - at(CHANGES - step).proximity) / 2e-7
        np.testing.assert_allclose(derivatives.proximity[:, mode], difference, atol=1e-5, rtol=1e-5)
    assert np.abs(derivatives.proximity[0]).max() > 0.0
    assert not np.asarray(derivatives.length).any()


@pytest.mark.slow
def test_second_derivatives_equal_differences_of_first_ones(combined):
    """Gauss-Newton terms alone do not include deviations in several directions."""
    generator = np.random.default_rng(7)
    nominal = combined.paths.nominal
    modes = jax.tree.map(lambda leaf: 1e-2 * generator.normal(size=(2, 6, *leaf.shape[1:])), nominal)
    moving = replace(combined, paths=AdjustablePath(nominal, modes))
    changes = CHANGES.at[1].set(CHANGES[0])
    weights = jax.tree.map(lambda leaf: jnp.asarray(generator.normal(size=leaf.shape)), moving.nominal)
    # Weights of a sum of squares: the root alone has a kink where proximity and deviation are zero.
    weights = replace(weights, proximity=jax.jit(lambda changes: moving.at(changes))(changes).proximity)
    curvature = jax.jit(lambda at: moving.curvature(at, weights, moving.linearized(at)))(changes)

    @jax.jit
    def gradient(changes):
        derivatives = moving.linearized(changes)[1]
        products = jax.tree.map(
            lambda leaf, weight: jnp.einsum("mk...,m...->mk", leaf, weight), derivatives, weights
        )
        return jax.tree.reduce(jnp.add, products)

    for mode in range(6):
        step = jnp.zeros((2, 6)).at[:, mode].set(1e-7)
        difference = (gradient(changes + step) - gradient(changes - step)) / 2e-7
        for found, expected in zip(curvature, difference, strict=True):
            np.testing.assert_allclose(found[mode], expected, atol=1e-5 * np.abs(found).max())
    assert np.abs(curvature).max() > 1.0
