"""Hard limits by an augmented Lagrangian round a solver for bounds.

The inner solver minimises the cost plus ``weight * max(0, excess + shift)**2``; then each shift grows
by its excess, and the weight tenfold where the excess did not fall enough (Nocedal & Wright 2006,
Numerical Optimization, chapter 17).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibration.penalties import Limit
from wrapjax.calibration.solvers.interface import (
    AbstractBoundedSolver,
    AbstractCalibration,
    DampingState,
    Iteration,
    Solution,
    SolverState,
    Status,
)
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt

# Factor on the weights where the excess did not fall to this part of what it was.
_HEAVIER = 10.0
_ENOUGH = 0.5


class LagrangianState(eqx.Module):
    """Everything a solve needs to go on from where it is, besides its problem."""

    variables: Float[Array, " variable"]
    damping_state: DampingState
    shifts: tuple[Float[Array, "_ _"], ...]
    weights: tuple[Float[Array, "_ _"], ...]
    #: Largest excess, or room of a limit that pushes, after the last round and the one before.
    gap: Float[Array, ""]
    gap_before: Float[Array, ""]


@dataclass(frozen=True)
class ConstrainedSolution(Solution):
    """A solution below limits."""

    #: Largest excess over a limit, in the limit's unit: normalised fiber lengths, or cm of moment arm.
    max_violation: float
    #: With the shifts and weights of the limits that it was found with.
    problem: AbstractCalibration = field(repr=False)
    state: LagrangianState = field(repr=False)

    @property
    def multipliers(self) -> dict[str, Float[np.ndarray, "muscle value"]]:
        """How much the cost would fall for a unit of room, by limit; zero where it does not push."""
        return {limit.name: 2.0 * np.asarray(limit.weight * limit.shift) for limit in self.problem.limits}


@dataclass(frozen=True)
class AugmentedLagrangian:
    """Minimise within bounds and below limits.

    Without limits this is the inner solver. Rows of limits are never formed but muscle by muscle.

    Parameters
    ----------
    inner
        Solver within bounds. Its tolerances are those of the last round; earlier ones are as loose as
        limits are still violated. Its limit on iterations is for all rounds together.
    ctol
        Largest excess, and largest room of a limit that pushes, that counts as none.
    max_rounds
        Raise it if violations still fall when it is reached.
    """

    inner: AbstractBoundedSolver = field(default_factory=ProjectedLevenbergMarquardt)
    ctol: float = 1e-6
    max_rounds: int = 30

    def compile(self, problem: AbstractCalibration, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the kernels of `solve`, so that its time is that of solving alone."""
        self.inner.compile(problem, jnp.asarray(start))
        jax.block_until_ready(_excess(problem, jnp.asarray(start)))

    def solve(
        self,
        problem: AbstractCalibration,
        start: Float[Array | np.ndarray, " variable"] | LagrangianState,
        callback: Callable[[Iteration, LagrangianState], None] | None = None,
        history: Sequence[Iteration] = (),
    ) -> ConstrainedSolution:
        """Minimise.

        Parameters
        ----------
        problem
            Sum of squares, bounds and limits.
        start
            First point, moved inside the bounds; or a state that a callback was given, to go on from.
        callback
            Called after each iteration. `KeyboardInterrupt`, whether raised there or by Ctrl-C, ends
            the solve with the best point so far.
        history
            Iterations before that state.
        """
        began = time.perf_counter() - (history[-1].seconds if history else 0.0)
        log = list(history)
        damping_state, gap, before = None, np.inf if problem.limits else 0.0, np.inf
        if isinstance(start, LagrangianState):
            problem = problem.with_limits(_as_in(start, problem.limits))
            damping_state, gap, before = start.damping_state, float(start.gap), float(start.gap_before)
            start = start.variables
        variables = jnp.asarray(start)
        state = None
        for _ in range(self.max_rounds):
            limits = problem.limits

            def note(iteration: Iteration, inner: SolverState, limits=limits, gap=gap, before=before) -> None:
                nonlocal state
                state = _state(inner.variables, inner.damping_state, limits, gap, before)
                if log and iteration.number == 0:
                    return  # where the last round ended, or an interrupted one
                seconds = time.perf_counter() - began
                log.append(replace(iteration, number=len(log), seconds=seconds))
                if callback:
                    callback(log[-1], state)

            solution = self._inner(gap, len(log)).solve(problem, variables, note, damping_state)
            variables = jnp.asarray(solution.variables)
            # Boldness is kept for the next round, caution is not.
            damping_state = solution.damping_state.recovered()
            excess = _excess(problem, variables)
            tight = gap <= self.ctol
            gap_now = _gap(limits, excess)
            if not solution.status.converged or (tight and gap_now <= self.ctol):
                gap = gap_now
                break
            problem = problem.with_limits(_with_multipliers(limits, excess, _ENOUGH * gap))
            before, gap = gap, gap_now
        status = solution.status
        if status.converged and gap > self.ctol:
            status = Status.limits
        return ConstrainedSolution(
            variables=solution.variables,
            cost=solution.cost,
            status=status,
            linearization=solution.linearization,
            damping_state=solution.damping_state,
            history=tuple(log),
            max_violation=_violation(excess),
            problem=problem,
            state=_state(variables, solution.damping_state.recovered(), problem.limits, gap, before),
        )

    def restore(
        self,
        problem: AbstractCalibration,
        state: LagrangianState,
        status: Status,
        history: Sequence[Iteration],
    ) -> ConstrainedSolution:
        """Rebuild a solution from the state and status that it ended with."""
        problem = problem.with_limits(_as_in(state, problem.limits))
        excess = _excess(problem, state.variables)
        linearization = problem.linearized_at(state.variables)
        return ConstrainedSolution(
            variables=np.asarray(state.variables),
            cost=float(linearization.cost),
            status=status,
            linearization=linearization,
            damping_state=state.damping_state,
            history=tuple(history),
            max_violation=_violation(excess),
            problem=problem,
            state=state,
        )

    def _inner(self, gap: float, done: int) -> AbstractBoundedSolver:
        """Be as loose as limits are violated, and count the iterations of earlier rounds."""
        inner = self.inner
        left = max(1, inner.max_iterations - max(0, done - 1))
        if gap <= self.ctol:
            return replace(inner, max_iterations=left)
        return replace(
            inner,
            gtol=max(inner.gtol, min(1e-3, 1e-4 * gap)),
            # Near a minimum the cost differs by the square of what the point does.
            ftol=max(inner.ftol, min(1e-6, 1e-4 * gap**2)),
            max_iterations=left,
        )


@eqx.filter_jit
def _excess(problem: AbstractCalibration, variables: Float[Array, " variable"]) -> tuple[Array, ...]:
    return problem.excess(variables)


def _violation(excess: tuple[Array, ...]) -> float:
    return max((max(0.0, float(one.max())) for one in excess), default=0.0)


def _gap(limits: tuple[Limit, ...], excess: tuple[Array, ...]) -> float:
    pairs = zip(limits, excess, strict=True)
    return max((float(_unmet(limit, one).max()) for limit, one in pairs), default=0.0)


def _unmet(limit: Limit, excess: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
    # A limit that pushes must be met, not only respected: complementarity counts as violation.
    return jnp.abs(jnp.maximum(excess, -limit.shift))


def _with_multipliers(
    limits: tuple[Limit, ...], excess: tuple[Array, ...], enough: float
) -> tuple[Limit, ...]:
    """Shift the limits; where one is further from being met than ``enough``, make it heavier."""

    def moved(limit: Limit, one: Float[Array, "muscle value"]) -> Limit:
        growth = jnp.where(_unmet(limit, one) > enough, _HEAVIER, 1.0)
        # Multipliers are weight times shift and must not jump when the weight grows.
        return replace(
            limit, shift=jnp.maximum(limit.shift + one, 0.0) / growth, weight=limit.weight * growth
        )

    return tuple(moved(limit, one) for limit, one in zip(limits, excess, strict=True))


def _state(
    variables: Float[Array, " variable"],
    damping_state: DampingState,
    limits: tuple[Limit, ...],
    gap: float,
    before: float,
) -> LagrangianState:
    return LagrangianState(
        variables=variables,
        damping_state=damping_state,
        shifts=tuple(limit.shift for limit in limits),
        weights=tuple(limit.weight for limit in limits),
        gap=jnp.asarray(gap),
        gap_before=jnp.asarray(before),
    )


def _as_in(state: LagrangianState, limits: tuple[Limit, ...]) -> tuple[Limit, ...]:
    return tuple(
        replace(limit, shift=shift, weight=weight)
        for limit, shift, weight in zip(limits, state.shifts, state.weights, strict=True)
    )
