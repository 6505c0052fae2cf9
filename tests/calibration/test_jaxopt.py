"""Solvers of jaxopt reach the same optimum as Levenberg-Marquardt."""

import sys
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.small import small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.external_solvers import JaxoptSolver, constrained_solver
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.errors import InputError

jaxopt = pytest.importorskip("jaxopt")


@pytest.fixture(scope="module")
def problem():
    return small_objective()


@pytest.fixture(scope="module")
def reference(problem):
    return ProjectedLevenbergMarquardt().solve(problem, problem.start(problem.initial))


@pytest.mark.slow
def test_it_stays_at_the_optimum(problem, reference):
    found = JaxoptSolver().solve(problem, reference.variables)
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-9)
    np.testing.assert_allclose(found.variables, reference.variables, atol=1e-4)


@pytest.mark.slow
def test_it_returns_to_the_optimum(problem, reference):
    """From a point near the optimum, because there are several minima."""
    aside = reference.variables * np.random.default_rng(1).uniform(0.97, 1.03, reference.variables.size)
    found = AugmentedLagrangian(JaxoptSolver()).solve(problem, aside)
    assert found.status.converged, found.status.value
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-4)
    assert (found.variables >= problem.lower).all() and (found.variables <= problem.upper).all()
    assert found.iterations > 10


@pytest.mark.parametrize(
    "method",
    [
        partial(jaxopt.LBFGS, history_size=30),
        pytest.param(jaxopt.BFGS, marks=pytest.mark.slow),
        pytest.param(jaxopt.LevenbergMarquardt, marks=pytest.mark.slow),
    ],
)
def test_solvers_without_bounds_reach_the_same_cost(problem, reference, method):
    """Through the substitution, from the start that the reference has."""
    found = constrained_solver(method).solve(problem, problem.start(problem.initial))
    assert found.status.converged, found.status.value
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-6)
    assert (found.variables >= problem.lower).all() and (found.variables <= problem.upper).all()


def test_projected_gradients_descend_within_bounds(problem, reference):
    """Steepest descent is too slow for an optimum: a step of it lowers the cost and keeps the bounds."""
    found = JaxoptSolver(method=jaxopt.ProjectedGradient, max_iterations=20).solve(
        problem, problem.start(problem.initial)
    )
    costs = [one.cost for one in found.history]
    assert reference.cost < costs[-1] < 0.9 * costs[0]
    assert (found.variables >= problem.lower).all() and (found.variables <= problem.upper).all()


def test_limit_on_iterations_and_interruption(problem):
    start = problem.start(problem.initial)
    few = JaxoptSolver(max_iterations=3).solve(problem, start)
    assert few.status is Status.iterations and few.iterations == 3

    def stop(iteration, state):
        if iteration.number == 2:
            raise KeyboardInterrupt

    stopped = JaxoptSolver().solve(problem, start, stop)
    assert stopped.status is Status.interrupted
    assert stopped.cost < float(problem.value(jnp.asarray(start)))


def test_missing_jaxopt_is_reported(monkeypatch):
    monkeypatch.setattr(
        sys.modules["wrapjax.calibration.solvers.external_solvers"], "find_spec", lambda name: None
    )
    with pytest.raises(InputError, match="is not installed"):
        JaxoptSolver()


def test_what_cannot_calibrate_is_refused():
    with pytest.raises(InputError, match="found OSQP"):
        constrained_solver(jaxopt.OSQP)
