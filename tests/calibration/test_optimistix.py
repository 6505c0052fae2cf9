"""optimistix runs our bounded solver on any problem, and its own solvers calibrate."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares

from tests.model.small import small_objective
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.external_solvers import OptimistixSolver, constrained_solver
from wrapjax.calibration.solvers.interface import AbstractLeastSquares, Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.calibration.solvers.optimistix_interface import BoundedLevenbergMarquardt
from wrapjax.errors import InputError

# ---- our solver on problems of the literature (More, Garbow & Hillstrom 1981, doi:10.1145/355934.355936)


def rosenbrock(x, _=None):
    return jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def kowalik(x, _=None):
    measured = jnp.array(
        [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
    )
    dose = 1.0 / jnp.array([0.25, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0])
    return measured - x[0] * (dose**2 + dose * x[1]) / (dose**2 + dose * x[2] + x[3])


def box(x, _=None):
    time = 0.1 * jnp.arange(1, 11)
    return jnp.exp(-time * x[0]) - jnp.exp(-time * x[1]) - x[2] * (jnp.exp(-time) - jnp.exp(-10.0 * time))


PROBLEMS = {
    "rosenbrock, upper bound": (rosenbrock, [-1.2, 1.0], [-2.0, -2.0], [0.5, 2.0]),
    "kowalik, optimum inside": (kowalik, [0.25, 0.39, 0.415, 0.39], [0.0] * 4, [1.0] * 4),
    "box, two bounds": (box, [0.0, 10.0, 20.0], [0.0, 5.0, 1.5], [0.8, 9.5, 20.0]),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_it_finds_the_optimum_within_bounds_that_scipy_finds(name):
    function, start, lower, upper = PROBLEMS[name]
    found = optx.least_squares(
        function,
        BoundedLevenbergMarquardt(),
        jnp.array(start),
        options={"lower": jnp.array(lower), "upper": jnp.array(upper)},
    )
    inside = np.clip(start, lower, upper)
    judge = least_squares(
        function, inside, bounds=(lower, upper), jac=jax.jacfwd(function), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert (found.value >= jnp.array(lower)).all() and (found.value <= jnp.array(upper)).all()
    assert float(found.stats["sum_of_squares"]) <= 2.0 * judge.cost * (1.0 + 1e-9) + 1e-20
    np.testing.assert_allclose(found.value, judge.x, rtol=1e-5, atol=1e-7)
    assert float(found.stats["optimality"]) <= 1e-8


def test_trees_numbers_as_bounds_and_auxiliary_output():
    """Variables may be any tree; a bound may be one number, a tree, or missing."""

    def function(y, target):
        return {"a": y["a"] - target, "b": 3.0 * (y["b"] + 1.0)}, y["a"].sum()

    start = {"a": jnp.zeros(2), "b": jnp.array(5.0)}
    options = {"upper": {"a": jnp.array([0.4, 9.0]), "b": 7.0}}
    found = optx.least_squares(
        function, BoundedLevenbergMarquardt(), start, jnp.array([1.0, 2.0]), options, has_aux=True
    )
    np.testing.assert_allclose(found.value["a"], [0.4, 2.0])
    np.testing.assert_allclose(found.value["b"], -1.0)
    np.testing.assert_allclose(found.aux, 2.4)
    above = optx.least_squares(
        function, BoundedLevenbergMarquardt(), start, jnp.array([1.0, 2.0]), {"lower": 1.5}, has_aux=True
    )
    np.testing.assert_allclose(np.concatenate([above.value["a"], above.value["b"][None]]), [1.5, 2.0, 1.5])


def test_it_is_mapped_over_problems():
    def solve(shift):
        return optx.least_squares(
            lambda y, _: y - shift, BoundedLevenbergMarquardt(), jnp.zeros(2), options={"upper": 1.0}
        ).value

    np.testing.assert_allclose(jax.vmap(solve)(jnp.array([0.5, 3.0])), [[0.5, 0.5], [1.0, 1.0]])


def test_it_leaves_a_saddle_point_and_reports_what_it_cannot_solve():
    """At (1e-3, 0) the Hessian has a negative eigenvalue, which the first damping does not outweigh."""
    found = optx.least_squares(
        lambda y, _: jnp.stack([y[0] ** 2 - 1.0, y[1]]), BoundedLevenbergMarquardt(), jnp.array([1e-3, 0.0])
    )
    np.testing.assert_allclose(jnp.abs(found.value), [1.0, 0.0], atol=1e-7)
    failed = optx.least_squares(
        lambda y, _: jnp.log(y), BoundedLevenbergMarquardt(), jnp.array([-1.0]), throw=False
    )
    assert failed.result == optx.RESULTS.nonlinear_divergence
    few = optx.least_squares(
        rosenbrock, BoundedLevenbergMarquardt(), jnp.array([-1.2, 1.0]), max_steps=3, throw=False
    )
    assert few.result == optx.RESULTS.nonlinear_max_steps_reached


# ---- solvers of optimistix in a calibration


@pytest.fixture(scope="module")
def problem():
    return small_objective()


@pytest.fixture(scope="module")
def reference(problem):
    found = ProjectedLevenbergMarquardt().solve(problem, problem.start(problem.initial))
    assert found.status.converged and found.history[-1].at_bounds > 0
    return found


@pytest.mark.parametrize(
    "solver", [optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10), optx.BFGS(rtol=1e-9, atol=1e-9)]
)
def test_other_solvers_reach_the_same_cost(problem, reference, solver):
    found = constrained_solver(solver).solve(problem, problem.start(problem.initial))
    assert found.status.converged, found.status.value
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-6)
    assert (found.variables >= problem.lower).all() and (found.variables <= problem.upper).all()
    assert np.isfinite([one.optimality for one in found.history]).all()


def test_limit_on_iterations_and_interruption(problem):
    start = problem.start(problem.initial)
    solver = optx.BFGS(rtol=1e-9, atol=1e-9)
    few = OptimistixSolver(solver=solver, max_iterations=2).solve(problem, start)
    assert few.status is Status.iterations and few.iterations == 2

    def stop(iteration, state):
        if iteration.number == 1:
            raise KeyboardInterrupt

    stopped = OptimistixSolver(solver=solver).solve(problem, start, stop)
    assert stopped.status is Status.interrupted and stopped.iterations == 1


def test_what_is_no_solver_is_refused():
    with pytest.raises(TypeError, match="solver"):
        constrained_solver("lm")
    own = AugmentedLagrangian(max_rounds=3)
    assert constrained_solver(own) is own
    assert constrained_solver(None) == AugmentedLagrangian()


class Parabola(AbstractLeastSquares):
    """A cost without residuals."""

    @property
    def lower(self):
        return np.zeros(1)

    @property
    def upper(self):
        return np.ones(1)

    def linearize(self, variables):
        raise NotImplementedError


def test_a_solver_of_residuals_needs_residuals():
    without = Parabola()
    with pytest.raises(InputError, match="needs residuals"):
        OptimistixSolver().solve(without, np.zeros(1))
