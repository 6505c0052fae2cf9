"""Functions of one coordinate in models: of joints' axes, couplers and moving path points.

Each is a polynomial in pieces. A `FunctionTable` holds many of them in padded arrays, evaluated in one step
by NumPy or by JAX, whichever the argument belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline


class Piece(NamedTuple):
    """Piece of a function: a polynomial in the distance from an abscissa.

    Parameters
    ----------
    origin
        Abscissa.
    coefficients
        Coefficients, that of the lowest power first.
    """

    origin: float
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Polynomial:
    """Polynomial of one variable, which includes constants and straight lines.

    Parameters
    ----------
    coefficients
        Coefficients, that of the highest power first.
    """

    coefficients: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the function."""
        return np.polyval(self.coefficients, at)

    def derivative(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the first derivative."""
        return np.polyval(np.polyder(np.asarray(self.coefficients)), at)

    def scaled(self, factor: float) -> Polynomial:
        """Multiply the function by a number."""
        return Polynomial(tuple(factor * coefficient for coefficient in self.coefficients))

    @property
    def knots(self) -> tuple[float, ...]:
        """Abscissae between the pieces."""
        return ()

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces in order; the first and the last one extend to infinity."""
        return (Piece(0.0, self.coefficients[::-1]),)


@dataclass(frozen=True)
class Spline:
    """Piecewise cubic polynomial (OpenSim's ``SimmSpline``), extrapolated linearly.

    Parameters
    ----------
    knots
        Abscissae, ascending.
    values, slopes
        Values and first derivatives at the knots, which determine the cubics between them (Hermite).
    """

    knots: tuple[float, ...]
    values: tuple[float, ...]
    slopes: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the function."""
        inside = np.clip(at, self.knots[0], self.knots[-1])
        end_slope = np.where(at < self.knots[0], self.slopes[0], self.slopes[-1])
        return self._cubics()(inside) + end_slope * (at - inside)

    def derivative(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the first derivative."""
        return self._cubics()(np.clip(at, self.knots[0], self.knots[-1]), 1)

    def scaled(self, factor: float) -> Spline:
        """Multiply the function by a number."""
        values, slopes = (tuple(factor * value for value in row) for row in (self.values, self.slopes))
        return replace(self, values=values, slopes=slopes)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces in order: straight lines at both ends, and the cubics between the knots."""
        points = list(zip(self.knots, self.values, self.slopes, strict=True))
        first, last = (Piece(x, (value, slope)) for x, value, slope in (points[0], points[-1]))
        return (first, *(_cubic(*ends) for ends in pairwise(points)), last)

    def _cubics(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.knots, self.values, self.slopes)


def _cubic(start: tuple[float, float, float], end: tuple[float, float, float]) -> Piece:
    """Cubic with given abscissa, value and slope at both ends."""
    (x, value, slope), width = start, end[0] - start[0]
    chord = (end[1] - value) / width
    square = (3.0 * chord - 2.0 * slope - end[2]) / width
    cube = (slope + end[2] - 2.0 * chord) / width**2
    return Piece(x, (value, slope, square, cube))


@dataclass(frozen=True)
class PiecewisePolynomial:
    """Polynomial in pieces (OpenSim's piecewise linear and constant functions, and its ``GCVSpline``).

    Parameters
    ----------
    knots
        Abscissae between the pieces, ascending. A knot belongs to the piece after it.
    pieces
        Pieces in order, one more than knots; the first and the last one extend to infinity.
    """

    knots: tuple[float, ...]
    pieces: tuple[Piece, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the function."""
        return evaluate(tabulate([self]), at[:, None])[0][:, 0]

    def derivative(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate the first derivative, at a knot that of the piece after it."""
        return evaluate(tabulate([self]), at[:, None])[1][:, 0]

    def scaled(self, factor: float) -> PiecewisePolynomial:
        """Multiply the function by a number."""
        pieces = (
            Piece(piece.origin, tuple(factor * number for number in piece.coefficients))
            for piece in self.pieces
        )
        return replace(self, pieces=tuple(pieces))


#: Function of one coordinate: of a joint's axis, a coupler or a moving path point.
Function = Polynomial | Spline | PiecewisePolynomial

CONSTANT_ZERO = Polynomial((0.0,))
IDENTITY = Polynomial((1.0, 0.0))


class FunctionTable(NamedTuple):
    """Functions in padded arrays of NumPy or JAX.

    Parameters
    ----------
    knots
        Abscissae between the pieces of each function, padded with infinity.
    origins
        Abscissa to which the polynomial of each piece refers.
    coefficients
        Coefficients of each piece, that of the lowest power first.
    """

    knots: Any  # Float[Array, "function knot"]
    origins: Any  # Float[Array, "function piece"]
    coefficients: Any  # Float[Array, "function piece power"]


def tabulate(functions: Sequence[Function]) -> FunctionTable:
    """Put functions into padded arrays."""
    pieces = [function.pieces for function in functions]
    count = max((len(row) for row in pieces), default=1)
    powers = max((len(piece.coefficients) for row in pieces for piece in row), default=1)
    knots = np.full((len(functions), count - 1), np.inf)
    origins = np.zeros((len(functions), count))
    coefficients = np.zeros((len(functions), count, powers))
    for row, function in enumerate(functions):
        knots[row, : len(function.knots)] = function.knots
        for column, piece in enumerate(pieces[row]):
            origins[row, column] = piece.origin
            coefficients[row, column, : len(piece.coefficients)] = piece.coefficients
    return FunctionTable(knots, origins, coefficients)


def evaluate(table: FunctionTable, at: Any) -> tuple[Any, Any]:
    """Evaluate every function of a table, each at its own abscissae.

    Parameters
    ----------
    table
        Functions.
    at
        Abscissae, an array of NumPy or JAX, ``... function``.

    Returns
    -------
    values, derivatives
        Values and first derivatives, ``... function``.
    """
    xp = at.__array_namespace__()
    rows = np.arange(at.shape[-1])
    piece = xp.sum(at[..., None] >= table.knots, axis=-1)
    distance = at - xp.asarray(table.origins)[rows, piece]
    coefficients = xp.asarray(table.coefficients)[rows, piece]
    value = coefficients[..., -1]
    derivative = xp.zeros_like(value)
    for power in range(coefficients.shape[-1] - 2, -1, -1):
        derivative = value + distance * derivative
        value = coefficients[..., power] + distance * value
    return value, derivative
