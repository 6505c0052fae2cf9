"""A second opinion: other arithmetic, first derivatives alone, the same optimum."""

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
def ours(problem):
    return ProjectedLevenbergMarquardt().solve(problem, problem.start(problem.initial))


def test_it_stays_at_our_optimum(problem, ours):
    found = BoundedLBFGS().solve(problem, ours.variables)
    np.testing.assert_allclose(found.cost, ours.cost, rtol=1e-9)
    np.testing.assert_allclose(found.variables, ours.variables, atol=1e-4)


def test_it_comes_back_to_it(problem, ours):
    """From beside it: which of several minima a solver meets from afar is luck."""
    aside = ours.variables * np.random.default_rng(1).uniform(0.97, 1.03, ours.variables.size)
    found = AugmentedLagrangian(BoundedLBFGS()).solve(problem, aside)
    assert found.status.converged, found.status.value
    np.testing.assert_allclose(found.cost, ours.cost, rtol=1e-4)
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


def test_without_jaxopt_it_is_said(monkeypatch):
    monkeypatch.setattr(sys.modules["wrapjax.calibration.solvers.lbfgs"], "find_spec", lambda name: None)
    with pytest.raises(InputError, match="is not installed"):
        BoundedLBFGS()
