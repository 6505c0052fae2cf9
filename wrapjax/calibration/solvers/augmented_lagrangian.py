"""Augmented Lagrangian method for inequality constraints (limits), with an inner solver for bounds.

The problem is to minimise ``f(x)`` within bounds subject to ``c_i(x) <= 0`` for each limited value, with c_i
its excess over the limit. Round k (Nocedal & Wright 2006, Numerical Optimization, chapter 17):

1. The inner solver minimises ``f(x) + sum_i w_i max(0, c_i(x) + s_i)^2`` within the bounds, where
   ``2 w_i s_i`` estimates the multiplier of limit i. Early rounds have looser tolerances.
2. ``s_i`` is replaced by ``max(0, c_i + s_i)``.
3. The residual ``|max(c_i, -s_i)|`` is zero if limit i is feasible and complementary. Where it exceeds half
   the largest one of the previous round, ``w_i`` is multiplied and ``s_i`` divided by 10, which keeps the
   multiplier.

It ends when a round with the final tolerances leaves all of these residuals at or below ``ctol``.
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

# Factor on a weight, and the decrease of the constraint residual in a round that avoids it.
_WEIGHT_FACTOR = 10.0
_SUFFICIENT_DECREASE = 0.5


class LagrangianState(eqx.Module):
    """State of the solver, sufficient with its problem to continue from it."""

    variables: Float[Array, " variable"]
    damping_state: DampingState
    shifts: tuple[Float[Array, "_ _"], ...]
    weights: tuple[Float[Array, "_ _"], ...]
    #: Largest constraint residual ``|max(c_i, -s_i)|`` after the last round and the one before.
    constraint_residual: Float[Array, ""]
    previous_residual: Float[Array, ""]


@dataclass(frozen=True)
class ConstrainedSolution(Solution):
    """Solution of a problem with limits."""

    #: Largest excess over a limit, in the limit's unit: normalised fiber length, or cm of moment arm.
    max_violation: float
    #: Problem with the final shifts and weights of its limits.
    problem: AbstractCalibration = field(repr=False)
    state: LagrangianState = field(repr=False)

    @property
    def multipliers(self) -> dict[str, Float[np.ndarray, "muscle value"]]:
        """Lagrange multipliers by limit: decrease of the cost per unit of relaxation; 0 where inactive."""
        return {limit.name: 2.0 * np.asarray(limit.weight * limit.shift) for limit in self.problem.limits}


@dataclass(frozen=True)
class AugmentedLagrangian:
    """Solver of least-squares problems with bounds and inequality constraints.

    The algorithm is described in the module's docstring. Without limits this is the inner solver.

    Parameters
    ----------
    inner
        Solver within bounds. Its tolerances apply to the last round; those of earlier rounds are larger, in
        proportion to the constraint residual. Its ``max_iterations`` limits all rounds together. Change it to
        set tolerances, or to solve by another algorithm.
    ctol
        Tolerance of the limits: largest excess over a limit, and largest slack of a limit with a multiplier,
        in the limit's unit. Raise it if small violations do not matter.
    max_rounds
        Largest number of rounds. Raise it if the solver reports that limits are still violated while the
        violation decreases from round to round.
    """

    inner: AbstractBoundedSolver = field(default_factory=ProjectedLevenbergMarquardt)
    ctol: float = 1e-6
    max_rounds: int = 30

    def compile(self, problem: AbstractCalibration, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the functions that `solve` calls, so that its time excludes compilation."""
        self.inner.compile(problem, jnp.asarray(start))
        jax.block_until_ready(_excess(problem, jnp.asarray(start)))

    def solve(
        self,
        problem: AbstractCalibration,
        start: Float[Array | np.ndarray, " variable"] | LagrangianState,
        callback: Callable[[Iteration, LagrangianState], None] | None = None,
        history: Sequence[Iteration] = (),
    ) -> ConstrainedSolution:
        """Minimise the cost within the bounds and limits.

        Parameters
        ----------
        problem
            Problem to solve.
        start
            Starting point, which is clipped to the bounds; or a state that was passed to a callback, to
            continue from.
        callback
            Called after each iteration. A `KeyboardInterrupt`, raised in it or by Ctrl-C, ends the solve
            with the best point so far.
        history
            Iterations before ``start``, to which those of this solve are appended.

        Returns
        -------
        ConstrainedSolution
            Final point; it is returned with its `Status` whether or not the solver converged.
        """
        began = time.perf_counter() - (history[-1].seconds if history else 0.0)
        log = list(history)
        damping_state, residual, previous = None, np.inf if problem.limits else 0.0, np.inf
        if isinstance(start, LagrangianState):
            problem = problem.with_limits(_limits_of_state(start, problem.limits))
            damping_state = start.damping_state
            residual, previous = float(start.constraint_residual), float(start.previous_residual)
            start = start.variables
        variables = jnp.asarray(start)
        state = None
        for _ in range(self.max_rounds):
            limits = problem.limits

            def record(
                iteration: Iteration, inner: SolverState, limits=limits, residual=residual, previous=previous
            ) -> None:
                nonlocal state
                state = _state(inner.variables, inner.damping_state, limits, residual, previous)
                if log and iteration.number == 0:
                    return  # the same point as the last iteration of the previous round or solve
                seconds = time.perf_counter() - began
                log.append(replace(iteration, number=len(log), seconds=seconds))
                if callback:
                    callback(log[-1], state)

            solution = self._inner(residual, len(log)).solve(problem, variables, record, damping_state)
            variables = jnp.asarray(solution.variables)
            damping_state = solution.damping_state.with_initial_growth()
            excess = _excess(problem, variables)
            final_tolerances = residual <= self.ctol
            new_residual = _constraint_residual(limits, excess)
            if not solution.status.converged or (final_tolerances and new_residual <= self.ctol):
                residual = new_residual
                break
            problem = problem.with_limits(_with_multipliers(limits, excess, _SUFFICIENT_DECREASE * residual))
            previous, residual = residual, new_residual
        status = solution.status
        if status.converged and residual > self.ctol:
            status = Status.limits
        return ConstrainedSolution(
            variables=solution.variables,
            cost=solution.cost,
            status=status,
            # The derivatives of limits are larger than all else, and of no use after the solve.
            linearization=replace(solution.linearization, limits=None),
            damping_state=solution.damping_state,
            history=tuple(log),
            max_violation=_largest_excess(excess),
            problem=problem,
            state=_state(
                variables,
                solution.damping_state.with_initial_growth(),
                problem.limits,
                residual,
                previous,
            ),
        )

    def restore(
        self,
        problem: AbstractCalibration,
        state: LagrangianState,
        status: Status,
        history: Sequence[Iteration],
    ) -> ConstrainedSolution:
        """Restore the solution of a finished solve from its final state and status."""
        problem = problem.with_limits(_limits_of_state(state, problem.limits))
        excess = _excess(problem, state.variables)
        linearization = problem.linearized_at(state.variables)
        return ConstrainedSolution(
            variables=np.asarray(state.variables),
            cost=float(linearization.cost),
            status=status,
            linearization=replace(linearization, limits=None),
            damping_state=state.damping_state,
            history=tuple(history),
            max_violation=_largest_excess(excess),
            problem=problem,
            state=state,
        )

    def _inner(self, residual: float, done: int) -> AbstractBoundedSolver:
        """Return the inner solver of a round: with looser tolerances and fewer iterations left."""
        inner = self.inner
        iterations_left = max(1, inner.max_iterations - max(0, done - 1))
        if residual <= self.ctol:
            return replace(inner, max_iterations=iterations_left)
        return replace(
            inner,
            gtol=max(inner.gtol, min(1e-3, 1e-4 * residual)),
            # Near a minimum the change of the cost is quadratic in that of the variables.
            ftol=max(inner.ftol, min(1e-6, 1e-4 * residual**2)),
            max_iterations=iterations_left,
        )


@eqx.filter_jit
def _excess(problem: AbstractCalibration, variables: Float[Array, " variable"]) -> tuple[Array, ...]:
    return problem.excess(variables)


def _largest_excess(excess: tuple[Array, ...]) -> float:
    return max((max(0.0, float(one.max())) for one in excess), default=0.0)


def _constraint_residual(limits: tuple[Limit, ...], excess: tuple[Array, ...]) -> float:
    pairs = zip(limits, excess, strict=True)
    return max((float(_residuals(limit, one).max()) for limit, one in pairs), default=0.0)


def _residuals(limit: Limit, excess: Float[Array, "muscle value"]) -> Float[Array, "muscle value"]:
    """Compute the violation of feasibility or complementarity of each limited value."""
    return jnp.abs(jnp.maximum(excess, -limit.shift))


def _with_multipliers(
    limits: tuple[Limit, ...], excess: tuple[Array, ...], sufficient: float
) -> tuple[Limit, ...]:
    """Update the shifts of the limits, and the weights where the residual exceeds ``sufficient``."""

    def updated(limit: Limit, one: Float[Array, "muscle value"]) -> Limit:
        growth = jnp.where(_residuals(limit, one) > sufficient, _WEIGHT_FACTOR, 1.0)
        # The multiplier, twice weight times shift, does not change with the weight.
        return replace(
            limit, shift=jnp.maximum(limit.shift + one, 0.0) / growth, weight=limit.weight * growth
        )

    return tuple(updated(limit, one) for limit, one in zip(limits, excess, strict=True))


def _state(
    variables: Float[Array, " variable"],
    damping_state: DampingState,
    limits: tuple[Limit, ...],
    residual: float,
    previous: float,
) -> LagrangianState:
    return LagrangianState(
        variables=variables,
        damping_state=damping_state,
        shifts=tuple(limit.shift for limit in limits),
        weights=tuple(limit.weight for limit in limits),
        constraint_residual=jnp.asarray(residual),
        previous_residual=jnp.asarray(previous),
    )


def _limits_of_state(state: LagrangianState, limits: tuple[Limit, ...]) -> tuple[Limit, ...]:
    """Return the limits with the shifts and weights of a state."""
    return tuple(
        replace(limit, shift=shift, weight=weight)
        for limit, shift, weight in zip(limits, state.shifts, state.weights, strict=True)
    )
