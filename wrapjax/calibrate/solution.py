"""What solvers share: why they stop, what they report, and what they give back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.calibrate.problem import AbstractLeastSquares, Linearization

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


class Pace(eqx.Module):
    """How boldly the next step is taken."""

    damping: Float[Array, ""]
    #: Factor on the damping after a failure; it doubles with each further one.
    growth: Float[Array, ""]

    def recovered(self) -> Pace:
        """Forget failures, but not how bold steps have become."""
        return Pace(self.damping, jnp.full_like(self.growth, FIRST_GROWTH))


class SolverState(eqx.Module):
    """Everything a solve needs to go on from where it is."""

    variables: Float[Array, " variable"]
    linearization: Linearization
    pace: Pace


@dataclass(frozen=True)
class Solution:
    """Result of a solve."""

    variables: Float[np.ndarray, " variable"]
    cost: float
    status: Status
    linearization: Linearization = field(repr=False)
    pace: Pace
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
        pace: Pace | None = None,
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
