"""A path on its way round several cylinders: each one's contact can be taken out and found anew.

All is in ground's frame, as the cylinders move against each other.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.cylinder import HALF_TURN, Cylinder, decide
from wrapjax.geometry.vectors import Vector, vector
from wrapjax.geometry.wrapping import FREE, FindContact, Margins

#: What became of a cylinder that was looked at.
NO_WRAP, INSIDE, WRAPPED = 0, 1, 2


class PointsAndCarriers(eqx.Module):
    """A path's points and the bodies that carry its cylinders, in ground's frame.

    Inactive points lie on the active one before them. Velocities are by unit speed of a coordinate.
    """

    position: Float[Array, "*pose point 3"]
    velocity: Float[Array, "*pose coordinate point 3"]
    point_body: Int[Array, "*pose point"]
    #: Columns are the carrying body's axes.
    rotation: Float[Array, "*pose wrap 3 3"]
    origin: Float[Array, "*pose wrap 3"]
    angular: Float[Array, "*pose coordinate wrap 3"]
    linear: Float[Array, "*pose coordinate wrap 3"]
    wrap_body: Int[Array, "*pose wrap"]
    #: The stretch of points that may wrap.
    first_point: Int[Array, "*pose wrap"]
    last_point: Int[Array, "*pose wrap"]


class PathOnCylinders(NamedTuple):
    """The path while cylinders are fitted in.

    Knots are numbered: points first, then two for each cylinder. ``knots`` is the path, its end filled
    up with -1; ``seen`` is where straight pieces are taken to end.
    """

    knots: Int[Array, " place"]
    position: Float[Array, "knot 3"]
    seen: Float[Array, "knot 3"]
    on_surface: Float[Array, " wrap"]
    margins: Margins


class KnotOwners(NamedTuple):
    """What the knots belong to: a body, and a cylinder (-1: none)."""

    body: Int[Array, " knot"]
    wrap: Int[Array, " knot"]


def start_of(path: PointsAndCarriers, wraps: int) -> PathOnCylinders:
    """Lay the path straight from point to point, on no cylinder."""
    points = path.position.shape[0]
    filler = jnp.zeros((2 * wraps, 3))
    position = jnp.concatenate([path.position, filler])
    free = jnp.full(wraps, FREE)
    return PathOnCylinders(
        knots=jnp.concatenate([jnp.arange(points), jnp.full(2 * wraps, -1)]),
        position=position,
        seen=position,
        on_surface=jnp.zeros(wraps),
        margins=Margins(free, free, free),
    )


def fit_in(
    path: PointsAndCarriers,
    placed: Cylinder,
    wrap: Int[Array, ""],
    way: PathOnCylinders,
    find_contact: FindContact,
) -> tuple[PathOnCylinders, Int[Array, ""]]:
    """Take one cylinder's contact out of the path and find it anew; say what became of it."""
    points = path.position.shape[0]
    bodies = owners_of(path, placed.radius.shape[0])
    knots = _removed(way.knots, points + 2 * wrap)
    cylinder = jax.tree.map(lambda leaf: leaf[wrap], placed)
    # Without this cylinder's own two contacts the path has so many pieces at most.
    before, after = knots[:-3], knots[1:-2]
    first_knots, last_knots = jnp.maximum(before, 0), jnp.maximum(after, 0)
    place = jnp.arange(before.size)
    in_range = (place >= jnp.argmax(knots == path.first_point[wrap])) & (
        place < jnp.argmax(knots == path.last_point[wrap])
    )
    on_one_surface = (bodies.wrap[first_knots] >= 0) & (bodies.wrap[first_knots] == bodies.wrap[last_knots])
    start, end = (
        cylinder.inward(vector(way.position[first_knots])),
        cylinder.inward(vector(way.position[last_knots])),
    )
    eligible = in_range & (after >= 0) & ~on_one_surface & ((end - start).norm() > 0.0)

    decision = decide(start, end, cylinder)
    contact = find_contact(start, end, cylinder, decision)
    crossing = eligible & (decision.mandatory | decision.possible)
    wraps = crossing & contact.made
    first, last = cylinder.outward(contact.first), cylinder.outward(contact.last)
    seen_start, seen_end = vector(way.seen[first_knots]), vector(way.seen[last_knots])
    longer = (
        (first - seen_start).norm()
        + contact.length
        + (seen_end - last).norm()
        - (seen_end - seen_start).norm()
    )
    rank = jnp.where(wraps, jnp.where(decision.mandatory, place - 1e6, longer), jnp.inf)
    best = jnp.argmin(rank)
    touched = jnp.any(wraps)

    codes = jnp.where(decision.inside, INSIDE, jnp.where(wraps, WRAPPED, NO_WRAP))
    looked_at = eligible & (place <= jnp.where(decision.mandatory[best] & touched, best, place.size))
    last_looked_at = jnp.max(jnp.where(looked_at, place, -1))
    code = jnp.where(last_looked_at >= 0, codes[last_looked_at], NO_WRAP)

    contacts = jnp.stack([as_rows(first.at(best)), as_rows(last.at(best))])
    rows = points + 2 * wrap + jnp.arange(2)
    position = way.position.at[rows].set(jnp.where(touched, contacts, way.position[rows]))
    turn = HALF_TURN - jnp.abs(contact.turn)
    own = Margins(
        inside=jnp.min(jnp.where(eligible, decision.clearance, FREE)),
        off_end=jnp.min(jnp.where(crossing, contact.off_end, FREE)),
        long_wrap=jnp.min(jnp.where(wraps, turn, FREE)),
    )
    fitted = way._replace(
        knots=jnp.where(touched, _inserted(knots, best, points + 2 * wrap), knots),
        position=position,
        on_surface=way.on_surface.at[wrap].set(jnp.where(touched, contact.length[best], 0.0)),
        margins=jax.tree.map(lambda all_of_them, one: all_of_them.at[wrap].set(one), way.margins, own),
    )
    return fitted, code


def owners_of(path: PointsAndCarriers, wraps: int) -> KnotOwners:
    """Say what each knot belongs to."""
    points = path.position.shape[0]
    return KnotOwners(
        body=jnp.concatenate([path.point_body, jnp.repeat(path.wrap_body, 2)]),
        wrap=jnp.concatenate([jnp.full(points, -1), jnp.repeat(jnp.arange(wraps), 2)]),
    )


def in_ground(path: PointsAndCarriers, cylinders: Cylinder) -> Cylinder:
    """Bring cylinders from their bodies' frames into ground's."""

    def turned(direction: Vector) -> Vector:
        return vector(jnp.einsum("wij,wj->wi", path.rotation, as_rows(direction)))

    return eqx.tree_at(
        lambda cylinder: (cylinder.x_axis, cylinder.y_axis, cylinder.z_axis, cylinder.center),
        cylinders,
        (
            *(turned(cylinders.x_axis), turned(cylinders.y_axis), turned(cylinders.z_axis)),
            turned(cylinders.center) + vector(path.origin),
        ),
    )


def as_rows(vectors: Vector) -> Float[Array, "*vectors 3"]:
    """Stack components along a last axis."""
    return jnp.stack([vectors.x, vectors.y, vectors.z], axis=-1)


def pieces_of(
    way: PathOnCylinders, points: int
) -> tuple[Int[Array, " piece"], Int[Array, " piece"], Bool[Array, " piece"], Bool[Array, " piece"]]:
    """Knots at both ends of each piece, whether it is part of the path, and whether it is straight."""
    before, after = way.knots[:-1], way.knots[1:]
    on_surface = (before >= points) & (after == before + 1) & ((before - points) % 2 == 0)
    return jnp.maximum(before, 0), jnp.maximum(after, 0), after >= 0, ~on_surface


def length_of(way: PathOnCylinders, points: int) -> Float[Array, ""]:
    """Length of the whole path, m, its straight pieces ending where they are taken to end."""
    before, after, there, straight = pieces_of(way, points)
    way_along = vector(way.seen[after] - way.seen[before]).norm()
    return jnp.sum(jnp.where(there & straight, way_along, 0.0)) + jnp.sum(way.on_surface)


def _removed(knots: Int[Array, " place"], first: Int[Array, ""]) -> Int[Array, " place"]:
    """Take two neighbouring knots out of the path, if they are in it."""
    place = jnp.arange(knots.size)
    here = jnp.where(jnp.any(knots == first), jnp.argmax(knots == first), knots.size)
    source = jnp.where(place >= here, place + 2, place)
    return jnp.where(source < knots.size, knots[jnp.minimum(source, knots.size - 1)], -1)


def _inserted(
    knots: Int[Array, " place"], after: Int[Array, ""], first: Int[Array, ""]
) -> Int[Array, " place"]:
    """Put two knots into the path, after a place."""
    place = jnp.arange(knots.size)
    moved = knots[jnp.where(place <= after, place, jnp.maximum(place - 2, 0))]
    return jnp.where(place == after + 1, first, jnp.where(place == after + 2, first + 1, moved))
