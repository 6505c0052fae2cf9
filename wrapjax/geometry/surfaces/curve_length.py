"""Length of a path over a curved surface, with its derivatives by the path's few variables.

A chart gives the surface's points by two coordinates. The curve on the surface runs along the first one, an
angle; the second one is a polynomial of it. Both ends of the curve are points where straight lines from the
path's ends are tangent to the surface: a family of points with one variable for each end. The length is that
of the two straight lines and, by Gauss-Legendre quadrature, of the curve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

#: Number of the polynomial's coefficients, and of nodes of the quadrature.
COEFFICIENTS, NODES = 6, 16
#: Number of variables: one for each end, and the coefficients.
VARIABLES = COEFFICIENTS + 2

# Added to the square of lengths (m), whose root has no derivative at zero.
SMALLEST_LENGTH = 1e-9

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(NODES)


def _bumps(at: Float[np.ndarray, " node"], slope: bool) -> Float[np.ndarray, "node coefficient"]:
    """Polynomials that are zero at both ends: (1 - x^2) T_k(x), or their slopes."""
    columns = []
    for row in np.eye(COEFFICIENTS):
        polynomial = np.polynomial.Polynomial([1.0, 0.0, -1.0]) * np.polynomial.Chebyshev(row).convert(
            kind=np.polynomial.Polynomial
        )
        columns.append((polynomial.deriv() if slope else polynomial)(at))
    return np.stack(columns, axis=1)


def _shapes() -> Float[np.ndarray, "node 4 shape"]:
    """Differentiate both coordinates and their slopes at each node by the curve's shape.

    The shape is both coordinates of the first and of the last point, and the coefficients.
    """
    shapes = np.zeros((NODES, 4, 4 + COEFFICIENTS))
    before, after = 0.5 * (1.0 - _NODES), 0.5 * (1.0 + _NODES)
    for coordinate in range(2):
        shapes[:, coordinate, coordinate], shapes[:, coordinate, 2 + coordinate] = before, after
        shapes[:, 2 + coordinate, coordinate], shapes[:, 2 + coordinate, 2 + coordinate] = -0.5, 0.5
    shapes[:, 1, 4:], shapes[:, 3, 4:] = _bumps(_NODES, False), _bumps(_NODES, True)
    return shapes


_SHAPES = _shapes()
MIDDLE = _bumps(np.zeros(1), False)[0]
# Slopes of the polynomials at both ends.
END_SLOPES = _bumps(np.array([-1.0, 1.0]), True)
# Pairs of the four numbers that a speed depends on, and the sums over nodes that give the derivatives of
# length by the curve's shape from those of the speeds.
_PAIRS = [(one, other) for one in range(4) for other in range(one, 4)]
_BY_SHAPE = (_WEIGHTS[:, None, None] * _SHAPES).transpose(1, 0, 2).reshape(4 * NODES, -1)
_TWICE_BY_SHAPE = np.stack(
    [
        (0.5 if one == other else 1.0)
        * _WEIGHTS[:, None, None]
        * (
            _SHAPES[:, one, :, None] * _SHAPES[:, other, None, :]
            + _SHAPES[:, other, :, None] * _SHAPES[:, one, None, :]
        )
        for one, other in _PAIRS
    ]
).reshape(len(_PAIRS) * NODES, -1)

#: Value and first three derivatives of a function of one coordinate.
Jet = tuple[Float[Array, "*node"], Float[Array, "*node"], Float[Array, "*node"], Float[Array, "*node"]]


class Family(NamedTuple):
    """A kind of surface: its chart, and the points where lines from a given point are tangent to it.

    The chart is separable: a point is a matrix times three products of a function of the first coordinate
    and a function of the second one. ``matrix`` computes the matrix (m) from the surface's parameters,
    ``factors`` the functions from the parameters and both coordinates, as two triples of `Jet`. ``tangent``
    computes both coordinates of a tangent point from the surface's parameters, the given point (m),
    constants that choose among the tangent points, and the variable of this end.
    """

    matrix: Callable[[Any], Float[Array, "3 3"]]
    factors: Callable[
        [Any, Float[Array, "*node"], Float[Array, "*node"]], tuple[tuple[Jet, Jet, Jet], tuple[Jet, Jet, Jet]]
    ]
    tangent: Callable[[Any, Float[Array, " 3"], Any, Float[Array, ""]], Float[Array, " 2"]]

    def chart(self, surface: Any, one: Float[Array, ""], other: Float[Array, ""]) -> Float[Array, " 3"]:
        """Compute a point of the surface (m) from its coordinates."""
        products = [
            left[0] * right[0] for left, right in zip(*self.factors(surface, one, other), strict=True)
        ]
        return self.matrix(surface) @ jnp.stack(products)


class Ends(NamedTuple):
    """What a path over a surface depends on."""

    #: Ends of the path (m).
    start: Float[Array, " 3"]
    end: Float[Array, " 3"]
    #: Parameters of the surface.
    surface: Any
    #: Constants that choose the tangent points of both ends.
    at_start: Any
    at_end: Any


def distance(one: Float[Array, " 3"], other: Float[Array, " 3"]) -> Float[Array, ""]:
    """Compute the distance of two points (m), with derivatives also where it is zero."""
    return jnp.sqrt(jnp.sum((one - other) ** 2) + SMALLEST_LENGTH**2)


def curve_shape(family: Family, ends: Ends, variables: Float[Array, " variable"]) -> Float[Array, " shape"]:
    """Coordinates of the curve's first and last point, and the coefficients."""
    return jnp.concatenate(
        [
            family.tangent(ends.surface, ends.start, ends.at_start, variables[0]),
            family.tangent(ends.surface, ends.end, ends.at_end, variables[1]),
            variables[2:],
        ]
    )


def curve_length(family: Family, ends: Ends, shape: Float[Array, " shape"]) -> Float[Array, ""]:
    """Compute the length of the curve on the surface (m) from its shape; see `curve_shape`."""
    one, other, one_slope, other_slope = jnp.moveaxis(jnp.asarray(_SHAPES) @ shape, 1, 0)
    left, right = family.factors(ends.surface, one, other)
    velocity = jnp.stack(
        [
            left[axis][1] * right[axis][0] * one_slope + left[axis][0] * right[axis][1] * other_slope
            for axis in range(3)
        ]
    )
    velocity = family.matrix(ends.surface) @ velocity
    return jnp.asarray(_WEIGHTS) @ jnp.sqrt(jnp.sum(velocity**2, axis=0) + SMALLEST_LENGTH**2)


def _speeds(
    family: Family, surface: Any, local: Float[Array, "node 4"]
) -> tuple[Float[Array, " node"], list[Float[Array, " node"]], list[Float[Array, " node"]]]:
    """Compute speeds along the curve's parameter, and their first and second (`_PAIRS`) derivatives.

    Derivatives are by the local numbers: both coordinates and their slopes.
    """
    one, other, one_slope, other_slope = jnp.moveaxis(local, 1, 0)
    left, right = family.factors(surface, one, other)
    matrix = family.matrix(surface)
    metric = matrix.T @ matrix

    def partial(first: int, second: int) -> list[Float[Array, " node"]]:
        return [left[axis][first] * right[axis][second] for axis in range(3)]

    def along(first: int, second: int) -> list[Float[Array, " node"]]:
        """Differentiate the velocity, from orders of differentiation by both coordinates."""
        ahead, aside = partial(first + 1, second), partial(first, second + 1)
        return [p * one_slope + q * other_slope for p, q in zip(ahead, aside, strict=True)]

    def product(one: list[Array], other: list[Array]) -> Array:
        return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]

    def weighted(vector: list[Array]) -> list[Array]:
        return [product(list(metric[row]), vector) for row in range(3)]

    velocity = along(0, 0)
    firsts = [along(1, 0), along(0, 1), partial(1, 0), partial(0, 1)]
    seconds = {
        (0, 0): along(2, 0),
        (0, 1): along(1, 1),
        (1, 1): along(0, 2),
        (0, 2): partial(2, 0),
        (0, 3): partial(1, 1),
        (1, 2): partial(1, 1),
        (1, 3): partial(0, 2),
    }
    weighted_velocity = weighted(velocity)
    weighted_firsts = [weighted(vector) for vector in firsts]
    speed = jnp.sqrt(product(velocity, weighted_velocity) + SMALLEST_LENGTH**2)
    inverse = 1.0 / speed
    slopes = [product(vector, weighted_velocity) * inverse for vector in firsts]
    bends = []
    for first, second in _PAIRS:
        bend = product(firsts[first], weighted_firsts[second])
        if (first, second) in seconds:
            bend = bend + product(seconds[first, second], weighted_velocity)
        bends.append((bend - slopes[first] * slopes[second]) * inverse)
    return speed, slopes, bends


def path_length(family: Family, ends: Ends, variables: Float[Array, " variable"]) -> Float[Array, ""]:
    """Compute the length of both straight lines and the curve (m)."""
    shape = curve_shape(family, ends, variables)
    lines = (
        distance(family.chart(ends.surface, *shape[2 * at : 2 * at + 2]), point)
        for at, point in enumerate((ends.start, ends.end))
    )
    return curve_length(family, ends, shape) + sum(lines)


def length_gradient(
    family: Family, ends: Ends, variables: Float[Array, " variable"]
) -> Float[Array, " variable"]:
    """Differentiate the length of a path by its variables."""
    return jax.grad(lambda one: path_length(family, ends, one))(variables)


def length_expansion(
    family: Family, ends: Ends, variables: Float[Array, " variable"]
) -> tuple[Float[Array, ""], Float[Array, " variable"], Float[Array, "variable variable"]]:
    """Length of the path, and its first and second derivatives by the variables.

    The speed at a node depends on four numbers, which are linear in the curve's shape. Second derivatives by
    these few numbers are much cheaper than those by all variables.
    """

    def at_end(variable: Array, point: Array, choice: Any) -> Array:
        place = family.tangent(ends.surface, point, choice, variable)
        return jnp.append(place, distance(family.chart(ends.surface, *place), point))

    def of_end(variable: Array, point: Array, choice: Any) -> tuple[Array, Array, Array]:
        def once(one: Array) -> tuple[Array, Array]:
            return jax.jvp(lambda at: at_end(at, point, choice), (one,), (jnp.ones(()),))

        (value, slope), (_, bend) = jax.jvp(once, (variable,), (jnp.ones(()),))
        return value, slope, bend

    points = jnp.stack([ends.start, ends.end])
    choices = jax.tree.map(lambda *both: jnp.stack(both), ends.at_start, ends.at_end)
    ends_of = list(zip(*jax.vmap(of_end)(variables[:2], points, choices), strict=True))
    shape = jnp.concatenate([ends_of[0][0][:2], ends_of[1][0][:2], variables[2:]])

    speed, slopes, bends = _speeds(family, ends.surface, jnp.asarray(_SHAPES) @ shape)
    by_shape = jnp.concatenate(slopes) @ jnp.asarray(_BY_SHAPE)
    twice_by_shape = (jnp.concatenate(bends) @ jnp.asarray(_TWICE_BY_SHAPE)).reshape(shape.size, shape.size)
    # From the shape to the variables: its first four numbers depend on the variables of the ends.
    chain = jnp.zeros((4 + COEFFICIENTS, VARIABLES)).at[4:, 2:].set(jnp.eye(COEFFICIENTS))
    chain = chain.at[:2, 0].set(ends_of[0][1][:2]).at[2:4, 1].set(ends_of[1][1][:2])
    gradient, hessian = by_shape @ chain, chain.T @ twice_by_shape @ chain
    for number, (_, first, second) in enumerate(ends_of):
        own = by_shape[2 * number : 2 * number + 2]
        gradient = gradient.at[number].add(first[2])
        hessian = hessian.at[number, number].add(second[2] + own @ second[:2])
    value = jnp.asarray(_WEIGHTS) @ speed + ends_of[0][0][2] + ends_of[1][0][2]
    return value, gradient, hessian
