"""Paths that follow their cylinders: derivatives of both orders, rates, and walls that are not got over."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.paths import AdjustablePath
from wrapjax.geometry.wrapped_paths import wrapped_paths
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.polynomial_paths import ARM_DEVIATION, LENGTH_DEVIATION, with_exact_proximity

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")
MUSCLES = ("psoas_l", "soleus_l", "gasmed_l", "addlong_l")
FREE = ("PS_at_brim_l", "GasMed_at_shank_l", "Gastroc_at_condyles_l")
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
def moved(paths):
    """A change of every freed cylinder, small enough to stay off the walls."""
    size = np.array([1e-3, 1e-3, 1e-3, 0.03, 0.03, 0.03])
    change = np.tile(size, 2) * np.random.default_rng(4).uniform(-1, 1, (len(MUSCLES), 12))
    assert np.isfinite(paths.at(jnp.asarray(change)).proximity).all()
    return jnp.asarray(change)


def test_no_change_leaves_paths_as_the_model_has_them(paths):
    path = paths.at(jnp.zeros((4, 12)))
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-13), path, paths.nominal)
    # The subtalar joint is no coordinate of this engine.
    assert not np.asarray(path.moment_arm[:, :, 2]).any()


def test_only_muscles_by_free_cylinders_move(paths, moved):
    path = paths.at(moved)
    change = np.abs(path.length - paths.nominal.length).max(axis=(1, 2))
    assert change[0] > 1e-5
    assert change[2] > 1e-5
    np.testing.assert_array_equal(change[[1, 3]], 0.0)


def test_rate_is_that_of_the_length_while_joints_move(engine, motion, paths):
    angles, velocities = motion
    step = 1e-6
    ahead, behind = (
        wrapped_paths(engine, angles + sign * step * velocities, velocities, MOMENTS, ())[0]
        for sign in (1, -1)
    )
    rate = (ahead.nominal.length - behind.nominal.length) / (2 * step)
    np.testing.assert_allclose(paths.nominal.velocity, rate, atol=1e-8)


def test_walls_stand_in_cycles_beside_too(s1_left, motion):
    """What is laid is the second cycle's alone; the first one's closeness lies over its own."""
    angles, velocities = motion
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    both = wrapped_paths(engine, angles, velocities, MOMENTS, FREE[:1])[0].nominal
    kept = wrapped_paths(engine, angles[1:], velocities[1:], MOMENTS, FREE[:1], barrier_angles=angles[:1])[
        0
    ].nominal
    np.testing.assert_allclose(kept.length, both.length[:, 1:], atol=1e-14)
    np.testing.assert_allclose(kept.moment_arm, both.moment_arm[:, 1:], atol=1e-14)
    squares = np.sum(np.asarray(both.proximity) ** 2, axis=1)
    assert (squares > 1.1 * np.asarray(both.proximity)[:, 1] ** 2).any()
    np.testing.assert_allclose(kept.proximity[:, 0] ** 2, squares, rtol=1e-12, atol=1e-20)
    three = wrapped_paths(
        engine, angles[:1], velocities[:1], MOMENTS, FREE[:1], barrier_angles=angles[[1, 1]]
    )[0]
    assert three.nominal.proximity.shape == kept.proximity.shape


def test_first_derivatives_equal_differences(paths, moved):
    at = jax.jit(lambda changes: paths.at(changes))
    here, slopes = jax.jit(lambda changes: paths.linearized(changes))(moved)
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-13), here, at(moved))
    for mode in range(12):
        step = jnp.zeros((4, 12)).at[:, mode].set(1e-6)
        difference = jax.tree.map(lambda a, b: (a - b) / 2e-6, at(moved + step), at(moved - step))
        jax.tree.map(
            lambda slope, other, mode=mode: np.testing.assert_allclose(
                slope[:, mode], other, atol=2e-6, rtol=1e-5
            ),
            slopes,
            difference,
        )


def test_second_derivatives_equal_differences_of_first_ones(s1_left, motion):
    """Of paths round one cylinder, of those that move."""
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    paths = wrapped_paths(engine, *motion, MOMENTS, ("PS_at_brim_l",))[0]
    moved = jnp.zeros((2, 6)).at[0].set(jnp.array([1e-3, -1e-3, 1e-3, 0.02, -0.02, 0.02]))
    generator = np.random.default_rng(5)
    weights = jax.tree.map(lambda leaf: jnp.asarray(generator.normal(size=leaf.shape)), paths.nominal)
    curvature = jax.jit(lambda at: paths.curvature(at, weights, paths.linearized(at)))(moved)

    @jax.jit
    def slope(changes):
        products = jax.tree.map(
            lambda leaf, weight: jnp.einsum("mk...,m...->mk", leaf, weight),
            paths.linearized(changes)[1],
            weights,
        )
        return jax.tree.reduce(jnp.add, products)

    for mode in range(6):
        step = jnp.zeros((2, 6)).at[:, mode].set(1e-6)
        difference = (slope(moved + step) - slope(moved - step)) / 2e-6
        np.testing.assert_allclose(curvature[0, mode], difference[0], atol=1e-5 * np.abs(curvature[0]).max())
    assert np.abs(curvature[0]).max() > 1.0
    np.testing.assert_array_equal(curvature[1], 0.0)


def test_of_paths_round_several_only_walls_bend(paths, moved):
    """Towards the wall that is nearest, about as differences of slopes say; all else is left out."""
    muscle = MUSCLES.index("gasmed_l")
    several = replace(paths, groups=tuple(group for group in paths.groups if muscle in group.muscles))
    linearized = jax.jit(lambda at: several.linearized(at))
    weights = jax.tree.map(jnp.ones_like, paths.nominal)
    blind = replace(weights, proximity=jnp.zeros_like(weights.proximity))
    np.testing.assert_array_equal(several.curvature(moved, blind, linearized(moved)), 0.0)
    # Two millimeters before the cylinder is where the wall stands.
    near, step = moved.at[muscle, 1].add(-0.016), 1e-6
    assert 5.0 < linearized(near)[0].proximity[muscle].max() < 50.0
    here = several.curvature(near, weights, linearized(near))[muscle, 1, 1]
    ends = [linearized(near.at[muscle, 1].add(by))[1].proximity[muscle, 1].sum() for by in (step, -step)]
    np.testing.assert_allclose(here, (ends[0] - ends[1]) / (2.0 * step), rtol=0.2)


def test_closeness_grows_without_bound_towards_a_wall(paths):
    """A cylinder is moved on to the path's points: closeness rises, and beyond them it is infinite."""
    reach = np.linspace(0.0, 0.03, 61)
    at = jax.jit(lambda changes: paths.at(changes))
    largest = []
    for step in reach:
        change = jnp.zeros((4, 12)).at[0, 1].set(-step)
        largest.append(float(jnp.max(at(change).proximity[0])))
    barrier = np.flatnonzero(np.isinf(largest))
    assert barrier.size
    assert np.isinf(largest[barrier[0] :]).all()
    assert largest[barrier[0] - 1] > 3.0 * largest[0]
    # The nearest wall is as near to the nominal path as makes closeness one; others are far.
    assert largest[0] == pytest.approx(1.0, rel=1e-3)


def test_to_lose_a_cylinder_is_a_wall(paths):
    """A cylinder is moved out of a muscle's reach: what no pose touches any more is infinitely close."""
    at = jax.jit(lambda changes: paths.at(changes))
    psoas = MUSCLES.index("psoas_l")
    lost = at(jnp.zeros((4, 12)).at[psoas, 0].set(-0.05))
    assert np.isinf(lost.proximity[psoas]).all()
    np.testing.assert_array_less(lost.length[psoas], paths.nominal.length[psoas].max())
    assert np.isfinite(lost.proximity[MUSCLES.index("gasmed_l")]).all()


@pytest.fixture(scope="module")
def guarded(s1_left, motion):
    """Paths that do not move at all: what the exact ones move by, they stray by. And those exact ones."""
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("psoas_l", "soleus_l"), COORDINATES)
    every_third = tuple(one[:, :, ::3] for one in motion)
    exact = wrapped_paths(engine, *every_third, MOMENTS, ("PS_at_brim_l",))[0]
    held = replace(wrapped_paths(engine, *motion, MOMENTS, ())[0].nominal, proximity=None)
    none = jax.tree.map(lambda leaf: jnp.zeros((2, 6, *leaf.shape[1:])), held)
    return with_exact_proximity(AdjustablePath(held, none), exact, 3)


CHANGES = jnp.zeros((2, 6)).at[0].set(jnp.array([3e-4, -3e-4, 3e-4, 0.006, -0.006, 0.006]))


def test_guarded_paths_know_walls_and_straying_by_the_exact_ones(guarded):
    held, exact = guarded.paths.nominal, guarded.exact
    at = jax.jit(lambda changes: guarded.at(changes))
    state, slopes = jax.jit(lambda changes: guarded.linearized(changes))(CHANGES)
    known = jax.jit(lambda changes: exact.at(changes))(CHANGES)
    np.testing.assert_array_equal(state.length, held.length)
    length, arm = known.length - exact.nominal.length, known.moment_arm - exact.nominal.moment_arm
    assert np.isfinite(known.proximity).all()
    assert np.abs(length).max() > 3e-5 and np.abs(arm).max() > 3e-5
    strayed = (length / LENGTH_DEVIATION) ** 2 + np.sum((arm / ARM_DEVIATION) ** 2, axis=2)
    expected = np.sqrt(known.proximity**2 + strayed)
    frames = [0, 0, 0, 1]
    np.testing.assert_allclose(state.proximity, expected[..., frames], atol=1e-11)
    np.testing.assert_allclose(guarded.nominal.proximity, exact.nominal.proximity[..., frames], atol=1e-11)
    for mode in range(6):
        step = jnp.zeros((2, 6)).at[0, mode].set(1e-7)
        difference = (at(CHANGES + step).proximity - at(CHANGES - step).proximity) / 2e-7
        np.testing.assert_allclose(slopes.proximity[:, mode], difference, atol=1e-5, rtol=1e-5)
    assert np.abs(slopes.proximity[0]).max() > 0.0
    assert not np.asarray(slopes.length).any()


def test_second_derivatives_of_guarded_paths_equal_differences_of_first_ones(guarded):
    """Straying in several directions at once is what slopes alone do not show a solver of least squares."""
    generator = np.random.default_rng(7)
    unguarded = guarded.paths.nominal
    modes = jax.tree.map(lambda leaf: 1e-2 * generator.normal(size=(2, 6, *leaf.shape[1:])), unguarded)
    moving = replace(guarded, paths=AdjustablePath(unguarded, modes))
    changes = CHANGES.at[1].set(CHANGES[0])
    weights = jax.tree.map(lambda leaf: jnp.asarray(generator.normal(size=leaf.shape)), moving.nominal)
    # As a sum of squares has it: the root alone has a kink where nothing is near and nothing strays.
    weights = replace(weights, proximity=jax.jit(lambda changes: moving.at(changes))(changes).proximity)
    curvature = jax.jit(lambda at: moving.curvature(at, weights, moving.linearized(at)))(changes)

    @jax.jit
    def slope(changes):
        slopes = moving.linearized(changes)[1]
        products = jax.tree.map(
            lambda leaf, weight: jnp.einsum("mk...,m...->mk", leaf, weight), slopes, weights
        )
        return jax.tree.reduce(jnp.add, products)

    for mode in range(6):
        step = jnp.zeros((2, 6)).at[:, mode].set(1e-7)
        difference = (slope(changes + step) - slope(changes - step)) / 2e-7
        for found, expected in zip(curvature, difference, strict=True):
            np.testing.assert_allclose(found[mode], expected, atol=1e-5 * np.abs(found).max())
    assert np.abs(curvature).max() > 1.0
