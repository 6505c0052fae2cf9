"""Functions of one coordinate, as models use them: for joint axes, couplers and moving points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline


@dataclass(frozen=True)
class Polynomial:
    """A polynomial; a constant or a straight line, too.

    Parameters
    ----------
    coefficients
        Highest power first.
    """

    coefficients: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate it."""
        return np.polyval(self.coefficients, at)

    def slope(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate its derivative."""
        return np.polyval(np.polyder(np.asarray(self.coefficients)), at)

    def scaled(self, factor: float) -> Polynomial:
        """Multiply it by a number."""
        return Polynomial(tuple(factor * coefficient for coefficient in self.coefficients))


@dataclass(frozen=True)
class Spline:
    """A piecewise cubic through knots, straight beyond the first and the last one.

    Parameters
    ----------
    knots, values, slopes
        A cubic between two knots is known from its values and slopes at both.
    """

    knots: tuple[float, ...]
    values: tuple[float, ...]
    slopes: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate it."""
        inside = np.clip(at, self.knots[0], self.knots[-1])
        end_slope = np.where(at < self.knots[0], self.slopes[0], self.slopes[-1])
        return self._cubics()(inside) + end_slope * (at - inside)

    def slope(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate its derivative."""
        return self._cubics()(np.clip(at, self.knots[0], self.knots[-1]), 1)

    def scaled(self, factor: float) -> Spline:
        """Multiply it by a number."""
        values, slopes = (tuple(factor * value for value in row) for row in (self.values, self.slopes))
        return replace(self, values=values, slopes=slopes)

    def _cubics(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.knots, self.values, self.slopes)


#: What an axis, a coupler or a moving point may follow.
Function = Polynomial | Spline

CONSTANT_ZERO = Polynomial((0.0,))
IDENTITY = Polynomial((1.0, 0.0))
