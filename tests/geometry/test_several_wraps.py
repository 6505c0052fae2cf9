"""Defends: contacts with several wraps have derivatives that solve their equations, and programs that end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from validation.wrapping.single_path import COORDINATES, SurfaceDraw, write_model
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.several_wraps import solve_without_lapack
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.muscle_paths import muscle_paths

# Batched LAPACK routines that run at once may wait for each other forever.
LAPACK = ("triangular_solve", "lu", "cholesky", "eigh", "qr", "svd")


@settings(deadline=None, max_examples=50)
@given(size=st.sampled_from([1, 2, 6, 12]), seed=st.integers(0, 2**31 - 1))
def test_a_small_system_is_solved(size, seed):
    generator = np.random.default_rng(seed)
    matrix, expected = generator.normal(size=(size, size)), generator.normal(size=size)
    found = solve_without_lapack(jnp.asarray(matrix), jnp.asarray(matrix @ expected))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.linalg.cond(matrix) * size)


def test_a_small_system_may_begin_with_a_zero():
    """As in a permutation, where elimination without pivoting divides by zero."""
    found = solve_without_lapack(jnp.eye(4)[jnp.array([1, 0, 3, 2])], jnp.arange(4.0))
    np.testing.assert_array_equal(found, [1.0, 0.0, 3.0, 2.0])


def test_rows_of_a_small_system_may_differ_in_size():
    """A large pivot must not be subtracted from itself."""
    found = solve_without_lapack(jnp.array([[1e12, 1e12], [0.0, 1e-6]]), jnp.array([3e12, 1e-6]))
    np.testing.assert_allclose(found, [2.0, 1.0], rtol=1e-14)


def test_a_small_system_has_the_derivatives_of_its_solution():
    generator = np.random.default_rng(1)
    matrix, side = jnp.asarray(generator.normal(size=(6, 6))), jnp.asarray(generator.normal(size=6))

    def curvature(solve):
        return jax.hessian(lambda step: jnp.sum(solve(matrix + step * jnp.eye(6), side * (1.0 + step)) ** 2))

    found, expected = (curvature(solve)(0.1) for solve in (solve_without_lapack, jnp.linalg.solve))
    assert float(found) == pytest.approx(float(expected), rel=1e-9)


def test_paths_need_no_lapack(s1_left):
    """Second derivatives of a path round two cylinders solve two systems at once."""
    coordinates = ("hip_flexion_l", "knee_angle_l", "ankle_angle_l")
    free = ("GasMed_at_shank_l", "Gastroc_at_condyles_l")
    engine = ExactPaths(describe_model(s1_left / "model.osim"), ("gasmed_l",), coordinates)
    angles = np.full((1, 3, 2), 0.2)
    paths, _ = wrapped_paths(engine, angles, np.zeros_like(angles), coordinates, free)

    def second(change):
        return jax.jvp(
            lambda at: jax.jvp(lambda x: paths.at(x).length, (at,), (at,))[1], (change,), (change,)
        )

    program = str(jax.make_jaxpr(second)(jnp.full((1, 12), 1e-3)))
    assert "custom_linear_solve" in program
    assert not [name for name in LAPACK if f" {name}[" in program]


@pytest.mark.slow
def test_where_contacts_with_overlapping_surfaces_do_not_converge_a_path_is_not_regular(tmp_path):
    """Of all paths that count as regular, moment arms are -dL/dq."""
    surfaces = [
        SurfaceDraw("ellipsoid", (0.029, 0.022, 0.026), "x"),
        SurfaceDraw(
            "cylinder", (0.008, 0.3), "x", center=(0.0143, -0.0191, 0.0205), angles=(0.276, -0.846, -0.648)
        ),
    ]
    write_model(surfaces, tmp_path / "model.osim")
    paths = muscle_paths(tmp_path / "model.osim", coordinates=COORDINATES)
    generator = np.random.default_rng(0)
    poses = np.tile([-0.08, 0.02, 0.0, 0.08, 0.0, 0.0], (100, 1)) + 0.02 * generator.normal(size=(100, 6))
    along, step = generator.normal(size=poses.shape), 1e-7
    found = paths(poses)
    slope = (paths(poses + step * along).length - paths(poses - step * along).length)[:, 0] / (2.0 * step)
    difference = np.abs(slope + np.einsum("pc,pc->p", along, found.moment_arm[:, :, 0]))
    regular = np.asarray(found.regular)[:, 0]
    assert 10 < regular.sum() < 90
    assert difference[regular].max() < 1e-6
    assert (difference[~regular] > 1e-3).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sizes", "start", "limit"),
    [
        ("ellipsoid", (0.03, 0.022, 0.026), (0.011, 0.016, 0.008), 1e-7),
        ("torus", (0.02, 0.008), (0.016, 0.004, 0.003), 1e-6),
    ],
)
def test_a_path_from_a_point_inside_one_of_two_surfaces_has_exact_moment_arms(
    kind, sizes, start, limit, tmp_path
):
    """The point counts as on the surface, along which the path begins."""
    around = SurfaceDraw("cylinder", (0.01, 0.3), "-y", center=(0.08, -0.02, 0.0))
    write_model([SurfaceDraw(kind, sizes), around], tmp_path / "model.osim")
    paths = muscle_paths(tmp_path / "model.osim", coordinates=COORDINATES)
    poses = np.tile([*start, 0.15, 0.01, -0.03], (8, 1))
    poses[:, 2] += np.linspace(-1e-3, 1e-3, 8)
    generator, step = np.random.default_rng(0), 1e-6
    along = generator.normal(size=poses.shape)
    found = paths(poses)
    assert (paths.engine.posed(poses)["path"].nearest_points()[:, 0] < -1e-3).all()
    assert np.asarray(found.touching).all() and not np.asarray(found.regular).any()
    slope = (paths(poses + step * along).length - paths(poses - step * along).length)[:, 0] / (2.0 * step)
    np.testing.assert_allclose(np.einsum("pc,pc->p", along, found.moment_arm[:, :, 0]), -slope, atol=limit)
