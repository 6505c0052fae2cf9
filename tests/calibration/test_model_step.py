"""Steps with limits: the model's minimum is SciPy's, and a step foresees the limits that it will exceed."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float
from scipy.optimize import lsq_linear, minimize

from tests.calibration.test_legs import on_the_right
from tests.calibration.test_levenberg_marquardt import Linear
from tests.model.small import small_limited_objective
from wrapjax.calibration.penalties import weighted_products
from wrapjax.calibration.solvers.interface import (
    AbstractLinearizedLimits,
    Linearization,
    Status,
)
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.calibration.solvers.model_step import minimize_model, model_change
from wrapjax.calibration.two_legs import join_leg_objectives
from wrapjax.model.variables import Batch, LocalBlocks


class DenseLimits(AbstractLinearizedLimits):
    """Limits with a dense Jacobian."""

    excess: Float[Array, " row"]
    weight: Float[Array, " row"]
    jacobian: Float[Array, "row variable"]

    def change(self, move):
        return self.jacobian @ move

    def gradient(self, multipliers):
        return multipliers @ self.jacobian

    def gram(self, weights):
        return (self.jacobian.T * weights[None]) @ self.jacobian


class Limited(Linear):
    """Linear least squares with a limit on linear functions, within the unit box."""

    limits: DenseLimits
    #: Whether the expansion tells of limits that are not exceeded.
    foreseen: bool = True

    def linearize(self, variables):
        rows = self.matrix @ variables - self.target
        excess = self.limits.excess + self.limits.jacobian @ variables
        above = self.limits.weight * (excess > 0.0)
        gram = self.matrix.T @ self.matrix + self.limits.gram(above)
        return Linearization(
            cost=rows @ rows + above @ excess**2,
            gradient=self.matrix.T @ rows + self.limits.gradient(above * excess),
            gauss_newton=gram,
            remainder=jnp.zeros_like(gram),
            limits=DenseLimits(excess, self.limits.weight, self.limits.jacobian) if self.foreseen else None,
        )


def limited(seed: int, foreseen: bool = True) -> Limited:
    generator = np.random.default_rng(seed)
    jacobian = generator.normal(size=(30, 8))
    return Limited(
        jnp.asarray(generator.normal(size=(14, 8))),
        jnp.asarray(4.0 * generator.normal(size=14)),
        DenseLimits(
            jnp.asarray(-generator.uniform(0.0, 1.5, size=30)),
            jnp.asarray(generator.uniform(1.0, 30.0, size=30)),
            jnp.asarray(jacobian),
        ),
        foreseen,
    )


def problem_of(seed: int):
    """Return the parts of a model at the origin, some of whose limits are exceeded there."""
    problem = limited(seed)
    shifted = DenseLimits(problem.limits.excess + 0.4, problem.limits.weight, problem.limits.jacobian)
    model = Limited(problem.matrix, problem.target, shifted).linearize(jnp.zeros(8))
    assert bool((model.limits.excess > 0.0).any()) and bool((model.limits.excess < 0.0).any())
    return model, problem.lower, problem.upper


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_minimum_of_the_model_is_scipys(seed):
    model, lower, upper = problem_of(seed)
    parts = model.gradient, model.gauss_newton, model.limits
    step = jax.jit(minimize_model)(*parts, lower, upper)
    value = jax.jit(lambda move: model_change(*parts, move))
    best = minimize(
        value,
        np.zeros(8),
        jac=jax.jit(jax.grad(value)),
        bounds=[(-1.0, 1.0)] * 8,
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10},
    )
    assert (step >= lower).all() and (step <= upper).all()
    # The last quadratic model may have lowered it by 1 %.
    assert best.fun - 1e-9 <= value(step) <= 0.98 * best.fun


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_without_limits_the_step_is_that_of_bounded_least_squares(seed):
    problem = limited(seed)
    move = minimize_model(
        -problem.matrix.T @ problem.target,
        problem.matrix.T @ problem.matrix,
        None,
        problem.lower,
        problem.upper,
    )
    best = lsq_linear(problem.matrix, problem.target, (-1.0, 1.0), method="bvls", tol=1e-14)
    np.testing.assert_allclose(move, best.x, atol=1e-9)


def test_the_model_is_the_true_change_of_a_cost_with_linear_limits():
    problem = limited(3)
    at, move = np.random.default_rng(4).uniform(-0.5, 0.5, size=(2, 8))
    model = problem.linearize(jnp.asarray(at))
    predicted = model_change(model.gradient, model.gauss_newton, model.limits, jnp.asarray(move))
    change = problem.linearize(jnp.asarray(at + move)).cost - model.cost
    quadratic = model_change(model.gradient, model.gauss_newton, None, jnp.asarray(move))
    np.testing.assert_allclose(predicted, change, rtol=1e-10)
    assert abs(quadratic - change) > 1e-3 * abs(change), "no limit changes on the way: nothing was shown"


def test_an_indefinite_hessian_gives_no_finite_step():
    model, lower, upper = problem_of(1)
    step = minimize_model(model.gradient, model.gauss_newton - 1e4 * jnp.eye(8), model.limits, lower, upper)
    assert not jnp.isfinite(step).all()


def test_steps_that_foresee_limits_are_accepted():
    """A model of a cost with linear limits is exact: few steps, none rejected. A quadratic model is not."""
    counts = {True: 0, False: 0}
    rejected = dict(counts)
    for seed in range(20):
        costs = {}
        for foreseen in counts:
            found = ProjectedLevenbergMarquardt().solve(limited(seed, foreseen), np.zeros(8))
            assert found.status in (Status.gradient, Status.cost, Status.step)
            counts[foreseen] += found.iterations
            history = [one.cost for one in found.history]
            rejected[foreseen] += sum(one == other for one, other in itertools.pairwise(history))
            costs[foreseen] = found.cost
        np.testing.assert_allclose(costs[True], costs[False], rtol=1e-9)
    assert rejected[True] < rejected[False]
    assert counts[True] < 0.8 * counts[False]


def joint():
    return join_leg_objectives(small_limited_objective(1), on_the_right(small_limited_objective(5)))


@pytest.mark.parametrize("problem", [small_limited_objective(1), joint()], ids=["one leg", "two legs"])
def test_linearized_limits_equal_dense_derivatives_of_the_excess(problem):
    generator = np.random.default_rng(7)
    start = problem.start(problem.initial)
    at = start * jnp.asarray(generator.uniform(0.95, 1.05, start.size))

    @jax.jit
    def excess(variables):
        parts = zip(problem.limits, problem.excess(variables), strict=True)
        return jnp.concatenate([(one + limit.shift).ravel() for limit, one in parts])

    found, jacobian = problem.linearized_at(at).limits, jax.jacfwd(excess)(at)
    np.testing.assert_allclose(found.excess, excess(at), rtol=1e-12, atol=1e-12)
    move, rows = generator.normal(size=at.size), generator.normal(size=found.excess.size)
    np.testing.assert_allclose(found.change(jnp.asarray(move)), jacobian @ move, atol=1e-9)
    np.testing.assert_allclose(found.gradient(jnp.asarray(rows)), rows @ jacobian, atol=1e-9)
    np.testing.assert_allclose(
        found.gram(jnp.asarray(rows)), (jacobian.T * rows[None]) @ jacobian, rtol=1e-9, atol=1e-8
    )


@pytest.mark.parametrize("counted", [3, 256, 257, 900], ids=lambda count: f"{count} weights")
def test_products_of_few_and_of_many_weighted_values(counted):
    """Few values are selected before they are multiplied, which changes no product."""
    generator = np.random.default_rng(counted)
    slopes, weights = generator.normal(size=(2, 4, 1000)), np.zeros((2, 1000))
    for muscle in range(2):
        # The first value among them: it also fills the places that are left over.
        places = np.append(0, 1 + generator.choice(999, counted - 1, replace=False))
        weights[muscle, places] = generator.normal(size=counted)
    blocks = LocalBlocks((Batch((0, 1), 4),), (jnp.asarray(slopes),))
    expected = np.einsum("mpk,mk,mqk->mpq", slopes, weights, slopes)
    found = weighted_products(blocks, jnp.asarray(weights)).parts[0]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
