"""Tests of paths as a function of wrap parameters: derivatives, rates and proximity to barriers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.osim.model import describe_model

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")
MUSCLES = ("psoas_l", "soleus_l", "iliacus_l", "addlong_l")
FREE = ("PS_at_brim_l", "IL_at_brim_l")
# A muscle round two cylinders, whose program takes half a minute to compile.
CALF, FREE_OF_CALF = "gasmed_l", ("GasMed_at_shank_l", "Gastroc_at_condyles_l")
MOMENTS = ("knee_angle_l", "hip_flexion_l", "subtalar_angle_l")


@pytest.fixture(scope="module")
def engine(s1_left):
    return ExactPaths(describe_model(s1_left / "model.osim"), MUSCLES, COORDINATES)


@pytest.fixture(scope="module")
def motion():
    """Two cycles of four frames: angles and angular velocities."""
    generator = np.random.default_rng(3)
    low, high = np.array([-0.3, -0.1, -0.1, 0.1, -0.2]), np.array([0.4, 0.1, 0.1, 0.9, 0.2])
    angles = low[:, None] + (high - low)[:, None] * generator.uniform(size=(2, 5, 4))
    return angles, generator.normal(size=(2, 5, 4))


@pytest.fixture(scope="module")
def paths(engine, motion):
    return wrapped_paths(engine, *motion, MOMENTS, FREE)[0]


@pytest.fixture(scope="module")
def round_two(s1_left, motion):
    """Paths of a muscle round two free cylinders."""
    engine = ExactPaths(describe_model(s1_left / "model.osim"), (CALF,), COORDINATES)
    return wrapped_paths(engine, *motion, MOMENTS, FREE_OF_CALF)[0]


def changes_within_barriers(paths, muscles, wraps, seed):
    """Changes of all free wraps, small enough to stay within the barriers."""
    size = np.array([1e-3, 1e-3, 1e-3, 0.03, 0.03, 0.03])
    change = np.tile(size, wraps) * np.random.default_rng(seed).uniform(-1, 1, (muscles, 6 * wraps))
    assert np.isfinite(paths.at(jnp.asarray(change)).proximity).all()
    return jnp.asarray(change)


@pytest.fixture(scope="module")
def moved(paths):
    return changes_within_barriers(paths, len(MUSCLES), 1, seed=1)


def test_zero_changes_give_nominal_paths(paths):
    path = paths.at(jnp.zeros((4, 6)))
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-13), path, paths.nominal)
    # The subtalar angle is not a coordinate of this engine.
    assert not np.asarray(path.moment_arm[:, :, 2]).any()


def test_only_muscles_with_free_wraps_change(paths, moved):
    path = paths.at(moved)
    change = np.abs(path.length - paths.nominal.length).max(axis=(1, 2))
    assert change[0] > 1e-5
    assert change[2] > 1e-5
    np.testing.assert_array_equal(change[[1, 3]], 0.0)


def test_velocity_is_the_rate_of_length(engine, motion, paths):
    angles, velocities = motion
    step = 1e-6
    ahead, behind = (
        wrapped_paths(engine, angles + sign * step * velocities, velocities, MOMENTS, ())[0]
        for sign in (1, -1)
    )
    rate = (ahead.nominal.length - behind.nominal.length) / (2 * step)
    np.testing.assert_allclose(paths.nominal.velocity, rate, atol=1e-8)


def test_barriers_apply_in_further_cycles(s1_left, motion):
    """Paths are those of the second cycle alone, with the first cycle's proximity added to the second's."""
    angles, velocities = motion
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    both = wrapped_paths(engine, angles, velocities, MOMENTS, FREE[:1])[0].nominal
    second = wrapped_paths(engine, angles[1:], velocities[1:], MOMENTS, FREE[:1], barrier_angles=angles[:1])[
        0
    ].nominal
    np.testing.assert_allclose(second.length, both.length[:, 1:], atol=1e-14)
    np.testing.assert_allclose(second.moment_arm, both.moment_arm[:, 1:], atol=1e-14)
    squares = np.sum(np.asarray(both.proximity) ** 2, axis=1)
    assert (squares > 1.1 * np.asarray(both.proximity)[:, 1] ** 2).any()
    np.testing.assert_allclose(second.proximity[:, 0] ** 2, squares, rtol=1e-12, atol=1e-20)
    barriers = angles[[1, 1]]
    three = wrapped_paths(engine, angles[:1], velocities[:1], MOMENTS, FREE[:1], barrier_angles=barriers)[0]
    assert three.nominal.proximity.shape == second.proximity.shape


def assert_first_derivatives_equal_differences(paths, moved):
    at = jax.jit(lambda changes: paths.at(changes))
    here, derivatives = jax.jit(lambda changes: paths.linearized(changes))(moved)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-13), here, at(moved))
    for mode in range(moved.shape[1]):
        step = jnp.zeros(moved.shape).at[:, mode].set(1e-6)
        difference = jax.tree.map(lambda a, b: (a - b) / 2e-6, at(moved + step), at(moved - step))
        jax.tree.map(
            lambda derivative, other, mode=mode: np.testing.assert_allclose(
                derivative[:, mode], other, atol=2e-6, rtol=1e-5
            ),
            derivatives,
            difference,
        )


def test_first_derivatives_equal_differences(paths, moved):
    assert_first_derivatives_equal_differences(paths, moved)


@pytest.mark.slow
def test_first_derivatives_round_two_cylinders_equal_differences(round_two):
    moved = changes_within_barriers(round_two, 1, 2, seed=20)
    assert np.abs(round_two.at(moved).length - round_two.nominal.length).max() > 1e-5
    assert_first_derivatives_equal_differences(round_two, moved)


def test_second_derivatives_equal_differences_of_first_ones(s1_left, motion):
    """For muscles with one cylinder; those without free wraps have zero curvature."""
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    paths = wrapped_paths(engine, *motion, MOMENTS, ("PS_at_brim_l",))[0]
    moved = jnp.zeros((2, 6)).at[0].set(jnp.array([1e-3, -1e-3, 1e-3, 0.02, -0.02, 0.02]))
    generator = np.random.default_rng(5)
    weights = jax.tree.map(lambda leaf: jnp.asarray(generator.normal(size=leaf.shape)), paths.nominal)
    curvature = jax.jit(lambda at: paths.curvature(at, weights, paths.linearized(at)))(moved)

    @jax.jit
    def gradient(changes):
        products = jax.tree.map(
            lambda leaf, weight: jnp.einsum("mk...,m...->mk", leaf, weight),
            paths.linearized(changes)[1],
            weights,
        )
        return jax.tree.reduce(jnp.add, products)

    for mode in range(6):
        step = jnp.zeros((2, 6)).at[:, mode].set(1e-6)
        difference = (gradient(moved + step) - gradient(moved - step)) / 2e-6
        np.testing.assert_allclose(curvature[0, mode], difference[0], atol=1e-5 * np.abs(curvature[0]).max())
    assert np.abs(curvature[0]).max() > 1.0
    np.testing.assert_array_equal(curvature[1], 0.0)


@pytest.mark.slow
def test_curvature_with_several_cylinders_is_that_of_the_proximity_alone(round_two):
    """It approximates the differences of first derivatives near a barrier; all other terms are left out."""
    moved = changes_within_barriers(round_two, 1, 2, seed=20)
    linearized = jax.jit(lambda at: round_two.linearized(at))
    weights = jax.tree.map(jnp.ones_like, round_two.nominal)
    without_proximity = replace(weights, proximity=jnp.zeros_like(weights.proximity))
    np.testing.assert_array_equal(round_two.curvature(moved, without_proximity, linearized(moved)), 0.0)
    # The barrier is two millimeters before the cylinder.
    near, step = moved.at[0, 1].add(-0.016), 1e-6
    assert 5.0 < linearized(near)[0].proximity.max() < 50.0
    here = round_two.curvature(near, weights, linearized(near))[0, 1, 1]
    ends = [linearized(near.at[0, 1].add(by))[1].proximity[0, 1].sum() for by in (step, -step)]
    np.testing.assert_allclose(here, (ends[0] - ends[1]) / (2.0 * step), rtol=0.2)


def test_proximity_grows_without_bound_towards_a_barrier(paths):
    """A cylinder moves towards path points: the proximity increases, and is infinite beyond the barrier."""
    reach = np.linspace(0.0, 0.03, 61)
    at = jax.jit(lambda changes: paths.at(changes))
    largest = []
    for step in reach:
        change = jnp.zeros((4, 6)).at[0, 1].set(-step)
        largest.append(float(jnp.max(at(change).proximity[0])))
    barrier = np.flatnonzero(np.isinf(largest))
    assert barrier.size
    assert np.isinf(largest[barrier[0] :]).all()
    assert largest[barrier[0] - 1] > 3.0 * largest[0]
    # The nearest barrier is at unit clearance from the nominal path, and others are far.
    assert largest[0] == pytest.approx(1.0, rel=1e-3)


def test_loss_of_contact_in_all_poses_is_a_barrier(paths):
    """A cylinder moves out of a muscle's reach: without contact in any pose the proximity is infinite."""
    at = jax.jit(lambda changes: paths.at(changes))
    psoas = MUSCLES.index("psoas_l")
    lost = at(jnp.zeros((4, 6)).at[psoas, 0].set(-0.05))
    assert np.isinf(lost.proximity[psoas]).all()
    np.testing.assert_array_less(lost.length[psoas], paths.nominal.length[psoas].max())
    kept = lost.proximity[MUSCLES.index("iliacus_l")]
    assert np.isfinite(kept).all() and kept.max() > 0.0
