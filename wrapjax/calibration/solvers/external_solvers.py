"""Solvers of optimistix and jaxopt with the interface of `AbstractBoundedSolver`.

Most of these solvers have no bounds. A substitution keeps the variables x within theirs: with both bounds
``x = middle + half_width sin(u)``, with one ``x = bound +- (sqrt(u^2 + 1) - 1)``, without any ``x = u``
(James & Roos 1975, doi:10.1016/0010-4655(75)90039-9, for the substitution of MINUIT). Its slope vanishes at
a bound, so that a start on a bound is moved off it, and an optimum on bounds, which is usual in a
calibration, is approached slowly. The solver of `wrapjax.calibration.solvers.levenberg_marquardt` needs no
substitution.

jaxopt is no longer maintained, and an optional dependency. Its L-BFGS-B is the second opinion on optima.
"""

from __future__ import annotations

import time
import warnings
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
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
# Iterations of a solver of jaxopt over which the decrease of the cost is compared with ``ftol``.
_PATIENCE = 20
# Solvers of jaxopt that calibrate. The first two have bounds, the last two receive residuals.
_WITH_BOUNDS, _OF_RESIDUALS = ("LBFGSB", "ProjectedGradient"), ("GaussNewton", "LevenbergMarquardt")
_OF_JAXOPT = (*_WITH_BOUNDS, "LBFGS", "BFGS", "NonlinearCG", "GradientDescent", *_OF_RESIDUALS)


class _Carry(eqx.Module):
    """Variables as the other library has them, and the state of its solver."""

    y: Float[Array, " variable"]
    state: Any


@dataclass(frozen=True)
class _ExternalSolver(AbstractBoundedSolver):
    """Loop over the steps of a solver of another library."""

    @abstractmethod
    def _begin(self, problem: AbstractLeastSquares, start: Float[Array, " variable"]) -> _Carry:
        """Prepare the first step from a start within the bounds."""

    @abstractmethod
    def _advance(self, problem: AbstractLeastSquares, carry: _Carry) -> _Carry:
        """Take a step."""

    @abstractmethod
    def _variables(self, problem: AbstractLeastSquares, carry: _Carry) -> Float[Array, " variable"]:
        """Return the bounded variables."""

    @abstractmethod
    def _measure(self, problem: AbstractLeastSquares, carry: _Carry) -> tuple[float, float]:
        """Compute cost and first-order optimality."""

    @abstractmethod
    def _stopped(
        self, problem: AbstractLeastSquares, carry: _Carry, history: list[Iteration]
    ) -> Status | None:
        """Return why the solver stops here; None if it does not."""

    def compile(self, problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the functions that `solve` calls; see `AbstractBoundedSolver`."""
        inside = _inside(problem, start)
        carry = self._advance(problem, self._begin(problem, inside))
        self._measure(problem, carry)
        self._stopped(problem, carry, [])
        jax.block_until_ready(problem.linearized_at(self._variables(problem, carry)))

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
        damping_state = DampingState(jnp.asarray(0.0), jnp.asarray(FIRST_GROWTH))
        carry = self._begin(problem, _inside(problem, start))
        variables = self._variables(problem, carry)
        linearization = problem.linearized_at(variables)
        history: list[Iteration] = []

        def record(number: int, step: float) -> None:
            at_bounds = jnp.sum((variables <= problem.lower) | (variables >= problem.upper))
            cost, optimality = self._measure(problem, carry)
            seconds = time.perf_counter() - began
            history.append(Iteration(number, cost, optimality, 0.0, step, int(at_bounds), seconds))
            if callback:
                callback(history[-1], SolverState(variables, linearization, damping_state))

        status = Status.iterations
        try:
            record(0, 0.0)
            for number in range(1, self.max_iterations + 1):
                carry = self._advance(problem, carry)
                previous, variables = variables, self._variables(problem, carry)
                move = jnp.linalg.norm(variables - previous) / (1.0 + jnp.linalg.norm(previous))
                record(number, float(move))
                if stopped := self._stopped(problem, carry, history):
                    status = stopped
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


@dataclass(frozen=True)
class OptimistixSolver(_ExternalSolver):
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

    def _function(self, problem: AbstractLeastSquares) -> _Function:
        of_residuals = isinstance(self.solver, optx.AbstractLeastSquaresSolver)
        if of_residuals:
            _require_residuals(problem, type(self.solver).__name__, "a minimiser, optimistix.BFGS")
        return _Function(problem, _Substitution.of(problem), of_residuals)

    def _begin(self, problem: AbstractLeastSquares, start: Float[Array, " variable"]) -> _Carry:
        function = self._function(problem)
        y = function.substitution.free(start)
        return _Carry(y, _begin(self.solver, function, y))

    def _advance(self, problem: AbstractLeastSquares, carry: _Carry) -> _Carry:
        return _Carry(*_advance(self.solver, self._function(problem), carry.y, carry.state))

    def _variables(self, problem: AbstractLeastSquares, carry: _Carry) -> Float[Array, " variable"]:
        return _Substitution.of(problem).bounded(carry.y)

    def _measure(self, problem: AbstractLeastSquares, carry: _Carry) -> tuple[float, float]:
        variables = self._variables(problem, carry)
        cost, gradient = _cost_and_gradient(problem, variables)
        optimality = first_order_optimality(variables, gradient, problem.lower, problem.upper)
        return float(cost), float(optimality)

    def _stopped(
        self, problem: AbstractLeastSquares, carry: _Carry, history: list[Iteration]
    ) -> Status | None:
        done, result = _finished(self.solver, self._function(problem), carry.y, carry.state)
        if not done:
            return None
        return Status.cost if bool(result == optx.RESULTS.successful) else Status.damping


@dataclass(frozen=True)
class JaxoptSolver(_ExternalSolver):
    """A solver of jaxopt: ``LBFGSB`` or ``ProjectedGradient``, within bounds; others by the substitution.

    First-order methods take hundreds of times as many iterations as Levenberg-Marquardt.

    Parameters
    ----------
    gtol, ftol, max_iterations
        See `AbstractBoundedSolver`. The default tolerances are larger than those of Levenberg-Marquardt, in
        accordance with the accuracy that a first-order method reaches. The optimality is the solver's own
        measure of error, in its variables.
    method
        Class of jaxopt: ``jaxopt.LBFGS``, for example, or ``functools.partial(jaxopt.LBFGS,
        history_size=30)``. By default ``jaxopt.LBFGSB``.

    Raises
    ------
    InputError
        If jaxopt is not installed, or the class is none of those that calibrate.
    """

    gtol: float = 1e-5
    ftol: float = 1e-9
    max_iterations: int = 20000
    method: Callable[..., Any] | None = None

    def __post_init__(self):
        if find_spec("jaxopt") is None:
            hint = "pip install 'wrapjax[jaxopt]', or use the usual solver"
            raise InputError(Problem("jaxopt", "is not installed", hint=hint))
        if self.name not in _OF_JAXOPT:
            message = f"expected one of the solvers {', '.join(_OF_JAXOPT)}, found {self.name}"
            raise InputError(Problem("jaxopt", message))

    @property
    def name(self) -> str:
        """Name of the class in jaxopt."""
        method = _class_of(self.method)
        return "LBFGSB" if method is None else getattr(method, "__name__", repr(method))

    def solver_of(self, problem: AbstractLeastSquares) -> tuple[Any, dict[str, Any]]:
        """Make the solver of a problem, and the options of each of its steps."""
        with warnings.catch_warnings():
            # jaxopt warns at import that it is no longer maintained.
            warnings.simplefilter("ignore", DeprecationWarning)
            import jaxopt
        bounds = jnp.asarray(problem.lower), jnp.asarray(problem.upper)
        # The tolerance is ours: see `_stopped`.
        make = partial(jaxopt.LBFGSB if self.method is None else self.method, tol=0.0)
        if self.name == "LBFGSB":
            return make(problem.value), {"bounds": bounds}
        if self.name == "ProjectedGradient":
            box = jaxopt.projection.projection_box
            return make(problem.value, projection=box), {"hyperparams_proj": bounds}
        of_residuals = self.name in _OF_RESIDUALS
        if of_residuals:
            _require_residuals(problem, self.name, "jaxopt.LBFGSB")
        function = _Function(problem, _Substitution.of(problem), of_residuals)
        return make(lambda y: function(y, None)[0]), {}

    def _begin(self, problem: AbstractLeastSquares, start: Float[Array, " variable"]) -> _Carry:
        y = start if self.name in _WITH_BOUNDS else _Substitution.of(problem).free(start)
        return _Carry(y, _begin_jaxopt(self, problem, y))

    def _advance(self, problem: AbstractLeastSquares, carry: _Carry) -> _Carry:
        y, state = _advance_jaxopt(self, problem, carry.y, carry.state)
        if getattr(state, "failed_linesearch", False):
            # Without the approximate Hessian the next line search may succeed.
            state = _begin_jaxopt(self, problem, y)
        return _Carry(y, state)

    def _variables(self, problem: AbstractLeastSquares, carry: _Carry) -> Float[Array, " variable"]:
        return carry.y if self.name in _WITH_BOUNDS else _Substitution.of(problem).bounded(carry.y)

    def _measure(self, problem: AbstractLeastSquares, carry: _Carry) -> tuple[float, float]:
        return float(problem.value_at(self._variables(problem, carry))), float(carry.state.error)

    def _stopped(
        self, problem: AbstractLeastSquares, carry: _Carry, history: list[Iteration]
    ) -> Status | None:
        if not history:
            return None
        if history[-1].optimality <= self.gtol:
            return Status.gradient
        fall = history[max(0, len(history) - 1 - _PATIENCE)].cost - history[-1].cost
        return Status.cost if len(history) > _PATIENCE + 1 and fall <= self.ftol * history[-1].cost else None


def constrained_solver(
    solver: AugmentedLagrangian
    | AbstractBoundedSolver
    | optx.AbstractLeastSquaresSolver
    | optx.AbstractMinimiser
    | Callable[..., Any]
    | None,
) -> AugmentedLagrangian:
    """Return the solver of problems with limits that uses a given solver for the problems within bounds.

    Parameters
    ----------
    solver
        Solver with limits, which is returned as it is; solver with bounds; solver of optimistix without
        either; class of jaxopt, or a `functools.partial` of it; None for the defaults of
        `AugmentedLagrangian`.

    Raises
    ------
    TypeError
        If it is none of these.
    """
    if solver is None:
        return AugmentedLagrangian()
    if isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        solver = OptimistixSolver(solver=solver)
    elif callable(solver) and getattr(_class_of(solver), "__module__", "").startswith("jaxopt"):
        solver = JaxoptSolver(method=solver)
    if isinstance(solver, AbstractBoundedSolver):
        return AugmentedLagrangian(solver)
    if not isinstance(solver, AugmentedLagrangian):
        raise TypeError(
            "solver must be an AugmentedLagrangian, a solver with bounds, a least-squares solver or "
            f"minimiser of optimistix, or a class of jaxopt, not {type(solver).__name__}"
        )
    return solver


def _class_of(method: Any) -> Any:
    """Return what a partial is made of, and anything else as it is."""
    return method.func if isinstance(method, partial) else method


def _inside(
    problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]
) -> Float[Array, " variable"]:
    return jnp.clip(jnp.asarray(start), problem.lower, problem.upper)


def _require_residuals(problem: AbstractLeastSquares, solver: str, other: str) -> None:
    if not isinstance(problem, AbstractCalibration):
        message = "needs residuals, which this problem does not give"
        raise InputError(Problem(solver, message, hint=f"use {other}, for example"))


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
    """Function of unbounded variables that a solver calls, with the unused arguments of optimistix."""

    problem: Any
    substitution: _Substitution
    of_residuals: bool = eqx.field(static=True)

    def __call__(self, free: Float[Array, " variable"], args: None) -> tuple[Array, None]:
        variables = self.substitution.bounded(free)
        if self.of_residuals:
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


@eqx.filter_jit
def _begin_jaxopt(solver: JaxoptSolver, problem: AbstractLeastSquares, y: Float[Array, " variable"]) -> Any:
    made, options = solver.solver_of(problem)
    return made.init_state(y, **options)


@eqx.filter_jit
def _advance_jaxopt(
    solver: JaxoptSolver, problem: AbstractLeastSquares, y: Float[Array, " variable"], state: Any
) -> tuple[Array, Any]:
    made, options = solver.solver_of(problem)
    return tuple(made.update(y, state, **options))
