"""A path that may wrap round several cylinders, on one body or on several, in one pose.

Each cylinder is fitted into the path as the others leave it, in turns: as often as OpenSim does, or until
nothing changes.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from wrapjax.geometry.cylinder import Cylinder, settled_spiral_contact
from wrapjax.geometry.path_on_cylinders import (
    INSIDE,
    NO_WRAP,
    PathOnCylinders,
    PointsAndCarriers,
    fit_in,
    in_ground,
    length_of,
    owners_of,
    pieces_of,
    start_of,
)
from wrapjax.geometry.shortest_path import laid
from wrapjax.geometry.vectors import safe_inverse, safe_sqrt, vector
from wrapjax.geometry.wrapping import FREE, WrappedPath

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
