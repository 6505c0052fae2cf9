"""The convergence check of the baseline fit."""

import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.calibration.solvers.augmented_lagrangian import ConstrainedSolution
from wrapjax.calibration.solvers.interface import Linearization, Status
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.fits.baseline import (
    attainable_decrease,
    check_convergence,
    parameter_conflict,
    unchecked_convergence,
)


def ended(*costs, status=Status.cost):
    """Outcomes with these costs and this status."""
    outcomes = []
    for cost in costs:
        solution = object.__new__(ConstrainedSolution)
        object.__setattr__(solution, "cost", cost)
        object.__setattr__(solution, "status", status)
        outcome = object.__new__(Outcome)
        object.__setattr__(outcome, "solution", solution)
        outcomes.append(outcome)
    return outcomes


def quadratic(gradient, curvature):
    return Linearization(
        jnp.array(3.0), jnp.asarray(gradient), jnp.asarray(curvature), jnp.zeros_like(jnp.asarray(curvature))
    )


def test_a_converged_fit_has_no_problems():
    got = check_convergence(ended(1.003, 1.0, 2.0), 0.001, 1.0, {"by_half": {"emg_scale": 0.7}})
    assert got.problems == ()
    assert got.holds
    assert got.costs == (1.0, 1.003, 2.0)
    assert got.spread == pytest.approx(0.003)
    assert got.decrement == pytest.approx(0.001)
    assert got.conflicts == {"by_half": {"emg_scale": 0.7}}


@pytest.mark.parametrize(
    ("outcomes", "decrement", "explainable", "words"),
    [
        (ended(1.0, 1.0, status=Status.iterations), 0.0, 1.0, "no start converged"),
        (ended(1.0), 0.0, 1.0, "one start"),
        (ended(1.0, 1.02), 0.0, 1.0, "2.0 % apart"),
        (ended(1.0, 1.0), 0.02, 1.0, "2.0 % of the explainable error"),
        (ended(1.0, 1.0), 0.02, 0.2, "10.0 % of the explainable error"),
        (ended(1.0, 1.0), np.nan, 1.0, "explainable error"),
        (ended(1.0, 1.0), 0.0, np.nan, "explainable error"),
    ],
)
def test_each_problem_is_reported(outcomes, decrement, explainable, words):
    got = check_convergence(outcomes, decrement, explainable, {})
    assert not got.holds
    (problem,) = got.problems
    assert words in problem


def test_several_problems_are_reported():
    got = check_convergence(ended(1.0, 1.5, status=Status.iterations), 0.5, 1.0, {})
    assert len(got.problems) == 3


def test_failed_starts_are_ignored():
    """In any position among the others."""
    for costs in ((np.nan, 1.0, 1.001), (1.001, np.nan, 1.0), (1.001, 1.0, np.nan)):
        got = check_convergence(ended(*costs), 0.0, 1.0, {})
        assert got.problems == ()
        assert got.costs[:2] == (1.0, 1.001)
        assert got.spread == pytest.approx(0.001)


def test_without_explainable_error_the_decrement_is_zero():
    assert check_convergence(ended(1.0, 1.0), 0.1, 0.0, {}).decrement == 0.0


def test_an_unchecked_fit_has_its_reason_as_problem():
    got = unchecked_convergence(ended(2.0, 1.0), "too few cycles")
    assert (got.problems, got.costs, got.spread) == (("too few cycles",), (1.0, 2.0), 1.0)


def test_the_decrease_of_a_quadratic_is_exact():
    generator = np.random.default_rng(0)
    root, target = generator.normal(size=(4, 4)), generator.normal(size=4)
    model = quadratic(-root.T @ target, root.T @ root)
    wide = np.full(4, 1e3)
    # The cost is |root x - target|^2, at x = 0; its minimum is zero.
    found = attainable_decrease(model, np.zeros(4), -wide, wide)
    assert found == pytest.approx(target @ target, rel=1e-6)


def test_variables_held_by_bounds_do_not_count():
    model = quadratic([1.0, -2.0, 3.0, 1.0], np.diag([1.0, 2.0, 4.0, 1.0]))
    at, far = np.zeros(4), np.full(4, 10.0)
    # Downhill is out of bounds for the first two, and into them for the third.
    lower = np.array([0.0, -10.0, -10.0, -10.0])
    upper = np.array([10.0, 0.0, 0.0, 10.0])
    assert attainable_decrease(model, at, lower, upper) == pytest.approx(9.0 / 4.0 + 1.0)
    assert attainable_decrease(model, at, -far, far) == pytest.approx(1.0 + 2.0 + 9.0 / 4.0 + 1.0)
    assert attainable_decrease(model, at, at, at) == 0.0


def test_conflicts_are_computed_by_kind_of_parameter():
    labels = ("soleus_l.emg_scale", "tibant_l.emg_scale", "soleus_l.tendon_slack_length")
    sd = np.array([0.1, 0.2, 1.0])
    one, other = np.array([1.0, 1.0, 2.0]), np.array([1.0, 1.4, 2.0])
    found = parameter_conflict(labels, one, other, sd)
    # The standard deviation of a difference is the root of two times that of one fit.
    assert found == pytest.approx(
        {"emg_scale": 2.0 / np.sqrt(2.0) / np.sqrt(2.0), "tendon_slack_length": 0.0}
    )
    assert list(found) == ["emg_scale", "tendon_slack_length"]
