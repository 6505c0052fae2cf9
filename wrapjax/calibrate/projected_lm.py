"""Levenberg-Marquardt within bounds, by projection on the active set.

Optima of a calibration often lie on bounds. Transforms that keep variables strictly inside converge
slowly there; here variables at a bound that the gradient pushes against are held, and the others take
a full damped Gauss-Newton step (Kanzow, Yamashita & Fukushima 2004, doi:10.1016/j.cam.2004.02.013).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.calibrate.problem import AbstractLeastSquares, Linearization


class Status(Enum):
    """Why a solver stopped, as a sentence."""

    gradient = "Converged: no variable can move downhill by more than gtol."
    cost = "Converged: steps no longer lower the cost by more than ftol of it."
    step = "Converged: steps are shorter than xtol."
    iterations = "Not converged: the limit on iterations was reached; raise max_iterations."
    damping = "Not converged: no downhill step was found however short; the derivatives may be wrong."
    interrupted = "Stopped by the user; the best point so far is returned."
    not_finite = "Not converged: the cost is not finite at the start; check the data and start values."

    @property
    def converged(self) -> bool:
        """Whether the point is a minimum, to the tolerances."""
        return self in (Status.gradient, Status.cost, Status.step)


@dataclass(frozen=True)
class Iteration:
    """One line of the solver's log."""

    number: int
    cost: float
    #: Largest move that projected steepest descent would make, in solver units.
    optimality: float
    damping: float
    step: float
    at_bounds: int
    seconds: float


class SolverState(eqx.Module):
    """Everything a solve needs to go on from where it is."""

    variables: Float[Array, " variable"]
    linearization: Linearization
    damping: Float[Array, ""]
    growth: Float[Array, ""]


@dataclass(frozen=True)
class Solution:
    """Result of a solve."""

    variables: Float[np.ndarray, " variable"]
    cost: float
    status: Status
    linearization: Linearization
    history: tuple[Iteration, ...] = field(repr=False)

    @property
    def iterations(self) -> int:
        """Number of iterations taken."""
        return self.history[-1].number


@dataclass(frozen=True)
class ProjectedLM:
    """Projected Levenberg-Marquardt.

    Parameters
    ----------
    gtol
        Stop when projected steepest descent would move no variable by more (solver units). Lower it
        when the optimum must be sharp; it is the only test of first-order optimality.
    ftol
        Stop when both the predicted and the actual relative fall of the cost are less.
    xtol
        Stop when the relative length of the step is less.
    max_iterations
        Raise it for problems far from their optimum.
    initial_damping
        Of the first step, relative to the largest curvature. Raise it if the first steps fail.
    """

    gtol: float = 1e-8
    ftol: float = 1e-12
    xtol: float = 1e-10
    max_iterations: int = 500
    initial_damping: float = 1e-3

    def compile(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array, " variable"] | Float[np.ndarray, " variable"],
    ) -> None:
        """Compile the kernels of `solve`, so that its time is that of solving alone."""
        state = _begin(problem, jnp.asarray(start), jnp.asarray(self.initial_damping))
        _measure(problem, state)
        jax.block_until_ready(_advance(problem, state))

    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array, " variable"] | Float[np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
    ) -> Solution:
        """Minimise from a start, which is moved inside the bounds.

        Parameters
        ----------
        problem
            Sum of squares and bounds.
        start
            First point.
        callback
            Called after each iteration. `KeyboardInterrupt`, whether raised there or by Ctrl-C, ends
            the solve with the best point so far.
        """
        began = time.perf_counter()
        state = _begin(problem, jnp.asarray(start), jnp.asarray(self.initial_damping))
        history: list[Iteration] = []

        def note(number: int, step: float) -> None:
            at_bounds, optimality = _measure(problem, state)
            history.append(
                Iteration(
                    number=number,
                    cost=float(state.linearization.cost),
                    optimality=float(optimality),
                    damping=float(state.damping),
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
                    state, taken = _advance(problem, state)
                    step, actual, predicted = float(taken.step), float(taken.actual), float(taken.predicted)
                    note(number, step)
                    cost = history[-1].cost
                    if history[-1].optimality <= self.gtol:
                        status = Status.gradient
                    elif taken.accepted and max(actual, predicted) <= self.ftol * cost:
                        status = Status.cost
                    elif taken.accepted and step <= self.xtol:
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
            history=tuple(history),
        )


class _Step(eqx.Module):
    accepted: Bool[Array, ""]
    #: Relative length.
    step: Float[Array, ""]
    actual: Float[Array, ""]
    predicted: Float[Array, ""]


@eqx.filter_jit
def _begin(
    problem: AbstractLeastSquares, start: Float[Array, " variable"], damping: Float[Array, ""]
) -> SolverState:
    inside = jnp.clip(start, problem.lower, problem.upper)
    linearization = problem.linearize(inside)
    return SolverState(inside, linearization, damping, jnp.asarray(2.0))


def _held(
    problem: AbstractLeastSquares, variables: Float[Array, " variable"], gradient: Float[Array, " variable"]
) -> Bool[Array, " variable"]:
    """Which variables lie at a bound that the gradient pushes them against."""
    at_lower = (variables <= problem.lower) & (gradient > 0.0)
    at_upper = (variables >= problem.upper) & (gradient < 0.0)
    return at_lower | at_upper


@eqx.filter_jit
def _measure(problem: AbstractLeastSquares, state: SolverState):
    gradient = state.linearization.gradient
    downhill = jnp.clip(state.variables - gradient, problem.lower, problem.upper)
    at_bounds = jnp.sum((state.variables <= problem.lower) | (state.variables >= problem.upper))
    return at_bounds, jnp.max(jnp.abs(downhill - state.variables))


def _propose(problem: AbstractLeastSquares, state: SolverState) -> Float[Array, " variable"]:
    """Step to the minimum of the damped second-order model, or of Gauss and Newton's if it has none.

    Moment errors do not vanish at the optimum, and there the remainder of the Hessian decides how
    fast the last digits come; far from it, it may be indefinite.
    """
    model = state.linearization
    newton = _damped_step(problem, state, model.gauss_newton + model.remainder)
    gauss_newton = _damped_step(problem, state, model.gauss_newton)
    return jnp.where(jnp.isfinite(newton).all(), newton, gauss_newton)


def _damped_step(
    problem: AbstractLeastSquares, state: SolverState, hessian: Float[Array, "variable variable"]
) -> Float[Array, " variable"]:
    """Take the damped step in the free variables; hold those that it would push out, and repeat.

    Without the repetition a step that meets a bound is merely cut off, and the other variables do
    not learn of it until the next iteration. Not finite where the free part is indefinite.
    """
    gradient = state.linearization.gradient
    curvature = jnp.diagonal(state.linearization.gauss_newton)
    damped = hessian + jnp.diag(state.damping * jnp.maximum(curvature, 1e-8 * curvature.max()))
    held = _held(problem, state.variables, gradient)
    move = jnp.zeros_like(state.variables)
    for _ in range(4):
        # Held variables have moved by ``move`` already; the free ones answer to that.
        pull = gradient + damped @ jnp.where(held, move, 0.0)
        free = ~held
        matrix = jnp.where(free[:, None] & free[None, :], damped, jnp.diag(held.astype(damped.dtype)))
        solved = jsp.linalg.cho_solve(jsp.linalg.cho_factor(matrix), jnp.where(free, -pull, 0.0))
        wanted = state.variables + jnp.where(held, move, solved)
        clipped = jnp.clip(wanted, problem.lower, problem.upper)
        move = clipped - state.variables
        held = held | (clipped != wanted)
    return state.variables + move


@eqx.filter_jit
def _advance(problem: AbstractLeastSquares, state: SolverState) -> tuple[SolverState, _Step]:
    model = state.linearization
    candidate = jnp.clip(_propose(problem, state), problem.lower, problem.upper)
    move = candidate - state.variables
    fresh = problem.linearize(candidate)
    hessian = model.gauss_newton + model.remainder
    predicted = -(2.0 * model.gradient @ move + move @ hessian @ move)
    actual = model.cost - fresh.cost
    ratio = actual / jnp.where(predicted > 0.0, predicted, jnp.inf)
    accepted = jnp.isfinite(fresh.cost) & (predicted > 0.0) & (ratio > 1e-4)
    # Nielsen's rule (1999, IMM-REP-1999-05): smooth in the ratio, and slower to recover after failures.
    eased = state.damping * jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
    chosen = SolverState(
        variables=jnp.where(accepted, candidate, state.variables),
        linearization=jax.tree.map(lambda new, old: jnp.where(accepted, new, old), fresh, model),
        damping=jnp.where(accepted, jnp.maximum(eased, 1e-12), state.damping * state.growth),
        growth=jnp.where(accepted, 2.0, 2.0 * state.growth),
    )
    length = jnp.linalg.norm(move) / (1.0 + jnp.linalg.norm(state.variables))
    return chosen, _Step(accepted, length, actual, predicted)
