"""Interfaces of least-squares problems and of their solvers, and the results of a solve."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

if TYPE_CHECKING:
    from wrapjax.calibration.penalties import Limit


class AbstractLinearizedLimits(eqx.Module):
    """Limits about a point: terms ``weight * max(0, excess)^2`` of a sum of squares, with linear excesses.

    From these a solver foresees which limits a step will exceed.
    """

    #: Excess at the point; not positive where a limit is not exceeded.
    excess: eqx.AbstractVar[Float[Array, " row"]]
    weight: eqx.AbstractVar[Float[Array, " row"]]

    @abstractmethod
    def change(self, move: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute the change of the excess by a move."""

    @abstractmethod
    def gradient(self, multipliers: Float[Array, " row"]) -> Float[Array, " variable"]:
        """Compute the sum of the gradients of the excesses, times multipliers."""

    @abstractmethod
    def gram(self, weights: Float[Array, " row"]) -> Float[Array, "variable variable"]:
        """Compute the sum of the outer products of the gradients of the excesses, times weights."""


class Linearization(eqx.Module):
    """Second-order Taylor expansion of a sum of squares about a point.

    ``cost(x + s) = cost + 2 gradient's + s'(gauss_newton + remainder) s + O(s^3)``. With residuals r and
    Jacobian J: ``cost = r'r``, ``gradient = J'r`` (half the gradient of the cost), ``gauss_newton = J'J`` and
    ``remainder = sum_i r_i hess(r_i)``.
    """

    cost: Float[Array, ""]
    gradient: Float[Array, " variable"]
    gauss_newton: Float[Array, "variable variable"]
    remainder: Float[Array, "variable variable"]
    #: Limits among the residuals, whose squares are in the expansion only where they are exceeded at the
    #: point; None where there are none.
    limits: AbstractLinearizedLimits | None = None


class AbstractLeastSquares(eqx.Module):
    """Least-squares problem with bounds on its variables."""

    @property
    @abstractmethod
    def lower(self) -> Float[Array | np.ndarray, " variable"]:
        """Lower bounds."""

    @property
    @abstractmethod
    def upper(self) -> Float[Array | np.ndarray, " variable"]:
        """Upper bounds."""

    @property
    def resolution(self) -> float:
        """Relative decrease of the cost below which its Taylor expansion fails; 0 for a smooth cost."""
        return 0.0

    @abstractmethod
    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compute the cost and its first and second derivatives at a point."""

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compute the cost; override it where the cost alone is much cheaper than its derivatives."""
        return self.linearize(variables).cost

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Evaluate `linearize` by a compiled function that all solvers share."""
        return _linearize(self, variables)

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Evaluate `value` by a compiled function that all solvers share."""
        return _value(self, variables)


@eqx.filter_jit
def _linearize(problem: AbstractLeastSquares, variables: Float[Array, " variable"]) -> Linearization:
    return problem.linearize(variables)


@eqx.filter_jit
def _value(problem: AbstractLeastSquares, variables: Float[Array, " variable"]) -> Float[Array, ""]:
    return problem.value(variables)


class AbstractCalibration(AbstractLeastSquares):
    """Least-squares problem over parameter trees with bounds and inequality constraints (limits)."""

    #: Hard limits; their shifted excess is part of the sum of squares (see `Limit`).
    limits: eqx.AbstractVar[tuple[Limit, ...]]

    @abstractmethod
    def with_limits(self, limits: tuple[Limit, ...]) -> AbstractCalibration:
        """Return the problem with other limits."""

    @abstractmethod
    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Compute the excess of each limited value over its bound, by limit; negative below the bound."""

    @abstractmethod
    def residuals(self, variables: Float[Array, " variable"]) -> Float[Array, " row"]:
        """Compute all residuals, those of limits included, as one vector; their squares sum to `value`."""

    @property
    @abstractmethod
    def initial(self) -> Any:
        """Parameter tree, or trees, before calibration."""

    @abstractmethod
    def parameters(self, variables: Float[Array, " variable"]) -> Any:
        """Insert variables into the parameter tree, or the trees."""

    @abstractmethod
    def start(self, parameters: Any) -> Float[Array, " variable"]:
        """Extract the variables from the tree, or the trees, and clip them to the bounds."""


#: Factor on the damping after the first rejected step.
FIRST_GROWTH = 2.0


class Status(Enum):
    """Reason why a solver stopped; the value is a sentence for the user."""

    gradient = "Converged: no variable can move downhill by more than gtol."
    cost = "Converged: steps no longer lower the cost by more than ftol of it."
    step = "Converged: steps are shorter than xtol."
    iterations = "Not converged: the limit on iterations was reached; raise max_iterations."
    damping = "Not converged: no downhill step was found however short; the derivatives may be wrong."
    limits = "Not converged: limits are still violated; raise max_rounds."
    interrupted = "Stopped by the user; the best point so far is returned."
    not_finite = "Not converged: the cost is not finite at the start; check the data and start values."

    @property
    def converged(self) -> bool:
        """Whether a convergence criterion is met."""
        return self in (Status.gradient, Status.cost, Status.step)


@dataclass(frozen=True)
class Iteration:
    """Summary of one iteration of a solver."""

    number: int
    cost: float
    #: First-order optimality: largest change of a variable by a projected gradient step, in solver units.
    optimality: float
    damping: float
    #: Relative length of the step.
    step: float
    #: Number of variables at a bound.
    at_bounds: int
    #: Time since the start of the solve.
    seconds: float


class DampingState(eqx.Module):
    """Damping of the next step of a Levenberg-Marquardt method."""

    damping: Float[Array, ""]
    #: Factor on the damping if the next step is rejected; it doubles with each rejected step.
    growth: Float[Array, ""]

    def with_initial_growth(self) -> DampingState:
        """Return the state with the same damping and the initial growth factor."""
        return DampingState(self.damping, jnp.full_like(self.growth, FIRST_GROWTH))


class SolverState(eqx.Module):
    """State of a solver after an iteration, sufficient to continue from it."""

    variables: Float[Array, " variable"]
    linearization: Linearization
    damping_state: DampingState


@dataclass(frozen=True)
class Solution:
    """Result of a solve."""

    variables: Float[np.ndarray, " variable"]
    cost: float
    status: Status
    linearization: Linearization = field(repr=False)
    damping_state: DampingState
    history: tuple[Iteration, ...] = field(repr=False)

    @property
    def iterations(self) -> int:
        """Number of iterations taken."""
        return self.history[-1].number


@dataclass(frozen=True)
class AbstractBoundedSolver(ABC):
    """Solver of least-squares problems with bounds on the variables.

    Parameters
    ----------
    gtol
        Stop when a projected gradient step changes no variable by more than this (solver units).
    ftol
        Stop when the relative decrease of the cost is smaller than this.
    max_iterations
        Largest number of iterations; raise it for problems that start far from their optimum.
    """

    gtol: float = 1e-8
    ftol: float = 1e-12
    max_iterations: int = 500

    @abstractmethod
    def compile(self, problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the functions that `solve` calls, so that its time excludes compilation."""

    @abstractmethod
    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
    ) -> Solution:
        """Minimise the cost from a starting point.

        Parameters
        ----------
        problem
            Problem to solve.
        start
            Starting point; it is clipped to the bounds.
        callback
            Called after each iteration. A `KeyboardInterrupt`, raised in it or by Ctrl-C, ends the solve
            with the best point so far.
        damping_state
            Initial damping, from an earlier solve that is continued.

        Returns
        -------
        Solution
            Final point; it is returned with its `Status` whether or not the solver converged.
        """
