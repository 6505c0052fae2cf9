"""Representation of a path round several surfaces, and the step that recomputes one of its contacts.

All coordinates are in ground's frame, because the surfaces may be on different bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.exact_paths.wrapping import FREE, Margins
from wrapjax.geometry.surfaces.placed_surface import HALF_TURN, PlacedSurface, WrapMethod
from wrapjax.geometry.vectors import Vector, stack_components, vector

_Result = TypeVar("_Result")
#: OpenSim's outcomes of wrapping a path round one surface.
NO_WRAP, INSIDE, WRAPPED = 0, 1, 2


class PointsAndBodies(eqx.Module):
    """A path's points and the bodies that carry its surfaces, in ground's frame.

    Inactive points coincide with the active point before them. Velocities are per unit speed of a coordinate.
    """

    #: m
    position: Float[Array, "*pose point 3"]
    #: m/rad (m/m)
    velocity: Float[Array, "*pose coordinate point 3"]
    #: Number of the body that carries each point.
    point_body: Int[Array, "*pose point"]
    #: Columns are the axes of the body that carries the surface.
    rotation: Float[Array, "*pose wrap 3 3"]
    #: Origin of that body (m).
    origin: Float[Array, "*pose wrap 3"]
    #: Angular velocity of that body (rad/rad, rad/m).
    angular: Float[Array, "*pose coordinate wrap 3"]
    #: Velocity of that body's origin (m/rad, m/m).
    linear: Float[Array, "*pose coordinate wrap 3"]
    #: Number of that body.
    wrap_body: Int[Array, "*pose wrap"]
    #: First and last active point of the part of the path that may wrap round each surface.
    first_point: Int[Array, "*pose wrap"]
    last_point: Int[Array, "*pose wrap"]
    #: Whether each point moves relative to its body; None if no point does.
    moving: Bool[Array, "*pose point"] | None = None


class PathOnCylinders(NamedTuple):
    """A path as a sequence of knots: path points, and the two ends of each surface's contact.

    Knots are numbered: path points first, then two for each surface.
    """

    #: Numbers of the path's knots in order, padded with -1.
    knots: Int[Array, " place"]
    #: Position of each knot (m).
    position: Float[Array, "knot 3"]
    #: Ends of straight segments (m). They equal ``position``, except for OpenSim's stale wrap points.
    straight_ends: Float[Array, "knot 3"]
    #: Length of the contact with each surface (m), zero without contact.
    on_surface: Float[Array, " wrap"]
    #: The axis of all leaves is ``wrap``.
    margins: Margins


class KnotOwners(NamedTuple):
    """Numbers of the body and the surface (-1: none) that each knot belongs to."""

    body: Int[Array, " knot"]
    wrap: Int[Array, " knot"]


def initial_path(path: PointsAndBodies, wraps: int) -> PathOnCylinders:
    """Path straight from point to point, in contact with no surface."""
    points = path.position.shape[0]
    filler = jnp.zeros((2 * wraps, 3))
    position = jnp.concatenate([path.position, filler])
    free = jnp.full(wraps, FREE)
    return PathOnCylinders(
        knots=jnp.concatenate([jnp.arange(points), jnp.full(2 * wraps, -1)]),
        position=position,
        straight_ends=position,
        on_surface=jnp.zeros(wraps),
        margins=Margins(free, free, free),
    )


class _Fitted(NamedTuple):
    """Contact of a path with one surface, computed from all segments that may wrap round it."""

    touched: Bool[Array, ""]
    #: Place in the path of the segment that wraps.
    best: Int[Array, ""]
    #: Points where the path comes to the surface and leaves it, in ground's frame (m).
    contacts: Float[Array, "2 3"]
    #: Length on the surface (m).
    length: Float[Array, ""]
    #: OpenSim's outcome.
    code: Int[Array, ""]
    margins: Margins


def refit_wrap(
    path: PointsAndBodies,
    placed: PlacedSurface,
    wrap: Int[Array, ""] | int,
    route: PathOnCylinders,
    methods: Sequence[WrapMethod],
    numbers: Int[Array, " wrap"] | None = None,
) -> tuple[PathOnCylinders, Int[Array, ""]]:
    """Remove one surface's contact from the path, and compute it again from its neighbors in the path.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    placed
        All surfaces in ground's frame.
    wrap
        Number of the surface.
    route
        Path before this step.
    methods
        How segments wrap round each surface, at least up to the largest value of ``wrap``. With ``numbers``,
        the methods in any order.
    numbers
        Number of each surface's method.

    Returns
    -------
    route, code
        The path after this step, and OpenSim's outcome (`NO_WRAP`, `INSIDE` or `WRAPPED`).
    """
    points = path.position.shape[0]
    bodies = knot_owners(path, placed.radius.shape[0])
    knots = _removed(route.knots, points + 2 * wrap)
    surface = jax.tree.map(lambda leaf: leaf[wrap], placed)
    # Without this surface's two knots, the last two places are empty.
    before, after = knots[:-3], knots[1:-2]
    first_knots, last_knots = jnp.maximum(before, 0), jnp.maximum(after, 0)
    place = jnp.arange(before.size)
    in_range = (place >= jnp.argmax(knots == path.first_point[wrap])) & (
        place < jnp.argmax(knots == path.last_point[wrap])
    )
    on_one_surface = (bodies.wrap[first_knots] >= 0) & (bodies.wrap[first_knots] == bodies.wrap[last_knots])
    start, end = (
        surface.to_surface_frame(vector(route.position[first_knots])),
        surface.to_surface_frame(vector(route.position[last_knots])),
    )
    eligible = in_range & (after >= 0) & ~on_one_surface & ((end - start).norm() > 0.0)
    straight_start = vector(route.straight_ends[first_knots])
    straight_end = vector(route.straight_ends[last_knots])
    operands = (start, end, straight_start, straight_end, surface, eligible)
    fitted = by_method(methods, wrap, numbers, _fit, *operands)

    rows = points + 2 * wrap + jnp.arange(2)
    position = route.position.at[rows].set(jnp.where(fitted.touched, fitted.contacts, route.position[rows]))
    inserted = _inserted(knots, fitted.best, points + 2 * wrap)
    found = route._replace(
        knots=jnp.where(fitted.touched, inserted, knots),
        position=position,
        on_surface=route.on_surface.at[wrap].set(jnp.where(fitted.touched, fitted.length, 0.0)),
        margins=jax.tree.map(lambda values, value: values.at[wrap].set(value), route.margins, fitted.margins),
    )
    return found, fitted.code


def by_method(
    methods: Sequence[WrapMethod],
    wrap: Int[Array, ""] | int,
    numbers: Int[Array, " wrap"] | None,
    function: Callable[..., _Result],
    *operands: Any,
) -> _Result:
    """Call a function, whose first argument is a method, with the method of a surface.

    Arguments are those of `refit_wrap`. Only this method is evaluated, unless ``wrap`` or ``numbers`` differ
    in a batch.
    """
    if numbers is not None:
        branches = [partial(function, method) for method in methods]
        return jax.lax.switch(numbers[wrap], branches, *operands)
    if isinstance(wrap, int):
        return function(methods[wrap], *operands)
    different = list(dict.fromkeys(methods))
    if len(different) == 1:
        return function(different[0], *operands)
    places = jnp.asarray([different.index(method) for method in methods])
    return jax.lax.switch(places[wrap], [partial(function, method) for method in different], *operands)


def _fit(
    method: WrapMethod,
    start: Vector,
    end: Vector,
    straight_start: Vector,
    straight_end: Vector,
    surface: PlacedSurface,
    eligible: Bool[Array, " place"],
) -> _Fitted:
    """Find the segment that wraps round a surface, and its contact.

    ``start`` and ``end`` are in the surface's frame, ``straight_start`` and ``straight_end`` in ground's
    frame.
    """
    place = jnp.arange(eligible.size)
    decision = method.decide(start, end, surface)
    crossing = eligible & (decision.mandatory | decision.possible)
    clear = jnp.min(jnp.where(eligible, decision.clearance, FREE))
    if method.decided_first:
        rank = jnp.where(crossing, jnp.where(decision.mandatory, place - 1e6, decision.increase), jnp.inf)
        best = jnp.argmin(rank)
        own = jax.tree.map(lambda leaf: leaf[best], (start, end, decision))
        contact = method.find_contact(own[0], own[1], surface, own[2])
        wraps = crossing & contact.valid
        touched = wraps[best]
    else:
        contact = method.find_contact(start, end, surface, decision)
        wraps = crossing & contact.valid
        first, last = surface.to_body_frame(contact.first), surface.to_body_frame(contact.last)
        longer = (
            (first - straight_start).norm()
            + contact.length
            + (straight_end - last).norm()
            - (straight_end - straight_start).norm()
        )
        rank = jnp.where(wraps, jnp.where(decision.mandatory, place - 1e6, longer), jnp.inf)
        best = jnp.argmin(rank)
        touched = jnp.any(wraps)

    # OpenSim stops at the first segment that intersects the surface, and returns the last segment's outcome.
    codes = jnp.where(decision.inside, INSIDE, jnp.where(wraps, WRAPPED, NO_WRAP))
    if method.always_wrapped:
        codes = jnp.full_like(codes, WRAPPED)
    examined = eligible & (place <= jnp.where(decision.mandatory[best] & touched, best, place.size))
    last_examined = jnp.max(jnp.where(examined, place, -1))
    code = jnp.where(last_examined >= 0, codes[last_examined], NO_WRAP)

    turn = HALF_TURN - jnp.abs(contact.turn)
    margins = Margins(
        inside=clear,
        off_end=jnp.min(jnp.where(crossing, contact.off_end, FREE)),
        long_wrap=jnp.min(jnp.where(wraps, turn, FREE)),
    )
    chosen = contact if method.decided_first else jax.tree.map(lambda leaf: leaf[best], contact)
    ends = surface.to_body_frame(chosen.first), surface.to_body_frame(chosen.last)
    contacts = jnp.stack([stack_components(point) for point in ends])
    return _Fitted(touched, best, contacts, chosen.length, code, margins)


def knot_owners(path: PointsAndBodies, wraps: int) -> KnotOwners:
    """Body and surface that each knot belongs to."""
    points = path.position.shape[0]
    return KnotOwners(
        body=jnp.concatenate([path.point_body, jnp.repeat(path.wrap_body, 2)]),
        wrap=jnp.concatenate([jnp.full(points, -1), jnp.repeat(jnp.arange(wraps), 2)]),
    )


def surfaces_in_ground(path: PointsAndBodies, surfaces: PlacedSurface) -> PlacedSurface:
    """Transform surfaces from their bodies' frames to ground's frame."""

    def rotated(direction: Vector) -> Vector:
        return vector(jnp.einsum("wij,wj->wi", path.rotation, stack_components(direction)))

    return eqx.tree_at(
        lambda surface: (surface.x_axis, surface.y_axis, surface.z_axis, surface.center),
        surfaces,
        (
            *(rotated(surfaces.x_axis), rotated(surfaces.y_axis), rotated(surfaces.z_axis)),
            rotated(surfaces.center) + vector(path.origin),
        ),
    )


def path_segments(
    route: PathOnCylinders, points: int
) -> tuple[Int[Array, " segment"], Int[Array, " segment"], Bool[Array, " segment"], Bool[Array, " segment"]]:
    """Split the path into segments.

    Returns
    -------
    before, after, present, straight
        Knots at both ends of each segment, whether it is part of the path, and whether it is straight.
    """
    before, after = route.knots[:-1], route.knots[1:]
    on_surface = (before >= points) & (after == before + 1) & ((before - points) % 2 == 0)
    return jnp.maximum(before, 0), jnp.maximum(after, 0), after >= 0, ~on_surface


def path_length(route: PathOnCylinders, points: int) -> Float[Array, ""]:
    """Length of the path (m): straight segments between ``straight_ends``, and contacts."""
    before, after, present, straight = path_segments(route, points)
    distance = vector(route.straight_ends[after] - route.straight_ends[before]).norm()
    return jnp.sum(jnp.where(present & straight, distance, 0.0)) + jnp.sum(route.on_surface)


def _removed(knots: Int[Array, " place"], first: Int[Array, ""] | int) -> Int[Array, " place"]:
    """Remove two consecutive knots from the path, if they are in it."""
    place = jnp.arange(knots.size)
    here = jnp.where(jnp.any(knots == first), jnp.argmax(knots == first), knots.size)
    source = jnp.where(place >= here, place + 2, place)
    return jnp.where(source < knots.size, knots[jnp.minimum(source, knots.size - 1)], -1)


def _inserted(
    knots: Int[Array, " place"], after: Int[Array, ""], first: Int[Array, ""] | int
) -> Int[Array, " place"]:
    """Insert two consecutive knots into the path, after a place."""
    place = jnp.arange(knots.size)
    moved = knots[jnp.where(place <= after, place, jnp.maximum(place - 2, 0))]
    return jnp.where(place == after + 1, first, jnp.where(place == after + 2, first + 1, moved))
