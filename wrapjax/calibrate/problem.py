"""What the solver needs to know of a problem."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float


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

    @abstractmethod
    def linearize(self, variables: Float[Array, " variable"]) -> Linearization:
        """Cost and derivatives at a point."""
