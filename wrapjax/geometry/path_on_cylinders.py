"""Representation of a path round several cylinders, and the step that recomputes one of its contacts.

All coordinates are in ground's frame, because the cylinders may be on different bodies.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.cylinder import HALF_TURN, Cylinder, decide_wrapping
from wrapjax.geometry.vectors import Vector, vector
from wrapjax.geometry.wrapping import FREE, FindContact, Margins

#: OpenSim's outcomes of wrapping a path round one cylinder.
NO_WRAP, INSIDE, WRAPPED = 0, 1, 2


class PointsAndBodies(eqx.Module):
    """A path's points and the bodies that carry its cylinders, in ground's frame.

    Inactive points coincide with the active point before them. Velocities are per unit speed of a coordinate.
    """

    #: m
    position: Float[Array, "*pose point 3"]
    #: m/rad (m/m)
    velocity: Float[Array, "*pose coordinate point 3"]
    #: Number of the body that carries each point.
    point_body: Int[Array, "*pose point"]
    #: Columns are the axes of the body that carries the cylinder.
    rotation: Float[Array, "*pose wrap 3 3"]
    #: Origin of that body (m).
    origin: Float[Array, "*pose wrap 3"]
    #: Angular velocity of that body (rad/rad, rad/m).
    angular: Float[Array, "*pose coordinate wrap 3"]
    #: Velocity of that body's origin (m/rad, m/m).
    linear: Float[Array, "*pose coordinate wrap 3"]
    #: Number of that body.
    wrap_body: Int[Array, "*pose wrap"]
    #: First and last active point of the part of the path that may wrap round each cylinder.
    first_point: Int[Array, "*pose wrap"]
    last_point: Int[Array, "*pose wrap"]


class PathOnCylinders(NamedTuple):
    """A path as a sequence of knots: path points, and the two ends of each cylinder's contact.

    Knots are numbered: path points first, then two for each cylinder.
    """

    #: Numbers of the path's knots in order, padded with -1.
    knots: Int[Array, " place"]
    #: Position of each knot (m).
    position: Float[Array, "knot 3"]
    #: Ends of straight segments (m). They equal ``position``, except for OpenSim's stale wrap points.
    straight_ends: Float[Array, "knot 3"]
    #: Length of the contact with each cylinder (m), zero without contact.
    on_surface: Float[Array, " wrap"]
    #: The axis of all leaves is ``wrap``.
    margins: Margins


class KnotOwners(NamedTuple):
    """Numbers of the body and the cylinder (-1: none) that each knot belongs to."""

    body: Int[Array, " knot"]
    wrap: Int[Array, " knot"]


def initial_path(path: PointsAndBodies, wraps: int) -> PathOnCylinders:
    """Path straight from point to point, in contact with no cylinder."""
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


def refit_wrap(
    path: PointsAndBodies,
    placed: Cylinder,
    wrap: Int[Array, ""],
    route: PathOnCylinders,
    find_contact: FindContact,
) -> tuple[PathOnCylinders, Int[Array, ""]]:
    """Remove one cylinder's contact from the path, and compute it again from its neighbors in the path.

    Parameters
    ----------
    path
        Path points and bodies in one pose.
    placed
        All cylinders in ground's frame.
    wrap
        Number of the cylinder.
    route
        Path before this step.
    find_contact
        Function that computes a contact.

    Returns
    -------
    route, code
        The path after this step, and OpenSim's outcome (`NO_WRAP`, `INSIDE` or `WRAPPED`).
    """
    points = path.position.shape[0]
    bodies = knot_owners(path, placed.radius.shape[0])
    knots = _removed(route.knots, points + 2 * wrap)
    cylinder = jax.tree.map(lambda leaf: leaf[wrap], placed)
    # Without this cylinder's two knots, the last two places are empty.
    before, after = knots[:-3], knots[1:-2]
    first_knots, last_knots = jnp.maximum(before, 0), jnp.maximum(after, 0)
    place = jnp.arange(before.size)
    in_range = (place >= jnp.argmax(knots == path.first_point[wrap])) & (
        place < jnp.argmax(knots == path.last_point[wrap])
    )
    on_one_surface = (bodies.wrap[first_knots] >= 0) & (bodies.wrap[first_knots] == bodies.wrap[last_knots])
    start, end = (
        cylinder.to_cylinder_frame(vector(route.position[first_knots])),
        cylinder.to_cylinder_frame(vector(route.position[last_knots])),
    )
    eligible = in_range & (after >= 0) & ~on_one_surface & ((end - start).norm() > 0.0)

    decision = decide_wrapping(start, end, cylinder)
    contact = find_contact(start, end, cylinder, decision)
    crossing = eligible & (decision.mandatory | decision.possible)
    wraps = crossing & contact.valid
    first, last = cylinder.to_body_frame(contact.first), cylinder.to_body_frame(contact.last)
    straight_start = vector(route.straight_ends[first_knots])
    straight_end = vector(route.straight_ends[last_knots])
    longer = (
        (first - straight_start).norm()
        + contact.length
        + (straight_end - last).norm()
        - (straight_end - straight_start).norm()
    )
    rank = jnp.where(wraps, jnp.where(decision.mandatory, place - 1e6, longer), jnp.inf)
    best = jnp.argmin(rank)
    touched = jnp.any(wraps)

    # OpenSim stops at the first segment that intersects the cylinder, and returns the last segment's outcome.
    codes = jnp.where(decision.inside, INSIDE, jnp.where(wraps, WRAPPED, NO_WRAP))
    examined = eligible & (place <= jnp.where(decision.mandatory[best] & touched, best, place.size))
    last_examined = jnp.max(jnp.where(examined, place, -1))
    code = jnp.where(last_examined >= 0, codes[last_examined], NO_WRAP)

    contacts = jnp.stack([stack_components(first.at(best)), stack_components(last.at(best))])
    rows = points + 2 * wrap + jnp.arange(2)
    position = route.position.at[rows].set(jnp.where(touched, contacts, route.position[rows]))
    turn = HALF_TURN - jnp.abs(contact.turn)
    wrap_margins = Margins(
        inside=jnp.min(jnp.where(eligible, decision.clearance, FREE)),
        off_end=jnp.min(jnp.where(crossing, contact.off_end, FREE)),
        long_wrap=jnp.min(jnp.where(wraps, turn, FREE)),
    )
    fitted = route._replace(
        knots=jnp.where(touched, _inserted(knots, best, points + 2 * wrap), knots),
        position=position,
        on_surface=route.on_surface.at[wrap].set(jnp.where(touched, contact.length[best], 0.0)),
        margins=jax.tree.map(lambda values, value: values.at[wrap].set(value), route.margins, wrap_margins),
    )
    return fitted, code


def knot_owners(path: PointsAndBodies, wraps: int) -> KnotOwners:
    """Body and cylinder that each knot belongs to."""
    points = path.position.shape[0]
    return KnotOwners(
        body=jnp.concatenate([path.point_body, jnp.repeat(path.wrap_body, 2)]),
        wrap=jnp.concatenate([jnp.full(points, -1), jnp.repeat(jnp.arange(wraps), 2)]),
    )


def cylinders_in_ground(path: PointsAndBodies, cylinders: Cylinder) -> Cylinder:
    """Transform cylinders from their bodies' frames to ground's frame."""

    def rotated(direction: Vector) -> Vector:
        return vector(jnp.einsum("wij,wj->wi", path.rotation, stack_components(direction)))

    return eqx.tree_at(
        lambda cylinder: (cylinder.x_axis, cylinder.y_axis, cylinder.z_axis, cylinder.center),
        cylinders,
        (
            *(rotated(cylinders.x_axis), rotated(cylinders.y_axis), rotated(cylinders.z_axis)),
            rotated(cylinders.center) + vector(path.origin),
        ),
    )


def stack_components(vectors: Vector) -> Float[Array, "*vectors 3"]:
    """Array of the vectors, with their components along a last axis."""
    return jnp.stack([vectors.x, vectors.y, vectors.z], axis=-1)


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


def _removed(knots: Int[Array, " place"], first: Int[Array, ""]) -> Int[Array, " place"]:
    """Remove two consecutive knots from the path, if they are in it."""
    place = jnp.arange(knots.size)
    here = jnp.where(jnp.any(knots == first), jnp.argmax(knots == first), knots.size)
    source = jnp.where(place >= here, place + 2, place)
    return jnp.where(source < knots.size, knots[jnp.minimum(source, knots.size - 1)], -1)


def _inserted(
    knots: Int[Array, " place"], after: Int[Array, ""], first: Int[Array, ""]
) -> Int[Array, " place"]:
    """Insert two consecutive knots into the path, after a place."""
    place = jnp.arange(knots.size)
    moved = knots[jnp.where(place <= after, place, jnp.maximum(place - 2, 0))]
    return jnp.where(place == after + 1, first, jnp.where(place == after + 2, first + 1, moved))
