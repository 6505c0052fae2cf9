"""Shortest path from point to point over a curved surface, by minimising the length of a smooth curve.

A chart gives the surface's points by two coordinates. The curve on the surface runs along the first one, an
angle; the second one is a polynomial of it. Both ends of the curve are points where straight lines from the
path's ends are tangent to the surface: a family of points with one variable for each end. Every such path is
outside the surface, if that is convex near it. A damped Newton method minimises the length of the two
straight lines and the curve, by Gauss-Legendre quadrature, over the variables of both ends and the
polynomial's coefficients. At the minimum the straight lines continue the curve, which is a geodesic, up to
errors of the polynomial of which the length is independent to first order. Unlike the roots of conditions of
tangency alone, minima are distinguished from other stationary paths, by the second derivatives. Of the paths
of the family some have a minimal length although a straight line does not continue the curve, as a ray that
is reflected; they are distinguished from shortest paths by the slopes of length by the path's ends, which are
not the lines' directions then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.surfaces.curve_length import (
    COEFFICIENTS,
    END_SLOPES,
    MIDDLE,
    SMALLEST_LENGTH,
    VARIABLES,
    Ends,
    Family,
    curve_length,
    curve_shape,
    distance,
    length_expansion,
    length_gradient,
    path_length,
)
from wrapjax.geometry.vectors import safe_inverse, safe_sqrt

# The decrease of length (m) that Newton's method predicts, at which it ends, and the most steps.
_TOLERANCE, _MAX_STEPS = 1e-22, 25
# That decrease at which a path counts as stationary.
_STATIONARY = 1e-14
# Largest difference between the slopes of length by an end and the direction of its line, and the length (m)
# below which a line has no direction.
_STRAIGHT, _SHORTEST_LINE = 1e-3, 1e-7
# An increase of length (m) up to this size is round-off.
_ROUND_OFF = 1e-15
# Largest step of the variables of both ends (rad).
_LONGEST_STEP = 0.5
_FIRST_DAMPING, _LEAST_DAMPING = 1e-2, 1e-6
# Second derivative of length (m) that counts as zero.
_FLAT = 1e-13


class Curve(NamedTuple):
    """A path over a surface from one point to another."""

    #: Points where the path comes to the surface and leaves it (m).
    first: Float[Array, " 3"]
    last: Float[Array, " 3"]
    #: Unit vectors along the curve at these points.
    first_direction: Float[Array, " 3"]
    last_direction: Float[Array, " 3"]
    #: Point of the surface in the curve's middle (m).
    middle: Float[Array, " 3"]
    #: Length on the surface (m).
    on_surface: Float[Array, ""]
    #: Length from point to point (m).
    total: Float[Array, ""]
    #: Slopes of the total length by the path's ends.
    start_slope: Float[Array, " 3"]
    end_slope: Float[Array, " 3"]
    #: Whether the path's length is stationary, and whether it is smooth and no path nearby is shorter.
    stationary: Bool[Array, ""]
    minimal: Bool[Array, ""]


class Search(NamedTuple):
    """What kind of path is searched for."""

    #: Whether to search a shortest path; otherwise one of stationary length near the initial one.
    shortest: Bool[Array, ""]
    #: Whether to search at all; otherwise the result is the initial path.
    needed: Bool[Array, ""]


def find_curve(family: Family, ends: Ends, initial: Float[Array, " 2"], search: Search) -> Curve:
    """Compute a path of stationary length near an initial one.

    If there is none, the result is the initial path, and ``stationary`` is False.

    Parameters
    ----------
    family
        Kind of the surface.
    ends
        What the path depends on. The result can be differentiated by it any number of times.
    initial
        Variables of both ends of an initial curve, whose polynomial is zero.
    search
        Kind of path.
    """
    start = jnp.concatenate([jax.lax.stop_gradient(initial), jnp.zeros(COEFFICIENTS)])
    found, gradient, hessian = _stationary(family, ends, start, search)
    move, pivots = _eliminated(hessian, gradient[:, None])
    stationary = jnp.abs(jnp.sum(gradient * move[:, 0])) < _STATIONARY
    found = jnp.where(stationary, found, start)
    shape = curve_shape(family, ends, found)
    first, last = family.chart(ends.surface, *shape[:2]), family.chart(ends.surface, *shape[2:4])
    middle = 0.5 * (shape[:2] + shape[2:4]) + jnp.stack([jnp.zeros(()), jnp.asarray(MIDDLE) @ shape[4:]])
    on_surface = curve_length(family, ends, shape)
    first_direction, last_direction = _directions(family, ends.surface, shape)
    start_slope, end_slope = _slopes(family, ends, found)
    return Curve(
        first=first,
        last=last,
        first_direction=first_direction,
        last_direction=last_direction,
        middle=family.chart(ends.surface, *middle),
        on_surface=on_surface,
        total=distance(first, ends.start) + on_surface + distance(last, ends.end),
        start_slope=start_slope,
        end_slope=end_slope,
        stationary=stationary,
        minimal=stationary & jnp.all(pivots > 0.0) & _smooth(family, *jax.lax.stop_gradient((ends, found))),
    )


def _directions(
    family: Family, surface: Any, shape: Float[Array, " shape"]
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Compute unit vectors along a curve at its first and its last point."""
    along = 0.5 * (shape[2:4] - shape[:2])

    def direction(place: Float[Array, " 2"], slopes: Float[np.ndarray, " coefficient"]) -> Float[Array, " 3"]:
        rate = jnp.stack([along[0], along[1] + jnp.asarray(slopes) @ shape[4:]])
        velocity = jax.jvp(lambda at: family.chart(surface, *at), (place,), (rate,))[1]
        return velocity / jnp.sqrt(jnp.sum(velocity**2) + SMALLEST_LENGTH**2)

    return direction(shape[:2], END_SLOPES[0]), direction(shape[2:4], END_SLOPES[1])


def pull_at(
    point: Float[Array, " 3"],
    touch: Float[Array, " 3"],
    direction: Float[Array, " 3"],
    outside: Callable[[Float[Array, " 3"]], Float[Array, " 3"]],
) -> Float[Array, " 3"]:
    """Compute the direction of a path at one of its ends, towards the curve.

    Parameters
    ----------
    point, touch
        End of the path, and the end of the curve that its line touches (m).
    direction
        Unit vector along the curve there, away from the line.
    outside
        Function that moves an end inside the surface to it, and leaves others where they are.

    Returns
    -------
    pull
        The slope of length by the end, negative: a unit vector for an end outside.
    """
    line = touch - outside(point)
    length = safe_sqrt(jnp.sum(line**2))
    # From an end on the surface the path may begin along it.
    along = jnp.where(length > _SHORTEST_LINE, line * safe_inverse(length), direction)
    return slope_by_given(point, along, outside)


def slope_by_given(
    point: Float[Array, " 3"],
    slope: Float[Array, " 3"],
    outside: Callable[[Float[Array, " 3"]], Float[Array, " 3"]],
) -> Float[Array, " 3"]:
    """Convert a slope of length by an end that was moved to the surface to that by the given end.

    Parameters
    ----------
    point
        Given end of the path (m).
    slope
        Slope by the end after it was moved.
    outside
        See `pull_at`.
    """
    return jax.vjp(outside, point)[1](slope)[0]


def _slopes(
    family: Family, ends: Ends, variables: Float[Array, " variable"]
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Compute the slopes of a path's length by both of its ends, of which stationary variables are held."""

    def length(points: tuple[Array, Array]) -> Array:
        return path_length(family, ends._replace(start=points[0], end=points[1]), variables)

    return jax.grad(length)((ends.start, ends.end))


def _smooth(family: Family, ends: Ends, variables: Float[Array, " variable"]) -> Bool[Array, ""]:
    """Whether straight lines continue a curve of stationary length at both of its ends."""
    shape = curve_shape(family, ends, variables)
    smooth = jnp.asarray(True)
    both = zip((ends.start, ends.end), _slopes(family, ends, variables), strict=True)
    for number, (point, slope) in enumerate(both):
        line = point - family.chart(ends.surface, *shape[2 * number : 2 * number + 2])
        along = jnp.sqrt(jnp.sum(line**2) + SMALLEST_LENGTH**2)
        kink = jnp.sqrt(jnp.sum((slope - line / along) ** 2))
        smooth &= (kink < _STRAIGHT) | (along < _SHORTEST_LINE)
    return smooth


def _eliminated(
    matrix: Float[Array, "variable variable"], right: Float[Array, "variable column"]
) -> tuple[Float[Array, "variable column"], Float[Array, " variable"]]:
    """Solve symmetric systems by elimination without exchange of rows; return solutions and pivots.

    The signs of the pivots are those of the eigenvalues. The diagonal is scaled to one, because coefficients
    of a short curve have a small influence on the length. Library functions for single small matrices would
    take most of the time of a batch of many.
    """
    diagonal = jnp.abs(jnp.diagonal(matrix))
    scale = 1.0 / jnp.sqrt(jnp.maximum(diagonal, _FLAT))
    scaled = matrix * scale[None] * scale[:, None] + jnp.diag(jnp.where(diagonal < _FLAT, 1.0, 0.0))
    rows = jnp.concatenate([scaled, right * scale[:, None]], axis=1)
    pivots = []
    for column in range(VARIABLES):
        pivot = rows[column, column]
        pivots.append(pivot)
        own = rows[column] / jnp.where(pivot == 0.0, 1.0, pivot)
        others = rows - rows[:, column : column + 1] * own[None]
        rows = others.at[column].set(own)
    return rows[:, VARIABLES:] * scale[:, None], jnp.stack(pivots)


class _Iterate(NamedTuple):
    """State of the damped Newton method."""

    #: Variables, and the length with its derivatives there.
    at: Float[Array, " variable"]
    value: Float[Array, ""]
    gradient: Float[Array, " variable"]
    hessian: Float[Array, "variable variable"]
    #: Variables at which the length is to be computed next, and whether it may decrease from here to there.
    trial: Float[Array, " variable"]
    downhill: Bool[Array, ""]
    damping: Float[Array, ""]
    #: Whether the next trial is the last one, and whether it has been made.
    last: Bool[Array, ""]
    done: Bool[Array, ""]
    steps: Int[Array, ""]


@eqx.filter_custom_jvp
def _stationary(
    family: Family, ends: Ends, initial: Float[Array, " variable"], search: Search
) -> tuple[Float[Array, " variable"], Float[Array, " variable"], Float[Array, "variable variable"]]:
    """Variables of a path of stationary length, with the derivatives of a root of the length's gradient.

    The length's gradient and second derivatives there are returned as constants. The program has the
    expansion of the length once: it is most of what has to be compiled.
    """

    def unfinished(state: _Iterate) -> Bool[Array, ""]:
        return ~state.done & (state.steps <= _MAX_STEPS)

    def step(state: _Iterate) -> _Iterate:
        found = length_expansion(family, ends, state.trial)
        first = state.steps == 0
        better = first | (state.downhill & ((found[0] <= state.value + _ROUND_OFF) | ~search.shortest))
        at, value, gradient, hessian = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (state.trial, *found),
            (state.at, state.value, state.gradient, state.hessian),
        )
        eased = jnp.where(state.damping <= _LEAST_DAMPING, 0.0, 0.1 * state.damping)
        raised = jnp.maximum(8.0 * state.damping, _FIRST_DAMPING)
        damping = jnp.where(better, eased, raised)
        damped = hessian + damping * jnp.diag(jnp.abs(jnp.diagonal(hessian)))
        moves, pivots = _eliminated(damped, -gradient[:, None])
        move = moves[:, 0]
        promised = -jnp.sum(gradient * move)
        downhill = (jnp.all(pivots > 0.0) | ~search.shortest) & jnp.all(jnp.isfinite(move))
        move = jnp.where(jnp.isfinite(move), move, 0.0)
        limit = _LONGEST_STEP / jnp.maximum(jnp.max(jnp.abs(move[:2])), _LONGEST_STEP)
        return _Iterate(
            at=at,
            value=value,
            gradient=gradient,
            hessian=hessian,
            trial=at + limit * move,
            downhill=downhill,
            damping=damping,
            last=downhill & (jnp.abs(promised) < _TOLERANCE),
            done=state.last | ~search.needed,
            steps=state.steps + 1,
        )

    no = jnp.asarray(False)
    zeros = jnp.zeros(VARIABLES)
    start = _Iterate(
        at=initial,
        value=jnp.asarray(jnp.inf),
        gradient=zeros,
        hessian=jnp.zeros((VARIABLES, VARIABLES)),
        trial=initial,
        downhill=no,
        damping=jnp.asarray(0.0),
        last=no,
        done=no,
        steps=jnp.asarray(0),
    )
    end = jax.lax.while_loop(unfinished, step, start)
    return end.at, end.gradient, end.hessian


@_stationary.def_jvp
def _stationary_jvp(primals, tangents):
    family, ends, _, _ = primals
    found, residual, constant = _stationary(*primals)

    def gradient(ends: Ends) -> Float[Array, " variable"]:
        return length_gradient(family, ends, found)

    _, moved = eqx.filter_jvp(gradient, (ends,), (tangents[1],))
    # Reverse mode transposes the rule, which must be visibly linear in the tangents.
    inverse, _ = _eliminated(_known_hessian(family, ends, found, constant), jnp.eye(VARIABLES))
    return (found, residual, constant), (-inverse @ moved, jnp.zeros_like(residual), jnp.zeros_like(constant))


@eqx.filter_custom_jvp
def _known_hessian(
    family: Family,
    ends: Ends,
    variables: Float[Array, " variable"],
    known: Float[Array, "variable variable"],
) -> Float[Array, "variable variable"]:
    """Second derivatives of length that are known, with derivatives of their own.

    These are computed for second derivatives of a path alone.
    """
    return known


@_known_hessian.def_jvp
def _known_hessian_jvp(primals, tangents):
    family, ends, variables, _ = primals

    def hessian(ends: Ends, variables: Float[Array, " variable"]) -> Float[Array, "variable variable"]:
        return length_expansion(family, ends, variables)[2]

    _, moved = eqx.filter_jvp(hessian, (ends, variables), (tangents[1], tangents[2]))
    return _known_hessian(*primals), moved
