"""Derivatives of the cost with free wraps, including the limit on their feasibility."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.calibration.dense import dense_slopes, half_cost
from tests.model.small import MUSCLES, small_objective
from wrapjax.calibration.path_penalties import feasibility_limits
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.surrogates.feasibility import Feasibility
from wrapjax.geometry.surrogates.two_level import InnerLevel, two_level_paths
from wrapjax.model.freedom import FreedWraps, nga_freedom, with_wraps
from wrapjax.model.variables import free_variables

HALF = np.array([0.01, 0.01, 0.01, 0.35, 0.35, 0.2])


@pytest.fixture(scope="module")
def problem():
    """Two muscles share a wrap; the second has another one before it."""
    generator = np.random.default_rng(2)
    held = small_objective()
    nominal = held.recording.path.nominal
    inner = InnerLevel(
        jnp.asarray(
            generator.normal(size=(2, 2, 83, 3)) * np.array([[1.0, 0.0], [1.0, 1.0]])[:, :, None, None]
        ),
        jnp.asarray(np.tile(HALF, (2, 2, 1))),
    )
    shapes = [leaf.shape[1:] for leaf in (nominal.length, nominal.velocity, nominal.moment_arm)]
    sizes = (1e-3, 1e-2, 2e-3)
    by = [
        jnp.asarray(size * generator.normal(size=(2, 3, *shape)))
        for size, shape in zip(sizes, shapes, strict=True)
    ]
    limit = Feasibility(
        support=jnp.asarray(generator.uniform(-1.0, 1.0, (4, 6))),
        weights=jnp.asarray(generator.normal(size=4)),
        offset=jnp.asarray(0.3),
        gamma=jnp.asarray(0.3),
        center=jnp.asarray(NOMINAL),
        half_range=jnp.asarray(HALF),
        slope=jnp.asarray(-1.0),
        intercept=jnp.asarray(0.0),
    )
    other = replace(limit, offset=jnp.asarray(-0.2))
    paths = two_level_paths(nominal, [0, 1], inner, PathState(*by), [(0, 0, limit), (1, 0, other)])
    base = replace(held.variables.base, path_changes=jnp.zeros((3, 12)))
    wraps = FreedWraps(
        names=("shared", "own"),
        quantities=WRAP_PARAMETERS,
        units=("m", "m", "m", "rad", "rad", "1"),
        places=np.array([[0, -1], [1, 0], [-1, -1]]),
        **{name: sign * np.tile(HALF, (2, 1)) for name, sign in (("lower", -1.0), ("upper", 1.0))},
        scale=np.tile(HALF, (2, 1)),
        prior_sd=np.tile(HALF, (2, 1)),
    )
    (limits,) = feasibility_limits(paths.nominal)
    return replace(
        held,
        recording=replace(held.recording, path=paths),
        variables=free_variables(base, with_wraps(nga_freedom(base), "PGA", wraps), MUSCLES),
        limits=(replace(limits, shift=limits.shift + 0.4),),
    )


def test_derivatives_equal_those_of_the_cost(problem):
    generator = np.random.default_rng(5)
    variables = problem.start(problem.initial)
    factor, shift = (
        generator.uniform(0.95, 1.05, (variables.size)),
        generator.uniform(-0.5, 0.5, variables.size),
    )
    moved = np.array([label.startswith(("shared.", "own.")) for label in problem.variables.labels])
    point = jnp.asarray(np.where(moved, shift, np.asarray(variables) * factor))
    (excess,) = eqx.filter_jit(lambda problem, at: problem.excess(at))(problem, point)
    assert (np.asarray(excess) > -0.4).sum() >= 1
    found = problem.linearized_at(point)
    rows, jacobian = dense_slopes(problem, point)
    np.testing.assert_allclose(found.cost, rows @ rows, rtol=1e-12)
    np.testing.assert_allclose(found.gradient, jacobian.T @ rows, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.gauss_newton, jacobian.T @ jacobian, rtol=1e-8, atol=1e-8)
    # Without the limit the derivatives by the parameters of its wrap differ.
    free = jax.jit(jax.grad(half_cost(problem.with_limits(()))))(point)
    assert (np.abs(found.gradient - free)[moved] > 1e-3).any()


def test_nominal_wraps_satisfy_the_limit(problem):
    """Also where the nominal feasibility score is below the margin."""
    paths = problem.recording.path
    assert (np.asarray(paths.nominal.infeasibility) > 0.0).any()
    (limit,) = feasibility_limits(paths.nominal)
    assert (np.asarray(limit.excess(paths.nominal.infeasibility)) <= 0.0).all()
