"""What the solver needs to know of a problem."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

if TYPE_CHECKING:
    from wrapjax.calibrate.penalties import Limit


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
