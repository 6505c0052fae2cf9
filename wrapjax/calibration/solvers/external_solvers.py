"""Solvers of optimistix with the interface of `AbstractBoundedSolver`, to calibrate by any of them.

Solvers of optimistix have no bounds. A substitution keeps the variables x within theirs: with both bounds
``x = middle + half_width sin(u)``, with one ``x = bound +- (sqrt(u^2 + 1) - 1)``, without any ``x = u``
(James & Roos 1975, doi:10.1016/0010-4655(75)90039-9, for the substitution of MINUIT). Its slope vanishes at
a bound, so that a start on a bound is moved off it, and an optimum on bounds, which is usual in a
calibration, is approached slowly. The solver of `wrapjax.calibration.solvers.levenberg_marquardt` needs no
substitution.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.interface import (
    FIRST_GROWTH,
    AbstractBoundedSolver,
    AbstractCalibration,
    AbstractLeastSquares,
    DampingState,
    Iteration,
    Solution,
    SolverState,
    Status,
)
from wrapjax.calibration.solvers.levenberg_marquardt import first_order_optimality
from wrapjax.errors import InputError, Problem

#: Distance from the bounds of a start, as a share of their distance: on a bound the slope is zero.
_MARGIN = 1e-3


@dataclass(frozen=True)
class OptimistixSolver(AbstractBoundedSolver):
    """Any least-squares solver or minimiser of optimistix.

    Parameters
    ----------
    solver
        Solver, with its own tolerances: ``optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10)``, for
        example. A solver of least squares receives the residuals and needs dense derivatives of them; a
        minimiser receives their sum of squares.
    gtol, ftol
        Not used: ``solver`` has tolerances.
    max_iterations
        Largest number of steps.
    """

    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser = field(
        default_factory=lambda: optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    )

    def compile(self, problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the functions that `solve` calls; see `AbstractBoundedSolver`."""
        function = self._function(problem)
        y = _Substitution.of(problem).free(start)
        state = _begin(self.solver, function, y)
        y, state = _advance(self.solver, function, y, state)
        jax.block_until_ready(_finished(self.solver, function, y, state))
        jax.block_until_ready(problem.linearized_at(jnp.asarray(start)))
        jax.block_until_ready(_cost_and_gradient(problem, jnp.asarray(start)))

    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
    ) -> Solution:
        """Minimise the cost from a starting point; see `AbstractBoundedSolver`.

        ``damping_state`` is ignored.
        """
        began = time.perf_counter()
        function, substitution = self._function(problem), _Substitution.of(problem)
        damping_state = DampingState(jnp.asarray(0.0), jnp.asarray(FIRST_GROWTH))
        y = substitution.free(start)
        variables, linearization = substitution.bounded(y), problem.linearized_at(substitution.bounded(y))
        history: list[Iteration] = []

        def record(number: int, step: float) -> None:
            at_bounds = jnp.sum((variables <= problem.lower) | (variables >= problem.upper))
            cost, gradient = _cost_and_gradient(problem, variables)
            optimality = first_order_optimality(variables, gradient, problem.lower, problem.upper)
            seconds = time.perf_counter() - began
            history.append(
                Iteration(number, float(cost), float(optimality), 0.0, step, int(at_bounds), seconds)
            )
            if callback:
                callback(history[-1], SolverState(variables, linearization, damping_state))

        status = Status.iterations
        try:
            record(0, 0.0)
            state = _begin(self.solver, function, y)
            for number in range(1, self.max_iterations + 1):
                y, state = _advance(self.solver, function, y, state)
                previous, variables = variables, substitution.bounded(y)
                move = jnp.linalg.norm(variables - previous) / (1.0 + jnp.linalg.norm(previous))
                record(number, float(move))
                done, result = _finished(self.solver, function, y, state)
                if done:
                    converged = bool(result == optx.RESULTS.successful)
                    status = Status.cost if converged else Status.damping
                    break
        except KeyboardInterrupt:
            status = Status.interrupted
        linearization = problem.linearized_at(variables)
        return Solution(
            variables=np.asarray(variables),
            cost=float(linearization.cost),
            status=status,
            linearization=linearization,
            damping_state=damping_state,
            history=tuple(history),
        )

    def _function(self, problem: AbstractLeastSquares) -> _Function:
        least_squares = isinstance(self.solver, optx.AbstractLeastSquaresSolver)
        if least_squares and not isinstance(problem, AbstractCalibration):
            raise InputError(
                Problem(
                    type(self.solver).__name__,
                    "needs residuals, which this problem does not give",
                    hint="use a minimiser, optimistix.BFGS for example",
                )
            )
        return _Function(problem, _Substitution.of(problem), least_squares)


def constrained_solver(
    solver: AugmentedLagrangian
    | AbstractBoundedSolver
    | optx.AbstractLeastSquaresSolver
    | optx.AbstractMinimiser
    | None,
) -> AugmentedLagrangian:
    """Return the solver of problems with limits that uses a given solver for the problems within bounds.

    Parameters
    ----------
    solver
        Solver with limits, which is returned as it is; solver with bounds; solver of optimistix without
        either; None for `AugmentedLagrangian` with the defaults.

    Raises
    ------
    TypeError
        If it is none of these.
    """
    if solver is None:
        return AugmentedLagrangian()
    if isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        solver = OptimistixSolver(solver=solver)
    if isinstance(solver, AbstractBoundedSolver):
        return AugmentedLagrangian(solver)
    if not isinstance(solver, AugmentedLagrangian):
        raise TypeError(
            "solver must be an AugmentedLagrangian, a solver with bounds, or a least-squares solver or "
            f"minimiser of optimistix, not {type(solver).__name__}"
        )
    return solver


class _Substitution(eqx.Module):
    """Substitution of bounded variables by unbounded ones."""

    lower: Float[Array, " variable"]
    upper: Float[Array, " variable"]

    @classmethod
    def of(cls, problem: AbstractLeastSquares) -> _Substitution:
        return cls(jnp.asarray(problem.lower), jnp.asarray(problem.upper))

    @property
    def _finite(self) -> tuple[Array, Array, Array, Array]:
        """Whether each bound is finite, and the bounds with zero for those that are not."""
        low, high = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        return low, high, jnp.where(low, self.lower, 0.0), jnp.where(high, self.upper, 0.0)

    def bounded(self, free: Float[Array, " variable"]) -> Float[Array, " variable"]:
        """Compute the bounded variables."""
        low, high, lower, upper = self._finite
        beyond = jnp.sqrt(free**2 + 1.0) - 1.0
        both = (upper + lower) / 2.0 + (upper - lower) / 2.0 * jnp.sin(free)
        one = jnp.where(low, lower + beyond, jnp.where(high, upper - beyond, free))
        return jnp.where(low & high, both, one)

    def free(self, bounded: Float[Array | np.ndarray, " variable"]) -> Float[Array, " variable"]:
        """Compute the unbounded variables of a start, which is moved off its bounds."""
        low, high, lower, upper = self._finite
        half, given = jnp.where(low & high, (upper - lower) / 2.0, 1.0), jnp.asarray(bounded)
        share = jnp.where(low & high, (given - (upper + lower) / 2.0) / jnp.where(half > 0.0, half, 1.0), 0.0)
        both = jnp.arcsin(jnp.clip(share, -1.0 + 2.0 * _MARGIN, 1.0 - 2.0 * _MARGIN))
        beyond = jnp.maximum(jnp.where(low, given - lower, jnp.where(high, upper - given, 0.0)), _MARGIN)
        one = jnp.where(low | high, jnp.sqrt((beyond + 1.0) ** 2 - 1.0), given)
        return jnp.where(low & high, both, one)


class _Function(eqx.Module):
    """Function of unbounded variables that optimistix calls, with its unused arguments."""

    problem: Any
    substitution: _Substitution
    least_squares: bool = eqx.field(static=True)

    def __call__(self, free: Float[Array, " variable"], args: None) -> tuple[Array, None]:
        variables = self.substitution.bounded(free)
        if self.least_squares:
            return self.problem.residuals(variables), None
        return self.problem.value(variables), None


@eqx.filter_jit
def _cost_and_gradient(
    problem: AbstractLeastSquares, variables: Float[Array, " variable"]
) -> tuple[Float[Array, ""], Float[Array, " variable"]]:
    """Compute the cost and half its gradient, as `Linearization` has it."""
    cost, gradient = jax.value_and_grad(problem.value)(variables)
    return cost, gradient / 2.0


@eqx.filter_jit
def _begin(solver: Any, function: _Function, y: Float[Array, " variable"]) -> Any:
    shape, aux = jax.eval_shape(lambda at: function(at, None), y)
    return solver.init(function, y, None, {}, shape, aux, frozenset())


@eqx.filter_jit
def _advance(solver: Any, function: _Function, y: Float[Array, " variable"], state: Any) -> tuple[Array, Any]:
    return solver.step(function, y, None, {}, state, frozenset())[:2]


@eqx.filter_jit
def _finished(
    solver: Any, function: _Function, y: Float[Array, " variable"], state: Any
) -> tuple[Array, Any]:
    return solver.terminate(function, y, None, {}, state, frozenset())
