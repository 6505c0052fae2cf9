"""A path that may wrap round several cylinders, on one body or on several, in one pose.

Each cylinder is fitted into the path as the others leave it, in turns: as often as OpenSim does, or until
nothing changes.

The shortest path round several cylinders, with exact derivatives.

Each cylinder is fitted into the path as the others leave it, in turns, until nothing changes.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from wrapjax.geometry.cylinder import HALF_TURN, Cylinder, decide, geodesic_contact, settled_spiral_contact
from wrapjax.geometry.path_on_cylinders import (
    INSIDE,
    NO_WRAP,
    PathOnCylinders,
    PointsAndCarriers,
    as_rows,
    fit_in,
    in_ground,
    length_of,
    owners_of,
    pieces_of,
    start_of,
)
from wrapjax.geometry.vectors import safe_inverse, safe_sqrt, vector
from wrapjax.geometry.wrapping import FREE, WrappedPath

_SWEEPS = 20
_LEAPS = 30
# Contacts that move by less (m) touch what they will touch.
_NEARLY = 1e-3
_GEODESIC_TOLERANCE = 1e-13


class Held(NamedTuple):
    """The path on the cylinders that hold it: how long it is there, and how far from slipping off."""

    length: Float[Array, " wrap"]
    off_end: Float[Array, " wrap"]
    long_wrap: Float[Array, " wrap"]


def laid(path: PointsAndCarriers, cylinders: Cylinder) -> tuple[PathOnCylinders, Held]:
    """Lay the path the shortest way; it follows the points and the cylinders as these move."""
    points = path.position.shape[0]
    way = _settled(*jax.lax.stop_gradient((path, cylinders)))
    contacts = _with_derivatives(way.position[points:], way.knots, path, cylinders)
    contacts, held = _refitted(contacts, way.knots, path, in_ground(path, cylinders))
    position = jnp.concatenate([path.position, contacts])
    return way._replace(position=position, seen=position, on_surface=held.length), held


def _settled(path: PointsAndCarriers, cylinders: Cylinder) -> PathOnCylinders:
    """Find which cylinders the path touches, and in which order; then move the contacts until they stay."""
    placed = in_ground(path, cylinders)
    points, wraps = path.position.shape[0], cylinders.radius.shape[0]

    def sweep(state):
        way, _, count = state
        before = way

        def by_turns(turn, way):
            way, _ = fit_in(path, placed, turn, way, geodesic_contact)
            return way._replace(seen=way.position)

        way = jax.lax.fori_loop(0, wraps, by_turns, way)
        moved = jnp.max(jnp.abs(way.position - before.position))
        same = jnp.all(way.knots == before.knots)
        return way, same & (moved < _NEARLY), count + 1

    def unordered(state):
        return ~state[1] & (state[2] < _SWEEPS)

    start = (start_of(path, wraps), jnp.asarray(False), jnp.asarray(0))
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
        placed = in_ground(path, cylinders)
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
) -> tuple[Float[Array, "contact 3"], Held]:
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
        found = jnp.stack([as_rows(cylinder.outward(contact.first)), as_rows(cylinder.outward(contact.last))])
        kept = jax.lax.stop_gradient(position[rows])
        moved = position.at[rows].set(jnp.where(touched, found, kept))
        return moved, Held(
            length=jnp.where(touched, contact.length, 0.0),
            off_end=jnp.where(touched, contact.off_end, FREE),
            long_wrap=jnp.where(touched, HALF_TURN - contact.turn, FREE),
        )

    start = jnp.concatenate([path.position, contacts])
    position, held = jax.lax.scan(refit, start, (jnp.arange(placed.radius.shape[0]), placed))
    return position[points:], held


_OPENSIM_SWEEPS = 8
_OPENSIM_TOLERANCE = 0.0005


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
    placed = in_ground(path, cylinders)
    points, wraps = path.position.shape[0], cylinders.radius.shape[0]

    def sweep(state):
        way, looked_at, order, last_length, count, _ = state
        codes = []
        for turn in range(wraps):
            way, code = fit_in(path, placed, order[turn], way, settled_spiral_contact)
            codes.append(code)
            # A point that has been looked at in ground's frame is taken to stay there.
            seen = jnp.where(looked_at[:, None], way.seen, way.position)
            way = way._replace(seen=seen)
        looked_at = looked_at | jnp.any(way.knots[None] == jnp.arange(points + 2 * wraps)[:, None], axis=1)
        length = length_of(way, points)
        done = jnp.abs(length - last_length) < _OPENSIM_TOLERANCE
        swap = (count == 0) & ~done & (codes[0] == NO_WRAP) & (codes[1] == INSIDE)
        order = jnp.where(swap, order.at[:2].set(order[:2][::-1]), order)
        return way, looked_at, order, length, count + 1, done

    def unfinished(state):
        return ~state[5] & (state[4] < _OPENSIM_SWEEPS)

    nothing = jnp.zeros(points + 2 * wraps, dtype=bool)
    start = (
        *(start_of(path, wraps), nothing, jnp.arange(wraps)),
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
    way, held = laid(path, cylinders)
    return _outcome(way, path, in_ground(path, cylinders), held.off_end, held.long_wrap)


def shortest_way(path: PointsAndCarriers, cylinders: Cylinder) -> Way:
    """Say where the path of `wrap_shortest` runs, round any number of cylinders, in one pose."""
    way, _ = laid(path, cylinders)
    return Way(way.knots, way.position, way.on_surface, in_ground(path, cylinders))


def _outcome(
    way: PathOnCylinders,
    path: PointsAndCarriers,
    placed: Cylinder,
    off_end: Float[Array, " wrap"],
    long_wrap: Float[Array, " wrap"],
) -> WrappedPath:
    points, wraps = path.position.shape[0], placed.radius.size
    before, after, there, _ = pieces_of(way, points)
    body = owners_of(path, wraps).body
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
        length=length_of(way, points),
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
