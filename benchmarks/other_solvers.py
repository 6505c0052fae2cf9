"""Other optimizers on the same problem, from the same start, within the same bounds.

All use the compiled functions and the scaled variables (of order one) of wrapjax. Their tolerances are tight,
so that none stops at a higher cost than it can reach.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import Bounds, least_squares, minimize

from benchmarks.case import Case, total_cost
from benchmarks.jacobian import residual_jacobian
from benchmarks.timed_run import EvaluationRecorder, Run, run_with_limit

_MANY = 1_000_000


def trf_exact(case: Case, limit: float) -> Run:
    """Run SciPy's ``least_squares`` with a dense Jacobian by `jax.jacfwd`."""
    jacobian = case.compiled(jax.jacfwd(lambda problem, x: problem.residuals(x), argnums=1))
    jax.block_until_ready(jacobian(case.start))
    return _trf("scipy_trf_exact", case, limit, lambda x: np.asarray(jacobian(x)))


def trf_by_muscle(case: Case, limit: float) -> Run:
    """Run SciPy's ``least_squares`` with the same Jacobian computed muscle by muscle."""
    jacobian = case.compiled(residual_jacobian)
    jax.block_until_ready(jacobian(case.start))
    return _trf("scipy_trf_by_muscle", case, limit, lambda x: np.asarray(jacobian(x)))


def trf_differences(case: Case, limit: float) -> Run:
    """Run SciPy's ``least_squares`` with 2-point differences."""
    return _trf("scipy_trf_differences", case, limit, "2-point")


def _trf(name: str, case: Case, limit: float, jacobian: str | Callable[[Any], Any]) -> Run:
    residuals = case.compiled(lambda problem, x: problem.residuals(x))
    jax.block_until_ready(residuals(case.start))

    def optimize(recorder: EvaluationRecorder) -> str:
        def function(x):
            rows = np.asarray(residuals(x))
            recorder.record(x, rows @ rows)
            return rows

        found = least_squares(
            function,
            np.asarray(case.start),
            jac=jacobian,
            bounds=(case.problem.lower, case.problem.upper),
            method="trf",
            ftol=1e-12,
            xtol=1e-12,
            gtol=1e-10,
            max_nfev=_MANY,
        )
        return found.message

    return run_with_limit(name, limit, optimize)


def lbfgsb_gradient(case: Case, limit: float) -> Run:
    """Run SciPy's L-BFGS-B with the gradient by `jax.value_and_grad`."""
    both = case.compiled(jax.value_and_grad(total_cost, argnums=1))
    jax.block_until_ready(both(case.start))

    def evaluate(x):
        cost, gradient = both(x)
        return float(cost), np.asarray(gradient)

    return _lbfgsb("scipy_lbfgsb_gradient", case, limit, evaluate, True)


def lbfgsb_differences(case: Case, limit: float) -> Run:
    """Run SciPy's L-BFGS-B with 2-point differences of the compiled cost, as MATLAB tools do."""
    cost = case.compiled(total_cost)
    jax.block_until_ready(cost(case.start))
    return _lbfgsb("scipy_lbfgsb_differences", case, limit, lambda x: float(cost(x)), "2-point")


def _lbfgsb(name: str, case: Case, limit: float, evaluate: Callable[[Any], Any], jacobian: str | bool) -> Run:
    def optimize(recorder: EvaluationRecorder) -> str:
        def function(x):
            value = evaluate(x)
            recorder.record(x, value[0] if jacobian is True else value)
            return value

        options = {"maxiter": _MANY, "maxfun": _MANY, "ftol": 1e-13, "gtol": 1e-8}
        bounds = Bounds(case.problem.lower, case.problem.upper)
        found = minimize(
            function, np.asarray(case.start), jac=jacobian, method="L-BFGS-B", bounds=bounds, options=options
        )
        return found.message

    return run_with_limit(name, limit, optimize)


def slsqp_differences(case: Case, limit: float) -> Run:
    """Run SciPy's SLSQP with 2-point differences of the compiled cost, as the SQP of MATLAB tools."""
    cost = case.compiled(total_cost)
    jax.block_until_ready(cost(case.start))

    def optimize(recorder: EvaluationRecorder) -> str:
        def function(x):
            value = float(cost(x))
            recorder.record(x, value)
            return value

        found = minimize(
            function,
            np.asarray(case.start),
            method="SLSQP",
            bounds=Bounds(case.problem.lower, case.problem.upper),
            options={"maxiter": _MANY, "ftol": 1e-13},
        )
        return found.message

    return run_with_limit("scipy_slsqp_differences", limit, optimize)


def jaxopt_lbfgsb(case: Case, limit: float) -> Run:
    """Run jaxopt's L-BFGS-B, one compiled step at a time."""
    with warnings.catch_warnings():
        # It warns at import that it is no longer maintained.
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt

    bounds = (jnp.asarray(case.problem.lower), jnp.asarray(case.problem.upper))

    def stepper(problem):
        return jaxopt.LBFGSB(lambda x: total_cost(problem, x), tol=1e-8)

    begin = case.compiled(lambda problem, x: stepper(problem).init_state(x, bounds=bounds))
    advance = case.compiled(lambda problem, carry: tuple(stepper(problem).update(*carry, bounds=bounds)))
    cost = case.compiled(total_cost)
    start = (case.start, begin(case.start))
    jax.block_until_ready((advance(start), cost(case.start)))

    def optimize(recorder: EvaluationRecorder) -> str:
        carry = start
        for _ in range(_MANY):
            recorder.record(np.asarray(carry[0]), float(carry[1].value))
            if carry[1].error <= 1e-8 or carry[1].failed_linesearch:
                break
            carry = advance(carry)
        failed = bool(carry[1].failed_linesearch)
        return "line search failed" if failed else "projected gradient below tol"

    return run_with_limit("jaxopt_lbfgsb", limit, optimize)


def optimistix_lm(case: Case, limit: float) -> Run:
    """Run optimistix' Levenberg-Marquardt with a sigmoid transform that keeps variables within bounds."""
    import equinox as eqx
    import optimistix

    lower, upper = jnp.asarray(case.problem.lower), jnp.asarray(case.problem.upper)

    def inside(free):
        return lower + (upper - lower) * jax.nn.sigmoid(free)

    def residuals(free, problem):
        return problem.residuals(inside(free)), None

    share = jnp.clip((case.start - lower) / (upper - lower), 1e-3, 1 - 1e-3)
    free = jnp.log(share / (1 - share))
    shapes = eqx.filter_eval_shape(residuals, free, case.problem)
    solver: Any = optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    tags: frozenset[object] = frozenset()
    state = solver.init(residuals, free, case.problem, {}, *shapes, tags)

    @eqx.filter_jit
    def advance(problem, free, state):
        free, state, _ = solver.step(residuals, free, problem, {}, state, tags)
        done, _ = solver.terminate(residuals, free, problem, {}, state, tags)
        return free, state, done

    cost = case.compiled(lambda problem, free: total_cost(problem, inside(free)))
    jax.block_until_ready((advance(case.problem, free, state)[0], cost(free)))

    def optimize(recorder: EvaluationRecorder) -> str:
        point, carry, done = free, state, False
        while not done:
            recorder.record(np.asarray(inside(point)), float(cost(point)))
            point, carry, done = advance(case.problem, point, carry)
        return "step below tolerance"

    return run_with_limit("optimistix_lm_sigmoid", limit, optimize)


#: Other optimizers by name, in the order in which they run.
OTHER_SOLVERS: dict[str, Callable[[Case, float], Run]] = {
    "scipy_trf_exact": trf_exact,
    "scipy_trf_by_muscle": trf_by_muscle,
    "scipy_trf_differences": trf_differences,
    "scipy_lbfgsb_gradient": lbfgsb_gradient,
    "scipy_lbfgsb_differences": lbfgsb_differences,
    "scipy_slsqp_differences": slsqp_differences,
    "jaxopt_lbfgsb": jaxopt_lbfgsb,
    "optimistix_lm_sigmoid": optimistix_lm,
}
