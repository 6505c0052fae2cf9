"""Augmented Lagrangian: limits are satisfied, and the optimum and each status are as expected."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

from tests.model.small import small_limited_objective, small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt

TIGHT = AugmentedLagrangian(ProjectedLevenbergMarquardt(gtol=1e-10, ftol=1e-15), ctol=1e-9)


@pytest.fixture(scope="module")
def problem():
    """Problem with free paths and limits that the unconstrained optimum violates."""
    return small_limited_objective(seed=1)


@pytest.fixture(scope="module")
def start(problem):
    return problem.start(problem.initial)


@pytest.fixture(scope="module")
def solution(problem, start):
    return TIGHT.solve(problem, start)


def plain_cost(problem):
    """Compute the cost without limits as a function of the variables."""
    free = problem.with_limits(())
    return eqx.filter_jit(lambda x: free.value(x))


def all_excess(problem):
    return eqx.filter_jit(lambda x: jnp.concatenate([one.ravel() for one in problem.excess(x)]))


def test_limits_are_satisfied_and_some_are_active(problem, solution):
    assert solution.status.converged, solution.status.value
    assert solution.max_violation <= 1e-9
    pushing = {name: int((value > 0.0).sum()) for name, value in solution.multipliers.items()}
    assert pushing["moment_arm_sign"] > 0 and pushing["longest_fiber"] > 0, pushing
    # The solution without limits violates them.
    unlimited = TIGHT.solve(problem.with_limits(()), solution.variables)
    assert float(all_excess(problem)(jnp.asarray(unlimited.variables)).max()) > 1e-3
    assert unlimited.cost < float(plain_cost(problem)(jnp.asarray(solution.variables)))


def test_solution_satisfies_the_karush_kuhn_tucker_conditions(problem, solution):
    """Gradient plus multipliers times derivatives of the limits is zero, except for variables at a bound."""
    at = jnp.asarray(solution.variables)
    slope = jax.grad(plain_cost(problem))(at)
    slopes = jax.jacfwd(all_excess(problem))(at)
    multipliers = np.concatenate([one.ravel() for one in solution.multipliers.values()])
    excess = np.asarray(all_excess(problem)(at))
    total = np.asarray(slope) + multipliers @ np.asarray(slopes)
    inside = (solution.variables > problem.lower) & (solution.variables < problem.upper)
    np.testing.assert_allclose(total[inside], 0.0, atol=1e-6)
    assert (total[solution.variables <= problem.lower] >= -1e-6).all()
    assert (total[solution.variables >= problem.upper] <= 1e-6).all()
    assert (multipliers >= 0.0).all()
    np.testing.assert_allclose(multipliers * excess, 0.0, atol=1e-6)


def test_slsqp_reaches_no_lower_cost_and_the_same_active_limits(problem, solution):
    """SciPy is given the plain cost, exact derivatives and every limit as a constraint.

    There are several minima, so it starts beside our end point.
    """
    cost, excess = plain_cost(problem), all_excess(problem)
    slope, slopes = jax.jit(jax.grad(cost)), jax.jit(jax.jacfwd(excess))
    theirs = minimize(
        lambda x: float(cost(jnp.asarray(x))),
        np.asarray(solution.variables) + 1e-3,
        jac=lambda x: np.asarray(slope(jnp.asarray(x))),
        bounds=list(zip(np.asarray(problem.lower), np.asarray(problem.upper), strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda x: -np.asarray(excess(jnp.asarray(x))),
            "jac": lambda x: -np.asarray(slopes(jnp.asarray(x))),
        },
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-9},
    )
    assert theirs.success, theirs.message
    ours = float(cost(jnp.asarray(solution.variables)))
    assert ours <= theirs.fun * (1.0 + 1e-6)
    np.testing.assert_allclose(ours, theirs.fun, rtol=1e-6)
    multipliers = np.concatenate([one.ravel() for one in solution.multipliers.values()])
    their_excess = np.asarray(excess(jnp.asarray(theirs.x)))
    # Limits that are active here are active there.
    assert (their_excess[multipliers > 1e-4] > -1e-5).all()
    ours_at_bounds = (solution.variables <= problem.lower) | (solution.variables >= problem.upper)
    theirs_at_bounds = (theirs.x <= problem.lower + 1e-6) | (theirs.x >= problem.upper - 1e-6)
    np.testing.assert_array_equal(ours_at_bounds, theirs_at_bounds)


@pytest.mark.slow
def test_trust_constr_agrees_for_free_paths_alone(problem, solution):
    """With all other variables held at the solution, the limits are linear."""
    few = np.flatnonzero(["path_changes" in label for label in problem.variables.labels])
    held = jnp.asarray(solution.variables)
    cost, excess = plain_cost(problem), all_excess(problem)
    few_cost = jax.jit(lambda changes: cost(held.at[few].set(changes)))
    few_excess = jax.jit(lambda changes: excess(held.at[few].set(changes)))
    slope, hessian = jax.jit(jax.grad(few_cost)), jax.jit(jax.hessian(few_cost))
    start = solution.variables[few] + 0.05
    slopes = np.asarray(jax.jacfwd(few_excess)(start))
    theirs = minimize(
        lambda changes: float(few_cost(changes)),
        start,
        jac=lambda changes: np.asarray(slope(changes)),
        hess=lambda changes: np.asarray(hessian(changes)),
        constraints=[LinearConstraint(slopes, -np.inf, slopes @ start - np.asarray(few_excess(start)))],
        method="trust-constr",
        options={"gtol": 1e-8, "xtol": 1e-12, "maxiter": 1000},
    )
    ours = float(cost(held))
    assert ours <= theirs.fun * (1.0 + 1e-6)
    np.testing.assert_allclose(theirs.x, solution.variables[few], atol=1e-3)


def test_without_limits_the_result_is_that_of_the_inner_solver():
    problem = small_objective()
    start = problem.start(problem.initial)
    inner = ProjectedLevenbergMarquardt()
    ours, theirs = AugmentedLagrangian(inner).solve(problem, start), inner.solve(problem, start)
    np.testing.assert_array_equal(ours.variables, theirs.variables)
    assert ours.status is theirs.status and ours.iterations == theirs.iterations
    assert ours.max_violation == 0.0 and ours.multipliers == {}


def test_infeasible_limits_are_reported(problem, start):
    """Contradictory limits on a fiber length."""
    first = problem.limits[0]
    impossible = dataclasses.replace(first, bound=first.bound - 10.0)
    stopped = AugmentedLagrangian(max_rounds=3).solve(problem.with_limits((impossible,)), start)
    assert not stopped.status.converged
    assert stopped.max_violation > 1.0


def test_iterations_are_counted_over_all_rounds(problem, start):
    few = AugmentedLagrangian(ProjectedLevenbergMarquardt(max_iterations=4))
    stopped = few.solve(problem, start)
    assert stopped.status is Status.iterations and stopped.iterations == 4
    assert [one.number for one in stopped.history] == list(range(5))


def test_an_interrupted_solve_is_continued(problem, start, solution):
    kept = []

    def stop_after(count):
        def watch(iteration, state):
            kept.append((iteration, state))
            if iteration.number == count:
                raise KeyboardInterrupt

        return watch

    whole = TIGHT.solve(problem, start)
    for count in (1, whole.iterations // 2, whole.iterations - 1):
        kept.clear()
        stopped = TIGHT.solve(problem, start, stop_after(count))
        assert stopped.status is Status.interrupted
        resumed = TIGHT.solve(problem, kept[-1][1], history=[iteration for iteration, _ in kept])
        assert resumed.status.converged
        np.testing.assert_allclose(resumed.variables, whole.variables, rtol=0.0, atol=1e-8)
        assert resumed.iterations <= whole.iterations + 1
