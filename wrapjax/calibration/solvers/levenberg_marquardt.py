"""Levenberg-Marquardt within bounds, by projection on the active set.

Optima of a calibration often lie on bounds. Transforms that keep variables strictly inside converge
slowly there; here variables at a bound that the gradient pushes against are held, and the others take
a full damped Gauss-Newton step (Kanzow, Yamashita & Fukushima 2004, doi:10.1016/j.cam.2004.02.013).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
import numpy as np
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

_Matrix = Float[Array, "variable variable"]


@dataclass(frozen=True)
class ProjectedLevenbergMarquardt(AbstractBoundedSolver):
    """Projected Levenberg-Marquardt.

    Parameters
    ----------
    gtol
        Stop when projected steepest descent would move no variable by more (solver units). Lower it
        when the optimum must be sharp; it is the only test of first-order optimality.
    ftol
        Stop when both the predicted and the actual relative fall of the cost are less, or less than
        the problem's own resolution: at a kink no gradient vanishes.
    xtol
        Stop when the relative length of the step is less.
    max_iterations
        Raise it for problems far from their optimum.
    initial_damping
        Of the first step, relative to the largest curvature. Raise it if the first steps fail.
    """

    xtol: float = 1e-10
    initial_damping: float = 1e-4

    def compile(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
    ) -> None:
        """Compile the kernels of `solve`."""
        state = self._begin(problem, start)
        jax.block_until_ready(problem.value_at(state.variables))
        jax.block_until_ready(_mirrored(_hessian(state.linearization)))
        self._advance(problem, state, None)

    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
    ) -> Solution:
        """Minimise from a start; see `AbstractBoundedSolver`."""
        began = time.perf_counter()
        state = self._begin(problem, start, damping_state)
        history: list[Iteration] = []
        convex: _Matrix | None = None

        def note(number: int, step: float) -> None:
            variables = state.variables
            at_bounds = jnp.sum((variables <= problem.lower) | (variables >= problem.upper))
            optimality = _optimality(variables, state.linearization.gradient, problem.lower, problem.upper)
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
            note(0, 0.0)
            if not np.isfinite(history[-1].cost):
                status = Status.not_finite
            elif history[-1].optimality <= self.gtol:
                status = Status.gradient
            else:
                for number in range(1, self.max_iterations + 1):
                    previous = history[-1].damping
                    state, tried, convex, accepted = self._advance(problem, state, convex)
                    step, actual, predicted = float(tried.length), float(tried.actual), float(tried.predicted)
                    note(number, step)
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
        # Typed in full: a state of another type than the steps return would be compiled for once more.
        return SolverState(
            variables=inside,
            linearization=problem.linearized_at(inside),
            damping_state=damping_state
            or DampingState(
                jnp.asarray(self.initial_damping, inside.dtype), jnp.asarray(FIRST_GROWTH, inside.dtype)
            ),
        )

    def _advance(
        self, problem: AbstractLeastSquares, state: SolverState, convex: _Matrix | None
    ) -> tuple[SolverState, _Step, _Matrix | None, bool]:
        """Try a step.

        Returns
        -------
        tuple
            The state after it, what it was, a convex stand-in for the Hessian if one was needed and still
            holds, and whether the step was taken.
        """
        lower, upper = jnp.asarray(problem.lower), jnp.asarray(problem.upper)
        hessian = _hessian(state.linearization)
        candidate = propose_step(state, hessian, lower, upper)
        if not jnp.isfinite(candidate).all():
            convex = _mirrored(hessian) if convex is None else convex
            candidate = propose_step(state, convex, lower, upper)
        # Derivatives take many times as long as the cost, and a step that fails needs none.
        step = _judge(state, candidate, problem.value_at(candidate))
        if step.downhill or step.level:
            fresh = problem.linearized_at(candidate)
            before = _optimality(state.variables, state.linearization.gradient, lower, upper)
            if step.downhill or _optimality(candidate, fresh.gradient, lower, upper) < before:
                return SolverState(candidate, fresh, step.after_success), step, None, True
        return SolverState(state.variables, state.linearization, step.after_failure), step, convex, False


class _Step(eqx.Module):
    #: Relative length.
    length: Float[Array, ""]
    #: Falls of the cost.
    actual: Float[Array, ""]
    predicted: Float[Array, ""]
    #: Whether the cost falls clearly; and whether, at its last digits, it does at least not rise.
    downhill: Bool[Array, ""]
    level: Bool[Array, ""]
    after_success: DampingState
    after_failure: DampingState


@jax.jit
def _optimality(
    variables: Float[Array, " variable"],
    gradient: Float[Array, " variable"],
    lower: Float[Array | np.ndarray, " variable"],
    upper: Float[Array | np.ndarray, " variable"],
) -> Float[Array, ""]:
    """Largest move that projected steepest descent would make: zero at a stationary point."""
    downhill = jnp.clip(variables - gradient, lower, upper)
    return jnp.max(jnp.abs(downhill - variables))


@jax.jit
def _hessian(model: Linearization) -> _Matrix:
    return model.gauss_newton + model.remainder


@jax.jit
def _mirrored(hessian: _Matrix) -> _Matrix:
    values, vectors = jnp.linalg.eigh(hessian)
    return (vectors * jnp.abs(values)[None, :]) @ vectors.T


@jax.jit
def propose_step(
    state: SolverState,
    hessian: _Matrix,
    lower: Float[Array, " variable"],
    upper: Float[Array, " variable"],
) -> Float[Array, " variable"]:
    """Step to the minimum of the damped second-order model; not finite where that has none.

    Moment errors do not vanish at the optimum, and there the remainder of the Hessian decides how
    fast the last digits come. Far from it the Hessian may be indefinite: then `_mirrored` stands in for
    it, with negative curvatures counted as positive (Dauphin et al. 2014, arXiv:1406.2572).
    """
    return jnp.clip(_damped_step(state, hessian, lower, upper), lower, upper)


def _damped_step(
    state: SolverState,
    hessian: Float[Array, "variable variable"],
    lower: Float[Array, " variable"],
    upper: Float[Array, " variable"],
) -> Float[Array, " variable"]:
    """Minimise the damped quadratic model within the bounds. Not finite where it is indefinite.

    Primal-dual active sets (Hintermueller, Ito & Kunisch 2002, doi:10.1137/S1052623401383558): hold what
    leaves the box, release what its multiplier pulls back in, until the sets repeat. A step that meets a
    bound is thus not merely cut off: the other variables answer to it.
    """
    gradient = state.linearization.gradient
    damped = hessian + jnp.diag(state.damping_state.damping * _damping_metric(state.linearization))
    down, up = lower - state.variables, upper - state.variables

    def solve(at_lower, at_upper):
        held = at_lower | at_upper
        fixed = jnp.where(at_lower, down, jnp.where(at_upper, up, 0.0))
        matrix = jnp.where(held[:, None] | held[None, :], jnp.diag(held.astype(damped.dtype)), damped)
        pull = jnp.where(held, fixed, -(gradient + damped @ fixed))
        return jsp.linalg.cho_solve(jsp.linalg.cho_factor(matrix), pull)

    def unsettled(carry):
        _, _, _, changed, rounds = carry
        return changed & (rounds < 20)

    def settle(carry):
        at_lower, at_upper, _, _, rounds = carry
        move = solve(at_lower, at_upper)
        slope = gradient + damped @ move
        next_lower = jnp.where(at_lower, slope > 0.0, move < down)
        next_upper = jnp.where(at_upper, slope < 0.0, move > up)
        changed = jnp.any((next_lower != at_lower) | (next_upper != at_upper))
        return next_lower, next_upper, move, changed, rounds + 1

    at_lower = (down >= 0.0) & (gradient > 0.0)
    at_upper = (up <= 0.0) & (gradient < 0.0)
    start = (at_lower, at_upper, jnp.zeros_like(gradient), jnp.asarray(True), 0)
    move = jax.lax.while_loop(unsettled, settle, start)[2]
    # A variable that goes to its bound gets there exactly: x + (upper - x) may round to just inside.
    return jnp.where(move <= down, lower, jnp.where(move >= up, upper, state.variables + move))


def _damping_metric(model: Linearization) -> Float[Array, " variable"]:
    """Curvature by variable, with a floor: what the data hardly see must not run away."""
    curvature = jnp.diagonal(model.gauss_newton)
    return jnp.maximum(curvature, 1e-1 * curvature.max())


@jax.jit
def _judge(state: SolverState, candidate: Float[Array, " variable"], cost: Float[Array, ""]) -> _Step:
    """Compare the fall of the cost with what was predicted, and set the damping of the next step."""
    model, damping_state = state.linearization, state.damping_state
    move = candidate - state.variables
    hessian = model.gauss_newton + model.remainder
    predicted = -(2.0 * model.gradient @ move + move @ hessian @ move)
    actual = model.cost - cost
    ratio = actual / jnp.where(predicted > 0.0, predicted, jnp.inf)
    # At the last digits costs no longer differ, but gradients still do.
    same_cost = jnp.abs(actual) <= 1e-14 * model.cost
    possible = jnp.isfinite(cost) & (predicted > 0.0)
    ratio = jnp.where(same_cost, 1.0, ratio)
    # Nielsen's rule (1999, IMM-REP-1999-05): smooth in the ratio, and slower to recover after failures.
    eased = damping_state.damping * jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
    return _Step(
        length=jnp.linalg.norm(move) / (1.0 + jnp.linalg.norm(state.variables)),
        actual=actual,
        predicted=predicted,
        downhill=possible & ~same_cost & (ratio > 1e-4),
        level=possible & same_cost,
        after_success=DampingState(
            jnp.maximum(eased, 1e-12), jnp.full_like(damping_state.growth, FIRST_GROWTH)
        ),
        after_failure=DampingState(
            damping_state.damping * damping_state.growth, FIRST_GROWTH * damping_state.growth
        ),
    )
