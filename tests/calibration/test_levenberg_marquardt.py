"""Levenberg-Marquardt: agreement with SciPy, status, interruption and convergence."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Linearization, Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt


class Dense(AbstractLeastSquares):
    """Least-squares problem with dense derivatives of a residual function."""

    function: callable = eqx.field(static=True)
    bounds: Float[Array, "2 variable"]

    @property
    def lower(self):
        return self.bounds[0]

    @property
    def upper(self):
        return self.bounds[1]

    def linearize(self, variables):
        rows = self.function(variables)
        jacobian = jax.jacfwd(self.function)(variables)
        half_hessian = jax.hessian(lambda x: jnp.sum(self.function(x) ** 2))(variables) / 2
        gram = jacobian.T @ jacobian
        return Linearization(rows @ rows, jacobian.T @ rows, gram, half_hessian - gram)


def dense(function, lower, upper) -> Dense:
    return Dense(function, jnp.stack([lower, upper]))


def exponentials(seed: int, muscles: int = 5) -> tuple[Dense, np.ndarray]:
    """Build a problem of sums of saturating curves with nonzero residuals and optima on bounds."""
    generator = np.random.default_rng(seed)
    time = jnp.linspace(0, 1, 60)
    arms = jnp.asarray(generator.normal(size=(2, muscles, 60)))
    drive = jnp.asarray(generator.uniform(0.1, 1.0, size=(muscles, 60)))
    truth = generator.uniform(-0.2, 1.2, size=(muscles, 3))

    def function(x):
        scale, shape, shift = x.reshape(muscles, 3).T
        force = scale[:, None] * (1 - jnp.exp(-3 * shape[:, None] * drive)) + shift[:, None] * time[None]
        misfit = jnp.einsum("cmf,mf->cf", arms, force).ravel() - data
        # Where a scale is zero its shape does not matter: a faint prior makes the optimum one point.
        return jnp.concatenate([misfit, 0.01 * (x - 0.5)])

    data = jnp.zeros(120)
    data = function(jnp.asarray(truth.ravel()))[:120] + 0.05 * jnp.asarray(generator.normal(size=120))
    # Lower bounds are above zero, as for EMG scales: zero scale and shape would be a saddle point.
    bounds = jnp.tile(jnp.array([0.05, 0.0, 0.0]), muscles), jnp.ones(3 * muscles)
    return dense(function, *bounds), np.full(3 * muscles, 0.5)


@pytest.mark.parametrize("seed", range(6))
def test_cost_and_active_set_equal_scipy(seed):
    problem, start = exponentials(seed)
    ours = ProjectedLevenbergMarquardt().solve(problem, start)
    theirs = least_squares(
        jax.jit(problem.function),
        start,
        jac=jax.jit(jax.jacfwd(problem.function)),
        bounds=(problem.lower, problem.upper),
        method="trf",
        ftol=1e-15,
        xtol=1e-15,
        gtol=1e-12,
        max_nfev=5000,
    )
    assert ours.status.converged
    assert ours.cost <= 2 * theirs.cost * (1 + 1e-6)
    if ours.cost >= 2 * theirs.cost * (1 - 1e-6):  # the same minimum, not a lower one
        np.testing.assert_allclose(ours.variables, theirs.x, atol=1e-4)
    stuck = (ours.variables <= problem.lower) | (ours.variables >= problem.upper)
    assert stuck.any(), "a problem without active bounds would show little"


class Linear(AbstractLeastSquares):
    """Linear least squares within the unit box."""

    matrix: Float[Array, "row variable"]
    target: Float[Array, " row"]

    @property
    def lower(self):
        return -jnp.ones(self.matrix.shape[1])

    @property
    def upper(self):
        return jnp.ones(self.matrix.shape[1])

    def linearize(self, variables):
        rows, gram = self.matrix @ variables - self.target, self.matrix.T @ self.matrix
        return Linearization(rows @ rows, self.matrix.T @ rows, gram, jnp.zeros_like(gram))


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_linear_problems_reach_the_bounded_optimum(seed):
    """On a convex problem the stationarity conditions are sufficient."""
    generator = np.random.default_rng(seed)
    matrix = jnp.asarray(generator.normal(size=(12, 6)))
    target = jnp.asarray(3 * generator.normal(size=12))
    solver = ProjectedLevenbergMarquardt(gtol=1e-9, ftol=0, xtol=0)
    found = solver.solve(Linear(matrix, target), 5 * generator.normal(size=6))
    x, gradient = found.variables, matrix.T @ (matrix @ found.variables - target)
    assert found.status is Status.gradient
    free = (x > -1) & (x < 1)
    assert np.abs(np.where(free, gradient, 0)).max() < 1e-8
    assert (gradient[x == -1] >= 0).all() and (gradient[x == 1] <= 0).all()


def test_cost_never_increases_and_the_history_is_complete():
    problem, start = exponentials(1)
    seen = []
    found = ProjectedLevenbergMarquardt().solve(
        problem, start, lambda iteration, state: seen.append(iteration)
    )
    costs = [iteration.cost for iteration in found.history]
    assert (np.diff(costs) <= 0).all()
    assert tuple(seen) == found.history
    assert [iteration.number for iteration in seen] == list(range(len(seen)))
    assert found.history[-1].cost == found.cost


@pytest.mark.parametrize("last", [0, 2])
def test_interrupting_returns_the_best_so_far(last):
    """Before the first step that is the start."""
    problem, start = exponentials(2)

    def stop(iteration, state):
        if iteration.number == last:
            raise KeyboardInterrupt

    found = ProjectedLevenbergMarquardt().solve(problem, start, stop)
    assert found.status is Status.interrupted and not found.status.converged
    assert found.iterations == last and found.cost == found.history[last].cost
    assert last == 0 or found.cost < found.history[0].cost


def test_reaching_the_limit_is_not_convergence():
    problem, start = exponentials(3)
    found = ProjectedLevenbergMarquardt(max_iterations=1).solve(problem, start)
    assert found.status is Status.iterations and not found.status.converged
    assert "max_iterations" in found.status.value


def test_start_outside_the_bounds_is_clipped():
    problem, start = exponentials(4)
    found = ProjectedLevenbergMarquardt().solve(problem, start + 10)
    assert (found.variables <= 1).all() and found.status.converged


def test_cost_that_is_not_finite_is_reported():
    problem = dense(lambda x: jnp.log(x - 2.0), jnp.zeros(1), jnp.ones(1))
    assert ProjectedLevenbergMarquardt().solve(problem, np.full(1, 0.5)).status is Status.not_finite


def test_derivatives_that_are_not_finite_are_reported():
    """The cost is finite, but not its second derivatives at the origin: no step is found, and none raises."""
    problem = dense(
        lambda x: jnp.append(jnp.sqrt(jnp.abs(x)) + 1.0, 1.0 + x.sum()), -jnp.ones(2), jnp.ones(2)
    )
    assert np.isfinite(problem.value_at(jnp.zeros(2)))
    found = ProjectedLevenbergMarquardt().solve(problem, np.zeros(2))
    assert found.status is Status.damping and not found.status.converged
    np.testing.assert_array_equal(found.variables, 0.0)


def test_starting_at_the_optimum_takes_no_iteration():
    problem = dense(lambda x: x - 0.25, jnp.zeros(2), jnp.ones(2))
    found = ProjectedLevenbergMarquardt().solve(problem, np.full(2, 0.25))
    assert found.status is Status.gradient and found.iterations == 0


def test_exact_hessian_converges_fast_where_gauss_newton_is_slow():
    """Quadratic convergence for large residuals."""
    problem = dense(
        lambda x: jnp.stack(
            [x[0] - 2 * jnp.sin(3 * x[1]) + 4, x[1] ** 2 + x[0] * x[1] - 3, 5 + jnp.cos(x[0])]
        ),
        -2 * jnp.ones(2),
        2 * jnp.ones(2),
    )
    found = ProjectedLevenbergMarquardt(gtol=1e-10, ftol=0, xtol=0).solve(problem, np.array([0.3, 0.4]))
    assert found.status is Status.gradient and found.iterations < 30


def test_steps_are_compiled_once():
    """A state of another type than that of the steps (weakly typed, for example) would be compiled again."""
    problem, start = exponentials(0)
    states = []
    ProjectedLevenbergMarquardt(max_iterations=2).solve(
        problem, start, lambda iteration, state: states.append(state)
    )
    types = [[leaf.aval for leaf in jax.tree.leaves(state)] for state in states]
    assert types[0] == types[1] == types[2]
