"""A path that may wrap round several cylinders, on one body or on several, in one pose.

Each cylinder is fitted into the path as the others leave it, in turns, until nothing changes. All is
in ground's frame, as the cylinders move against each other.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.cylinder import (
    HALF_TURN,
    Cylinder,
    decide,
    geodesic_contact,
    settled_spiral_contact,
)
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, vector
from wrapjax.geometry.wrapping import FREE, FindContact, Margins, WrappedPath

_OPENSIM_SWEEPS = 8
_OPENSIM_TOLERANCE = 0.0005
_SWEEPS = 20
_LEAPS = 30
# Contacts that move by less (m) touch what they will touch.
_NEARLY = 1e-3
_GEODESIC_TOLERANCE = 1e-13

_NO_WRAP, _INSIDE, _WRAPPED = 0, 1, 2


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


class Way(NamedTuple):
    """Where a path runs, in ground's frame.

    Knots are numbered: points first, then the two ends of each cylinder's contact. ``knots`` is the path,
    filled up with -1 at its end; ``on_surface`` is the length of each contact (m), zero where a cylinder is
    not touched.
    """

    knots: Int[Array, " place"]
    position: Float[Array, "knot 3"]
    on_surface: Float[Array, " wrap"]
    cylinders: Cylinder


class _Path(NamedTuple):
    """The path while cylinders are fitted in.

    Knots are numbered: points first, then two for each cylinder. ``knots`` is the path, its end filled
    up with -1; ``seen`` is where straight pieces are taken to end.
    """

    knots: Int[Array, " place"]
    position: Float[Array, "knot 3"]
    seen: Float[Array, "knot 3"]
    on_surface: Float[Array, " wrap"]
    margins: Margins


class _Held(NamedTuple):
    """The path on the cylinders that hold it: how long it is there, and how far from slipping off."""

    length: Float[Array, " wrap"]
    off_end: Float[Array, " wrap"]
    long_wrap: Float[Array, " wrap"]


class _Bodies(NamedTuple):
    """What the knots belong to: a body, and a cylinder (-1: none)."""

    body: Int[Array, " knot"]
    wrap: Int[Array, " knot"]


def wrap_in_parity(path: PointsAndCarriers, cylinders: Cylinder) -> WrappedPath:
    """Wrap a path round several cylinders as OpenSim 4.6 does, its defects included.

    Parameters
    ----------
    path
        In one pose.
    cylinders
        Each in the frame of the body that carries it.

    Notes
    -----
    From the second sweep on OpenSim takes straight pieces to end where they ended in the first one
    that a cylinder was touched in, while forces act at the points as they are.
    """
    placed = _in_ground(path, cylinders)
    points, wraps = path.position.shape[0], cylinders.radius.shape[0]

    def sweep(state):
        way, looked_at, order, last_length, count, _ = state
        codes = []
        for turn in range(wraps):
            way, code = _fit_in(path, placed, order[turn], way, settled_spiral_contact)
            codes.append(code)
            # A point that has been looked at in ground's frame is taken to stay there.
            seen = jnp.where(looked_at[:, None], way.seen, way.position)
            way = way._replace(seen=seen)
        looked_at = looked_at | jnp.any(way.knots[None] == jnp.arange(points + 2 * wraps)[:, None], axis=1)
        length = _length(way, points)
        done = jnp.abs(length - last_length) < _OPENSIM_TOLERANCE
        swap = (count == 0) & ~done & (codes[0] == _NO_WRAP) & (codes[1] == _INSIDE)
        order = jnp.where(swap, order.at[:2].set(order[:2][::-1]), order)
        return way, looked_at, order, length, count + 1, done

    def unfinished(state):
        return ~state[5] & (state[4] < _OPENSIM_SWEEPS)

    nothing = jnp.zeros(points + 2 * wraps, dtype=bool)
    start = (
        *(_start(path, wraps), nothing, jnp.arange(wraps)),
        *(jnp.asarray(jnp.inf), jnp.asarray(0), jnp.asarray(False)),
    )
    way, *_ = jax.lax.while_loop(unfinished, sweep, start)
    return _outcome(way, path, placed, way.margins.off_end, way.margins.long_wrap)


def wrap_shortest(path: PointsAndCarriers, cylinders: Cylinder) -> WrappedPath:
    """Wrap a path round several cylinders by the shortest way; moment arms are exactly -dL/dq.

    Parameters
    ----------
    path
        In one pose.
    cylinders
        Each in the frame of the body that carries it.
    """
    way, held = _laid(path, cylinders)
    return _outcome(way, path, _in_ground(path, cylinders), held.off_end, held.long_wrap)


def shortest_way(path: PointsAndCarriers, cylinders: Cylinder) -> Way:
    """Say where the path of `wrap_shortest` runs, round any number of cylinders, in one pose."""
    way, _ = _laid(path, cylinders)
    return Way(way.knots, way.position, way.on_surface, _in_ground(path, cylinders))


def _laid(path: PointsAndCarriers, cylinders: Cylinder) -> tuple[_Path, _Held]:
    """Lay the path the shortest way; it follows the points and the cylinders as these move."""
    points = path.position.shape[0]
    way = _settled(*jax.lax.stop_gradient((path, cylinders)))
    contacts = _with_derivatives(way.position[points:], way.knots, path, cylinders)
    contacts, held = _refitted(contacts, way.knots, path, _in_ground(path, cylinders))
    position = jnp.concatenate([path.position, contacts])
    return way._replace(position=position, seen=position, on_surface=held.length), held


def _settled(path: PointsAndCarriers, cylinders: Cylinder) -> _Path:
    """Find which cylinders the path touches, and in which order; then move the contacts until they stay."""
    placed = _in_ground(path, cylinders)
    points, wraps = path.position.shape[0], cylinders.radius.shape[0]

    def sweep(state):
        way, _, count = state
        before = way

        def fit_in(turn, way):
            way, _ = _fit_in(path, placed, turn, way, geodesic_contact)
            return way._replace(seen=way.position)

        way = jax.lax.fori_loop(0, wraps, fit_in, way)
        moved = jnp.max(jnp.abs(way.position - before.position))
        same = jnp.all(way.knots == before.knots)
        return way, same & (moved < _NEARLY), count + 1

    def unordered(state):
        return ~state[1] & (state[2] < _SWEEPS)

    start = (_start(path, wraps), jnp.asarray(False), jnp.asarray(0))
    way, *_ = jax.lax.while_loop(unordered, sweep, start)

    def leap(state):
        # Contacts come nearer by a constant factor each time: two steps tell where they end (Aitken).
        contacts, _, count = state
        once, _ = _refitted(contacts, way.knots, path, placed)
        twice, _ = _refitted(once, way.knots, path, placed)
        first, second = once - contacts, twice - once
        factor = jnp.clip(jnp.sum(first * second) * safe_inverse(jnp.sum(first**2)), -0.9, 0.9)
        # A last leap could lead off the surface by as much as it is long.
        arrived = jnp.max(jnp.abs(second)) < _GEODESIC_TOLERANCE
        ahead = jnp.where(arrived, 0.0, factor / (1.0 - factor))
        return twice + ahead * second, arrived, count + 1

    def unsettled(state):
        return ~state[1] & (state[2] < _LEAPS)

    found = (way.position[points:], jnp.asarray(False), jnp.asarray(0))
    contacts, *_ = jax.lax.while_loop(unsettled, leap, found)
    return way._replace(position=jnp.concatenate([path.position, contacts]))


@eqx.filter_custom_jvp
def _with_derivatives(
    contacts: Float[Array, "contact 3"],
    knots: Int[Array, " place"],
    path: PointsAndCarriers,
    cylinders: Cylinder,
) -> Float[Array, "contact 3"]:
    """Give settled points of contact the derivatives that fitting in once more leaves them.

    Settled points x solve x = T(x, p), so dx = (1 - dT/dx)^-1 dT/dp dp: no sweep is differentiated.
    """
    return contacts


@_with_derivatives.def_jvp
def _with_derivatives_jvp(primals, tangents):
    _, knots, path, cylinders = primals
    _, _, path_tangent, cylinders_tangent = tangents
    # Not the bare points: derivatives of this rule are second derivatives, and they move with everything.
    contacts = _with_derivatives(*primals)

    def refit(x, path, cylinders):
        placed = _in_ground(path, cylinders)
        return _refitted(x.reshape(contacts.shape), knots, path, placed)[0].ravel()

    flat = contacts.ravel()
    _, moved = eqx.filter_jvp(
        lambda path, cylinders: refit(flat, path, cylinders),
        (path, cylinders),
        (path_tangent, cylinders_tangent),
    )
    by_contacts = jax.jacfwd(refit)(flat, path, cylinders)
    tangent = jnp.linalg.solve(jnp.eye(flat.size) - by_contacts, moved)
    return contacts, tangent.reshape(contacts.shape)


def _refitted(
    contacts: Float[Array, "contact 3"],
    knots: Int[Array, " place"],
    path: PointsAndCarriers,
    placed: Cylinder,
) -> tuple[Float[Array, "contact 3"], _Held]:
    """Fit every touched cylinder in once more, each between its neighbours on the path as it is."""
    points = path.position.shape[0]

    def refit(position, entry):
        wrap, cylinder = entry
        rows = points + 2 * wrap + jnp.arange(2)
        touched = jnp.any(knots == rows[0])
        place = jnp.argmax(knots == rows[0])
        before = jnp.maximum(knots[place - 1], 0)
        after = jnp.maximum(knots[jnp.minimum(place + 2, knots.size - 1)], 0)
        start, end = cylinder.inward(vector(position[before])), cylinder.inward(vector(position[after]))
        contact = geodesic_contact(start, end, cylinder, decide(start, end, cylinder))
        found = jnp.stack([_rows(cylinder.outward(contact.first)), _rows(cylinder.outward(contact.last))])
        kept = jax.lax.stop_gradient(position[rows])
        moved = position.at[rows].set(jnp.where(touched, found, kept))
        return moved, _Held(
            length=jnp.where(touched, contact.length, 0.0),
            off_end=jnp.where(touched, contact.off_end, FREE),
            long_wrap=jnp.where(touched, HALF_TURN - contact.turn, FREE),
        )

    start = jnp.concatenate([path.position, contacts])
    position, held = jax.lax.scan(refit, start, (jnp.arange(placed.radius.shape[0]), placed))
    return position[points:], held


def _fit_in(
    path: PointsAndCarriers,
    placed: Cylinder,
    wrap: Int[Array, ""],
    way: _Path,
    find_contact: FindContact,
) -> tuple[_Path, Int[Array, ""]]:
    """Take one cylinder's contact out of the path and find it anew; say what became of it."""
    points = path.position.shape[0]
    bodies = _bodies(path, placed.radius.shape[0])
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

    codes = jnp.where(decision.inside, _INSIDE, jnp.where(wraps, _WRAPPED, _NO_WRAP))
    looked_at = eligible & (place <= jnp.where(decision.mandatory[best] & touched, best, place.size))
    last_looked_at = jnp.max(jnp.where(looked_at, place, -1))
    code = jnp.where(last_looked_at >= 0, codes[last_looked_at], _NO_WRAP)

    contacts = jnp.stack([_rows(first.at(best)), _rows(last.at(best))])
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


def _start(path: PointsAndCarriers, wraps: int) -> _Path:
    points = path.position.shape[0]
    filler = jnp.zeros((2 * wraps, 3))
    position = jnp.concatenate([path.position, filler])
    free = jnp.full(wraps, FREE)
    return _Path(
        knots=jnp.concatenate([jnp.arange(points), jnp.full(2 * wraps, -1)]),
        position=position,
        seen=position,
        on_surface=jnp.zeros(wraps),
        margins=Margins(free, free, free),
    )


def _bodies(path: PointsAndCarriers, wraps: int) -> _Bodies:
    points = path.position.shape[0]
    return _Bodies(
        body=jnp.concatenate([path.point_body, jnp.repeat(path.wrap_body, 2)]),
        wrap=jnp.concatenate([jnp.full(points, -1), jnp.repeat(jnp.arange(wraps), 2)]),
    )


def _in_ground(path: PointsAndCarriers, cylinders: Cylinder) -> Cylinder:
    """Bring cylinders from their bodies' frames into ground's."""

    def turned(direction: Vector) -> Vector:
        return vector(jnp.einsum("wij,wj->wi", path.rotation, _rows(direction)))

    return eqx.tree_at(
        lambda cylinder: (cylinder.x_axis, cylinder.y_axis, cylinder.z_axis, cylinder.center),
        cylinders,
        (
            *(turned(cylinders.x_axis), turned(cylinders.y_axis), turned(cylinders.z_axis)),
            turned(cylinders.center) + vector(path.origin),
        ),
    )


def _rows(vectors: Vector) -> Float[Array, "*vectors 3"]:
    return jnp.stack([vectors.x, vectors.y, vectors.z], axis=-1)


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


def _pieces(
    way: _Path, points: int
) -> tuple[Int[Array, " piece"], Int[Array, " piece"], Bool[Array, " piece"], Bool[Array, " piece"]]:
    """Knots at both ends of each piece, whether it is part of the path, and whether it is straight."""
    before, after = way.knots[:-1], way.knots[1:]
    on_surface = (before >= points) & (after == before + 1) & ((before - points) % 2 == 0)
    return jnp.maximum(before, 0), jnp.maximum(after, 0), after >= 0, ~on_surface


def _length(way: _Path, points: int) -> Float[Array, ""]:
    before, after, there, straight = _pieces(way, points)
    way_along = vector(way.seen[after] - way.seen[before]).norm()
    return jnp.sum(jnp.where(there & straight, way_along, 0.0)) + jnp.sum(way.on_surface)


def _outcome(
    way: _Path,
    path: PointsAndCarriers,
    placed: Cylinder,
    off_end: Float[Array, " wrap"],
    long_wrap: Float[Array, " wrap"],
) -> WrappedPath:
    points, wraps = path.position.shape[0], placed.radius.size
    before, after, there, _ = _pieces(way, points)
    body = _bodies(path, wraps).body
    pulls = there & (body[before] != body[after])
    along = way.seen[after] - way.seen[before]
    along = along * safe_inverse(safe_sqrt(jnp.sum(along**2, axis=-1)))[:, None]
    # Velocities of the points of contact: of the bodies' material there.
    arm = (way.position[points:] - jnp.repeat(path.origin, 2, axis=0))[None]
    turning = jnp.repeat(path.angular, 2, axis=1)
    contact_velocity = jnp.repeat(path.linear, 2, axis=1) + jnp.cross(turning, arm)
    velocity = jnp.concatenate([path.velocity, contact_velocity], axis=1)
    rate = jnp.sum((velocity[:, after] - velocity[:, before]) * along[None], axis=-1)
    return WrappedPath(
        length=_length(way, points),
        moment_arm=-jnp.sum(jnp.where(pulls[None], rate, 0.0), axis=-1),
        on_surface=way.on_surface,
        margins=jax.tree.map(jnp.min, way.margins),
        clearances=jnp.concatenate([_outside(path, placed).ravel(), off_end, placed.radius * long_wrap]),
    )


def _outside(path: PointsAndCarriers, placed: Cylinder) -> Float[Array, "wrap point"]:
    """Distance of the path's points from each surface that they may wrap round (m)."""

    def of_wrap(cylinder: Cylinder) -> Float[Array, " point"]:
        seen = cylinder.inward(vector(path.position))
        return safe_sqrt(seen.x**2 + seen.y**2) - cylinder.radius

    place = jnp.arange(path.position.shape[0])[None]
    in_range = (place >= path.first_point[:, None]) & (place <= path.last_point[:, None])
    return jnp.where(in_range, jax.vmap(of_wrap)(placed), FREE)
