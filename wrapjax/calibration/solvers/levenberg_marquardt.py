"""Levenberg-Marquardt method for least squares with bounds, using exact second derivatives.

The problem is to minimise ``f(x) = r(x)'r(x)`` subject to ``lower <= x <= upper``. With the Jacobian J of
the residuals r let ``g = J'r`` and ``H = J'J + sum_i r_i hess(r_i)`` (half the gradient and half the Hessian
of f). An iteration is:

1. *Step.* Minimise the damped model ``m(s) = 2 g's + s'(H + mu D) s`` within the bounds on ``x + s``; where
   some residuals are limits, m also has those that the step will exceed
   (`wrapjax.calibration.solvers.model_step`). D is the diagonal of J'J, with a lower limit of a tenth of its
   largest entry. Where ``H + mu D`` is not positive definite, H is replaced by |H|, which has the absolute
   values of its eigenvalues (Dauphin et al. 2014, arXiv:1406.2572).
2. *Acceptance.* With ``rho = (f(x) - f(x + s)) / -m(s)``, m without damping, the ratio of the actual to the
   predicted decrease, the step is accepted if ``rho > 1e-4``. Where the costs are equal to rounding, it is
   accepted if the first-order optimality improves.
3. *Damping* (Nielsen 1999, IMM-REP-1999-05). After an accepted step ``mu *= max(1/3, 1 - (2 rho - 1)^3)`` and
   ``nu = 2``; after a rejected one ``mu *= nu`` and ``nu *= 2``.

H includes the second derivatives of the residuals because the moment errors of a calibration do not vanish at
the optimum, where they determine the rate of convergence. Optima of a calibration often lie on bounds, where
transformations that keep variables strictly inside the bounds converge slowly; a projected method with an
active set does not (Kanzow, Yamashita & Fukushima 2004, doi:10.1016/j.cam.2004.02.013).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Float

from wrapjax.calibration.solvers.interface import (
    FIRST_GROWTH,
    AbstractBoundedSolver,
    AbstractLeastSquares,
    DampingState,
    Iteration,
    Linearization,
    Solution,
    SolverState,
    Status,
)
from wrapjax.calibration.solvers.model_step import minimize_model, model_change

Matrix = Float[Array, "variable variable"]


@dataclass(frozen=True)
class ProjectedLevenbergMarquardt(AbstractBoundedSolver):
    """Levenberg-Marquardt solver of least-squares problems with bounds.

    The algorithm is described in the module's docstring.

    Parameters
    ----------
    gtol
        Stop when ``max |clip(x - g, lower, upper) - x|``, the largest change of a variable by a projected
        gradient step, is at most this (solver units). Lower it if the optimum must be located more precisely:
        it is the only test of first-order optimality.
    ftol
        Stop when both the predicted and the actual relative decrease of the cost are at most this, or the
        ``resolution`` of the problem if that is larger (at a kink of the cost no gradient vanishes). Raise it
        if an approximate optimum suffices.
    max_iterations
        Largest number of iterations, rejected steps included. Raise it for problems that start far from
        their optimum.
    xtol
        Stop when the length of an accepted step, relative to one plus the norm of x, is at most this. Raise
        it if small changes of the variables do not matter.
    initial_damping
        Damping mu of the first step, relative to the diagonal D of J'J. Raise it if the first steps are
        rejected; lower it if the start is close to the optimum.
    """

    xtol: float = 1e-10
    initial_damping: float = 1e-4

    def compile(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
    ) -> None:
        """Compile the functions that `solve` calls; see `AbstractBoundedSolver`."""
        state = self._begin(problem, start)
        jax.block_until_ready(problem.value_at(state.variables))
        jax.block_until_ready(absolute_value(half_hessian(state.linearization)))
        self._advance(problem, state, None)

    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
    ) -> Solution:
        """Minimise the cost from a starting point; see `AbstractBoundedSolver`."""
        began = time.perf_counter()
        state = self._begin(problem, start, damping_state)
        history: list[Iteration] = []
        convex: Matrix | None = None

        def record(number: int, step: float) -> None:
            variables = state.variables
            at_bounds = jnp.sum((variables <= problem.lower) | (variables >= problem.upper))
            optimality = first_order_optimality(
                variables, state.linearization.gradient, problem.lower, problem.upper
            )
            history.append(
                Iteration(
                    number=number,
                    cost=float(state.linearization.cost),
                    optimality=float(optimality),
                    damping=float(state.damping_state.damping),
                    step=step,
                    at_bounds=int(at_bounds),
                    seconds=time.perf_counter() - began,
                )
            )
            if callback:
                callback(history[-1], state)

        status = Status.iterations
        try:
            record(0, 0.0)
            if not np.isfinite(history[-1].cost):
                status = Status.not_finite
            elif history[-1].optimality <= self.gtol:
                status = Status.gradient
            else:
                for number in range(1, self.max_iterations + 1):
                    previous = history[-1].damping
                    state, tried, convex, accepted = self._advance(problem, state, convex)
                    step, actual, predicted = float(tried.length), float(tried.actual), float(tried.predicted)
                    record(number, step)
                    limit = max(self.ftol, problem.resolution) * history[-1].cost
                    if history[-1].optimality <= self.gtol:
                        status = Status.gradient
                    elif 0.0 < predicted <= limit and actual <= limit and (accepted or previous <= 1.0):
                        status = Status.cost
                    elif accepted and step <= self.xtol:
                        status = Status.step
                    elif history[-1].damping > 1e12:
                        status = Status.damping
                    else:
                        continue
                    break
        except KeyboardInterrupt:
            status = Status.interrupted
        return Solution(
            variables=np.asarray(state.variables),
            cost=float(state.linearization.cost),
            status=status,
            linearization=state.linearization,
            damping_state=state.damping_state,
            history=tuple(history),
        )

    def _begin(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        damping_state: DampingState | None = None,
    ) -> SolverState:
        inside = jnp.clip(jnp.asarray(start), problem.lower, problem.upper)
        # With explicit types: a state of another type than that of the steps would be compiled for again.
        return SolverState(
            variables=inside,
            linearization=problem.linearized_at(inside),
            damping_state=damping_state
            or DampingState(
                jnp.asarray(self.initial_damping, inside.dtype), jnp.asarray(FIRST_GROWTH, inside.dtype)
            ),
        )

    def _advance(
        self, problem: AbstractLeastSquares, state: SolverState, convex: Matrix | None
    ) -> tuple[SolverState, StepEvaluation, Matrix | None, bool]:
        """Perform one iteration.

        Parameters
        ----------
        problem, state
            Problem, and state before the iteration.
        convex
            Positive semidefinite replacement of the Hessian at this state, if it was computed already.

        Returns
        -------
        state, step, convex, accepted
            State after the iteration, step that was tried, replacement of the Hessian if it was needed and
            the state is unchanged, and whether the step was accepted.
        """
        lower, upper = jnp.asarray(problem.lower), jnp.asarray(problem.upper)
        hessian = half_hessian(state.linearization)
        candidate = propose_step(state, hessian, lower, upper)
        if not jnp.isfinite(candidate).all():
            convex = absolute_value(hessian) if convex is None else convex
            candidate = propose_step(state, convex, lower, upper)
        # Derivatives take many times as long as the cost, and a rejected step needs none.
        step = evaluate_step(state, candidate, problem.value_at(candidate))
        if step.decreases or step.unchanged:
            fresh = problem.linearized_at(candidate)
            before = first_order_optimality(state.variables, state.linearization.gradient, lower, upper)
            if step.decreases or first_order_optimality(candidate, fresh.gradient, lower, upper) < before:
                return SolverState(candidate, fresh, step.after_acceptance), step, None, True
        return SolverState(state.variables, state.linearization, step.after_rejection), step, convex, False


class StepEvaluation(eqx.Module):
    """Evaluation of a step."""

    #: Length relative to one plus the norm of the variables.
    length: Float[Array, ""]
    #: Actual and predicted decrease of the cost.
    actual: Float[Array, ""]
    predicted: Float[Array, ""]
    #: Whether the ratio of the two suffices for acceptance.
    decreases: Bool[Array, ""]
    #: Whether the cost is unchanged to rounding.
    unchanged: Bool[Array, ""]
    #: Damping of the next step if this one is accepted, and if it is rejected.
    after_acceptance: DampingState
    after_rejection: DampingState


@jax.jit
def first_order_optimality(
    variables: Float[Array, " variable"],
    gradient: Float[Array, " variable"],
    lower: Float[Array | np.ndarray, " variable"],
    upper: Float[Array | np.ndarray, " variable"],
) -> Float[Array, ""]:
    """Compute the largest change of a variable by a projected gradient step; 0 at a stationary point."""
    projected = jnp.clip(variables - gradient, lower, upper)
    return jnp.max(jnp.abs(projected - variables))


@jax.jit
def half_hessian(model: Linearization) -> Matrix:
    """Compute half the Hessian of the cost: J'J plus the remainder."""
    return model.gauss_newton + model.remainder


def absolute_value(hessian: Matrix) -> Matrix:
    """Replace the eigenvalues of a symmetric matrix by their absolute values.

    By SciPy, since few eigenvalues are negative and JAX has no function for these alone: half the time for
    1,400 variables. A matrix that is not finite is returned as it is.
    """
    if not jnp.isfinite(hessian).all():
        return hessian
    values, vectors = scipy.linalg.eigh(np.asarray(hessian), subset_by_value=(-np.inf, 0.0))
    return hessian - jnp.asarray(2.0 * (vectors * values) @ vectors.T)


@jax.jit
def propose_step(
    state: SolverState,
    hessian: Matrix,
    lower: Float[Array, " variable"],
    upper: Float[Array, " variable"],
) -> Float[Array, " variable"]:
    """Compute the next point: the minimum of the damped model within the bounds.

    Parameters
    ----------
    state
        State of the solver.
    hessian
        Half the Hessian of the cost, or its positive semidefinite replacement.
    lower, upper
        Bounds.

    Returns
    -------
    Array
        Next point; not finite where the damped Hessian is not positive definite.
    """
    model = state.linearization
    damped = hessian + jnp.diag(state.damping_state.damping * _damping_metric(model))
    down, up = lower - state.variables, upper - state.variables
    move = minimize_model(model.gradient, damped, model.limits, down, up)
    # A variable that reaches its bound is set to it: x + (upper - x) may differ from upper by rounding.
    candidate = jnp.where(move <= down, lower, jnp.where(move >= up, upper, state.variables + move))
    return jnp.clip(candidate, lower, upper)


def _damping_metric(model: Linearization) -> Float[Array, " variable"]:
    """Compute the diagonal D of J'J, with a lower limit for variables that hardly affect the residuals."""
    curvature = jnp.diagonal(model.gauss_newton)
    return jnp.maximum(curvature, 1e-1 * curvature.max())


@jax.jit
def evaluate_step(
    state: SolverState, candidate: Float[Array, " variable"], cost: Float[Array, ""]
) -> StepEvaluation:
    """Compare the actual decrease of the cost with the predicted one, and compute the next damping."""
    model, damping_state = state.linearization, state.damping_state
    move = candidate - state.variables
    hessian = model.gauss_newton + model.remainder
    predicted = -model_change(model.gradient, hessian, model.limits, move)
    actual = model.cost - cost
    ratio = actual / jnp.where(predicted > 0.0, predicted, jnp.inf)
    # Close to the optimum costs are equal to rounding, but gradients still differ.
    same_cost = jnp.abs(actual) <= 1e-14 * model.cost
    possible = jnp.isfinite(cost) & (predicted > 0.0)
    ratio = jnp.where(same_cost, 1.0, ratio)
    # Rule of Nielsen (1999): a smooth function of the ratio.
    reduced = damping_state.damping * jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
    return StepEvaluation(
        length=jnp.linalg.norm(move) / (1.0 + jnp.linalg.norm(state.variables)),
        actual=actual,
        predicted=predicted,
        decreases=possible & ~same_cost & (ratio > 1e-4),
        unchanged=possible & same_cost,
        after_acceptance=DampingState(
            jnp.maximum(reduced, 1e-12), jnp.full_like(damping_state.growth, FIRST_GROWTH)
        ),
        after_rejection=DampingState(
            damping_state.damping * damping_state.growth, FIRST_GROWTH * damping_state.growth
        ),
    )
