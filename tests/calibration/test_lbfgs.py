"""L-BFGS-B of jaxopt reaches the same optimum as Levenberg-Marquardt."""

import dataclasses
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.small import small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.lbfgs import BoundedLBFGS
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.errors import InputError

pytest.importorskip("jaxopt")


@pytest.fixture(scope="module")
def problem():
    return small_objective()


@pytest.fixture(scope="module")
def reference(problem):
    return ProjectedLevenbergMarquardt().solve(problem, problem.start(problem.initial))


def test_it_stays_at_the_optimum(problem, reference):
    found = BoundedLBFGS().solve(problem, reference.variables)
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-9)
    np.testing.assert_allclose(found.variables, reference.variables, atol=1e-4)


def test_it_returns_to_the_optimum(problem, reference):
    """From a point near the optimum, because there are several minima."""
    aside = reference.variables * np.random.default_rng(1).uniform(0.97, 1.03, reference.variables.size)
    found = AugmentedLagrangian(BoundedLBFGS()).solve(problem, aside)
    assert found.status.converged, found.status.value
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-4)
    assert (found.variables >= problem.lower).all() and (found.variables <= problem.upper).all()
    assert found.iterations > 10


def test_limit_on_iterations_and_interruption(problem):
    start = problem.start(problem.initial)
    few = dataclasses.replace(BoundedLBFGS(), max_iterations=3).solve(problem, start)
    assert few.status is Status.iterations and few.iterations == 3

    def stop(iteration, state):
        if iteration.number == 2:
            raise KeyboardInterrupt

    stopped = BoundedLBFGS().solve(problem, start, stop)
    assert stopped.status is Status.interrupted
    assert stopped.cost < float(problem.value(jnp.asarray(start)))


def test_missing_jaxopt_is_reported(monkeypatch):
    monkeypatch.setattr(sys.modules["wrapjax.calibration.solvers.lbfgs"], "find_spec", lambda name: None)
    with pytest.raises(InputError, match="is not installed"):
        BoundedLBFGS()
