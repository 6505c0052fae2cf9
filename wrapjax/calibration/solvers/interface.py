"""What the solver needs to know of a problem.

What solvers share: why they stop, what they report, and what they give back.
"""

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


class Linearization(eqx.Module):
    """A sum of squares and its exact second-order expansion.

    ``cost(x + s) = cost + 2 gradient's + s'(gauss_newton + remainder) s + O(s^3)``: with residuals r
    and Jacobian J these are r'r, J'r, J'J and the sum of r_i times the Hessian of r_i.
    """

    cost: Float[Array, ""]
    gradient: Float[Array, " variable"]
    gauss_newton: Float[Array, "variable variable"]
    remainder: Float[Array, "variable variable"]


class AbstractLeastSquares(eqx.Module):
    """A sum of squares to be minimised within bounds."""

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
        """Relative fall of the cost below which its expansion does not hold; zero for a smooth one."""
        return 0.0

    @abstractmethod
    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Cost and derivatives at a point."""

    def value(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Cost alone; worth its own way where derivatives cost much more."""
        return self.linearize(variables).cost

    def linearized_at(self, variables: Float[Array, " variable"]) -> Linearization:
        """Compile and call `linearize`, as every solver does: what is compiled for one serves the others."""
        return _linearize(self, variables)

    def value_at(self, variables: Float[Array, " variable"]) -> Float[Array, ""]:
        """Compile and call `value`."""
        return _value(self, variables)


@eqx.filter_jit
def _linearize(problem: AbstractLeastSquares, variables: Float[Array, " variable"]) -> Linearization:
    return problem.linearize(variables)


@eqx.filter_jit
def _value(problem: AbstractLeastSquares, variables: Float[Array, " variable"]) -> Float[Array, ""]:
    return problem.value(variables)


class AbstractCalibration(AbstractLeastSquares):
    """A sum of squares of parameter trees, to be minimised within bounds and below limits."""

    #: Hard limits; their shifted excess is part of the sum of squares.
    limits: eqx.AbstractVar[tuple[Limit, ...]]

    @abstractmethod
    def with_limits(self, limits: tuple[Limit, ...]) -> AbstractCalibration:
        """Take others in their place."""

    @abstractmethod
    def excess(self, variables: Float[Array, " variable"]) -> tuple[Float[Array, "muscle _"], ...]:
        """Give how far each limited value is above its bound, by limit; negative: below."""

    @property
    @abstractmethod
    def initial(self) -> Any:
        """Parameter tree, or trees, before calibration."""

    @abstractmethod
    def parameters(self, variables: Float[Array, " variable"]) -> Any:
        """Put variables into the parameter tree, or the trees."""

    @abstractmethod
    def start(self, parameters: Any) -> Float[Array, " variable"]:
        """Read the variables off the tree, or the trees, and move them inside the bounds."""


#: Factor on the damping after a first failed step.
FIRST_GROWTH = 2.0


class Status(Enum):
    """Why a solver stopped, as a sentence."""

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


class DampingState(eqx.Module):
    """How boldly the next step is taken."""

    damping: Float[Array, ""]
    #: Factor on the damping after a failure; it doubles with each further one.
    growth: Float[Array, ""]

    def recovered(self) -> DampingState:
        """Forget failures, but not how bold steps have become."""
        return DampingState(self.damping, jnp.full_like(self.growth, FIRST_GROWTH))


class SolverState(eqx.Module):
    """Everything a solve needs to go on from where it is."""

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
    """What minimises a sum of squares within bounds.

    Parameters
    ----------
    gtol
        Stop when projected steepest descent would move no variable by more (solver units).
    ftol
        Stop when the relative fall of the cost is less.
    max_iterations
        Raise it for problems far from their optimum.
    """

    gtol: float = 1e-8
    ftol: float = 1e-12
    max_iterations: int = 500

    @abstractmethod
    def compile(self, problem: AbstractLeastSquares, start: Float[Array | np.ndarray, " variable"]) -> None:
        """Compile the kernels of `solve`, so that its time is that of solving alone."""

    @abstractmethod
    def solve(
        self,
        problem: AbstractLeastSquares,
        start: Float[Array | np.ndarray, " variable"],
        callback: Callable[[Iteration, SolverState], None] | None = None,
        damping_state: DampingState | None = None,
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
        pace
            Of an earlier solve that this one goes on from.
        """
