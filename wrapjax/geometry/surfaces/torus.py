"""Shortest path of one straight segment through the hole of one torus.

All coordinates are in the torus' frame, whose z axis is normal to the ring's plane. As in OpenSim, a path
passes through the hole. A segment with its ends on both sides of the ring's plane therefore wraps if it
crosses that plane outside the ring or intersects the tube. A segment with both ends on one side wraps if it
intersects the tube. Its contact is that of `find_curve`: the tube's angle is the curve's first coordinate,
and the ring's angle the second one.

A straight line of a path must not pass through the tube elsewhere, which it could where the hole is narrow.

From an end inside the tube there is no path: the end then counts as on the surface, along which the path
begins.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.surfaces import cylinder
from wrapjax.geometry.surfaces.curve_length import Ends, Family, Jet
from wrapjax.geometry.surfaces.placed_surface import (
    HALF_TURN,
    Contact,
    Decision,
    PlacedSurface,
    over_segments,
)
from wrapjax.geometry.surfaces.surface_curve import Curve, Search, find_curve, slope_by_given
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, stack_components, vector, where

# Points of a segment, or of the ring, among which the nearest is searched, and halvings of the interval
# about it.
_TRIALS, _HALVINGS = 32, 40
# Angles of the ring at either end of a curve of which the best pair is where the search starts.
_PAIRED = 32
# Pairs of angles from which a path is searched.
_STARTS = 5
# Distance of their middles, in radii of the tube, up to which two curves are one.
_SAME_WAY = 1e-3
# Depth (m) up to which a line touches the tube and does not pass through it.
_TOUCHING = 1e-7
# Distance (m) up to which a point outside the tube is on its surface.
_ON_SURFACE = 1e-10
# Length of OpenSim's cylinder (m).
_LENGTH = 10_000.0


class TorusDecision(Decision):
    """Whether straight path segments wrap round a torus, and where."""

    #: Angle of the ring (rad) near which the path touches the tube.
    ring_angle: Float[Array, "*segment"]
    #: Direction of the path about the tube: 1 if its z coordinate decreases on the inner side.
    direction: Float[Array, "*segment"]


class Touch(NamedTuple):
    """Constants that choose the point at which a curve begins or ends."""

    #: Direction about the tube from the point where the line would meet the tube's axis to where it touches.
    direction: Float[Array, ""]
    #: Whether the path's end is on the surface itself.
    on_surface: Bool[Array, ""]


def decide_wrapping(start: Vector, end: Vector, torus: PlacedSurface) -> TorusDecision:
    """Decide whether straight segments wrap.

    Parameters
    ----------
    start, end
        Ends of the segments in the torus' frame (m).
    torus
        The torus. With a side, only contacts with that half of the ring count.
    """
    sizes = torus.sizes
    assert sizes is not None
    ring, tube = sizes.x, sizes.y
    decide = over_segments(lambda start, end: _decided(start, end, ring, tube), start)
    crosses, hits, nearest, ring_angle, direction, increase = decide(
        stack_components(start), stack_components(end)
    )
    straight = tangent_cylinder(vector(nearest), torus)
    rule = cylinder.decide_wrapping(
        straight.to_surface_frame(start), straight.to_surface_frame(end), straight
    )
    place = Vector(jnp.cos(ring_angle), jnp.sin(ring_angle), jnp.zeros_like(ring_angle))
    active = (torus.side == 0) | torus.on_side(place)
    start_clearance, end_clearance = clearance(start, torus), clearance(end, torus)
    return TorusDecision(
        inside=(start_clearance < 0.0) | (end_clearance < 0.0),
        mandatory=jnp.zeros_like(hits),
        possible=((crosses & (rule.mandatory | rule.possible)) | hits) & active,
        start_clearance=start_clearance,
        end_clearance=end_clearance,
        increase=increase,
        ring_angle=ring_angle,
        direction=direction,
    )


def tangent_cylinder(near: Vector, torus: PlacedSurface) -> PlacedSurface:
    """Return the cylinder that replaces a torus in OpenSim, in the torus' frame.

    It has the tube's radius and touches the ring at its point nearest to ``near``. Its x axis points to the
    ring's center, and paths pass on that side.
    """
    sizes = torus.sizes
    assert sizes is not None
    zeros, ones = jnp.zeros_like(near.x), jnp.ones_like(near.x)
    outward = Vector(near.x, near.y, zeros).unit()
    x_axis, y_axis = outward * -1.0, Vector(zeros, zeros, -ones)
    return PlacedSurface(
        x_axis=x_axis,
        y_axis=y_axis,
        z_axis=x_axis.cross(y_axis),
        center=outward * sizes.x,
        radius=sizes.y * ones,
        half_length=0.5 * _LENGTH * ones,
        side_axis=jnp.zeros_like(near.x, dtype=int),
        side=jnp.ones_like(near.x, dtype=int),
    )


def clearance(point: Vector, torus: PlacedSurface) -> Float[Array, "*segment"]:
    """Distance of points from the surface (m), negative inside the tube."""
    sizes = torus.sizes
    assert sizes is not None
    aside = safe_sqrt(point.x**2 + point.y**2) - sizes.x
    return safe_sqrt(aside**2 + point.z**2) - sizes.y


def outside(point: Vector, torus: PlacedSurface) -> Vector:
    """Move points inside the tube to its surface, away from the ring's circle."""
    sizes = torus.sizes
    assert sizes is not None
    return _moved(point, sizes)


def geodesic_contact(start: Vector, end: Vector, torus: PlacedSurface, decision: TorusDecision) -> Contact:
    """Compute the contact of the shortest path through the hole.

    Parameters
    ----------
    start, end
        Ends of the segments in the torus' frame (m).
    torus
        The torus.
    decision
        Result of `decide_wrapping`.
    """
    sizes = torus.sizes
    assert sizes is not None

    def one(
        start: Float[Array, " 3"],
        end: Float[Array, " 3"],
        ring_angle: Float[Array, ""],
        direction: Float[Array, ""],
        wraps: Array,
    ) -> tuple[Curve, Array, Array, Array]:
        given = (start, end)
        on_surface = [_inside(point, sizes) & wraps for point in given]
        surface = jnp.stack([sizes.x, sizes.y])
        # In place of segments that do not wrap, whose contact is not used, some segment that does is
        # computed.
        start = jnp.where(wraps, _outside(start, sizes), jnp.stack([0.3 * sizes.x, sizes.y, 3.0 * sizes.y]))
        end = jnp.where(wraps, _outside(end, sizes), jnp.stack([2.0 * sizes.x, -sizes.y, -3.0 * sizes.y]))
        direction = jnp.where(wraps, direction, 1.0)
        place = jnp.where(wraps, ring_angle, 0.0)
        always = jnp.asarray(True)
        at_start, at_end = Touch(direction, on_surface[0]), Touch(-direction, on_surface[1])
        ends = Ends(start, end, surface, at_start, at_end)
        starts = _initial(jax.lax.stop_gradient(ends), place)
        found = jax.vmap(lambda one: find_curve(_FAMILY, ends, one, Search(always, always)))(starts)
        clear = jax.vmap(lambda first, last: _clear(start, first, sizes) & _clear(end, last, sizes))
        outside = clear(*jax.lax.stop_gradient((found.first, found.last)))
        found = found._replace(minimal=found.minimal & outside)
        shortest = jnp.argmin(jnp.where(found.minimal, found.total, jnp.inf))
        taken: Curve = jax.tree.map(lambda leaf: leaf[shortest], found)
        other = found.minimal & (_norm(found.middle - taken.middle[None]) > _SAME_WAY * sizes.y)
        ahead = jnp.min(jnp.where(other, found.total - taken.total, HALF_TURN * sizes.y))

        def to_surface(point: Array) -> Array:
            return _outside(point, sizes)

        return (
            taken,
            jnp.where(taken.minimal, jnp.minimum(ahead / sizes.y, 0.5 * HALF_TURN), -0.5 * HALF_TURN),
            -slope_by_given(given[0], taken.start_slope, to_surface),
            slope_by_given(given[1], taken.end_slope, to_surface),
        )

    curve, margin, start_pull, end_pull = over_segments(one, start)(
        stack_components(start),
        stack_components(end),
        jax.lax.stop_gradient(decision.ring_angle),
        decision.direction,
        decision.possible,
    )
    return Contact(
        first=vector(curve.first),
        last=vector(curve.last),
        length=curve.on_surface,
        total=curve.total,
        start_pull=vector(start_pull),
        end_pull=vector(end_pull),
        valid=jnp.ones_like(decision.inside),
        turn=HALF_TURN - margin,
        off_end=jnp.ones_like(curve.total),
    )


def _decided(
    start: Float[Array, " 3"], end: Float[Array, " 3"], ring: Float[Array, ""], tube: Float[Array, ""]
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Decide whether one segment crosses the plane outside the ring or hits the tube, and where it wraps."""
    start, end, ring, tube = jax.lax.stop_gradient((start, end, ring, tube))
    sizes = Vector(ring, tube, tube)
    moved = _inside(start, sizes) | _inside(end, sizes)
    start, end = _outside(start, sizes), _outside(end, sizes)
    opposite = (start[2] > 0.0) != (end[2] > 0.0)
    share = start[2] * safe_inverse(start[2] - end[2])
    crossing = start + share * (end - start)
    crosses = opposite & (crossing[0] ** 2 + crossing[1] ** 2 >= ring**2)
    nearest = start + _nearest_share(start, end, ring) * (end - start)
    aside = safe_sqrt(nearest[0] ** 2 + nearest[1] ** 2) - ring
    # A line from the surface may leave it at once.
    hits = safe_sqrt(aside**2 + nearest[2] ** 2) < tube - jnp.where(moved, _TOUCHING, 0.0)
    # The shortest way through the hole by a point of the tube's inner edge.
    angles = jnp.arange(_TRIALS) * (2.0 * jnp.pi / _TRIALS)
    inner = (ring - tube) * jnp.stack([jnp.cos(angles), jnp.sin(angles), jnp.zeros(_TRIALS)], axis=1)
    ways = _norm(inner - start[None]) + _norm(inner - end[None])
    best = jnp.argmin(ways)
    before, at, after = (ways[(best + step) % _TRIALS] for step in (-1, 0, 1))
    shift = (before - after) * safe_inverse(jnp.maximum(before - 2.0 * at + after, 0.0))
    through = angles[best] + (jnp.pi / _TRIALS) * jnp.clip(shift, -1.0, 1.0)
    beside = jnp.arctan2(nearest[1], nearest[0])
    ring_angle = jnp.where(opposite, through, beside)

    def angle_about_tube(point: Float[Array, " 3"]) -> Float[Array, ""]:
        outward = point[0] * jnp.cos(ring_angle) + point[1] * jnp.sin(ring_angle) - ring
        return jnp.arctan2(-point[2], -outward)

    over = jnp.where(angle_about_tube(end) > angle_about_tube(start), 1.0, -1.0)
    direction = jnp.where(opposite, jnp.where(start[2] > 0.0, 1.0, -1.0), over)
    increase = jnp.where(opposite, at - _norm(end - start), 0.0)
    return crosses, hits, nearest, ring_angle, direction, increase


def _initial(ends: Ends, place: Float[Array, ""]) -> Float[Array, "start 2"]:
    """Choose the ring's angles at both ends of curves from which the shortest one is searched.

    A path through the hole may touch near one of its ends' ring angles and leave near the other's, and
    several paths may be shorter than all their neighbors. Of all pairs of some angles those are taken whose
    path is shorter than that of neighboring pairs, the shortest of them, with a curve that is straight in the
    chart and its length from its middle. The others, and a path that stays on one side of the ring's plane,
    start at a given place.
    """
    ring, tube = ends.surface
    trials = jnp.arange(_PAIRED) * (2.0 * jnp.pi / _PAIRED)

    def tangents(point: Float[Array, " 3"], at: Touch) -> tuple[Array, Array, Array]:
        """Tangent points at all angles: both of their angles, and the lines' lengths."""
        about_tube, about_ring = jax.vmap(lambda angle: _tangent(ends.surface, point, at, angle))(trials).T
        outward = ring - tube * jnp.cos(about_tube)
        touch = [outward * jnp.cos(about_ring), outward * jnp.sin(about_ring), -tube * jnp.sin(about_tube)]
        return about_tube, about_ring, _norm(jnp.stack(touch, axis=1) - point[None])

    first, first_place, before = tangents(ends.start, ends.at_start)
    last, last_place, after = tangents(ends.end, ends.at_end)
    turned = ends.at_start.direction * (last[None] - first[:, None])
    aside = (last_place[None] - first_place[:, None] + jnp.pi) % (2.0 * jnp.pi) - jnp.pi
    middle = 0.5 * (first[:, None] + last[None])
    on_surface = jnp.sqrt((tube * turned) ** 2 + ((ring - tube * jnp.cos(middle)) * aside) ** 2)
    length = before[:, None] + on_surface + after[None]
    # Where lines would cross, no path touches the tube.
    length = jnp.where(turned > 0.0, length, jnp.inf)
    around = [
        jnp.roll(length, (one, other), (0, 1)) for one in (-1, 0, 1) for other in (-1, 0, 1) if one or other
    ]
    minimal = jnp.isfinite(length) & (length <= jnp.min(jnp.stack(around), axis=0))
    # An end on the surface is the same point at all angles.
    once = jnp.arange(_PAIRED) == 0
    minimal &= (once | ~ends.at_start.on_surface)[:, None] & (once | ~ends.at_end.on_surface)[None]
    shortest, best = jax.lax.top_k(-jnp.where(minimal, length, jnp.inf).ravel(), _STARTS)
    known = jnp.isfinite(shortest)
    one, other = best // _PAIRED, best % _PAIRED
    through = jnp.stack([first_place[one], first_place[one] + aside[one, other]], axis=1)
    opposite = (ends.start[2] > 0.0) != (ends.end[2] > 0.0)
    return jnp.where(opposite & known[:, None], through, place)


def _clear(point: Float[Array, " 3"], touch: Float[Array, " 3"], sizes: Vector) -> Bool[Array, ""]:
    """Whether the straight line from a point to one where it touches the tube is nowhere inside the tube."""
    point, touch, ring, tube = jax.lax.stop_gradient((point, touch, sizes.x, sizes.y))
    nearest = point + _nearest_share(point, touch, ring) * (touch - point)
    aside = safe_sqrt(nearest[0] ** 2 + nearest[1] ** 2) - ring
    return safe_sqrt(aside**2 + nearest[2] ** 2) > tube - _TOUCHING


def _nearest_share(
    start: Float[Array, " 3"], end: Float[Array, " 3"], ring: Float[Array, ""]
) -> Float[Array, ""]:
    """Share of a segment at its point that is nearest to the ring's circle."""
    way = end - start

    def square(share: Float[Array, "*trial"]) -> Float[Array, "*trial"]:
        point = jnp.multiply.outer(jnp.asarray(share), way)
        point = point + jnp.broadcast_to(start, point.shape)
        aside = safe_sqrt(point[..., 0] ** 2 + point[..., 1] ** 2) - ring
        return aside**2 + point[..., 2] ** 2

    trials = jnp.arange(_TRIALS + 1) / _TRIALS
    best = trials[jnp.argmin(square(trials))]
    slope = jax.grad(lambda share: square(share))

    def halve(_: Int[Array, ""], interval: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = interval
        middle = 0.5 * (low + high)
        rising = slope(middle) > 0.0
        return jnp.where(rising, low, middle), jnp.where(rising, middle, high)

    around = (jnp.maximum(best - 1.0 / _TRIALS, 0.0), jnp.minimum(best + 1.0 / _TRIALS, 1.0))
    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, around)
    return 0.5 * (low + high)


def _inside(point: Float[Array, " 3"], sizes: Vector) -> Bool[Array, ""]:
    """Whether a point is inside the tube or on its surface."""
    aside = safe_sqrt(point[0] ** 2 + point[1] ** 2) - sizes.x
    return aside**2 + point[2] ** 2 <= (sizes.y + _ON_SURFACE) ** 2


def _moved(point: Vector, sizes: Vector) -> Vector:
    """Move points inside the tube to its surface."""
    onto_ring = sizes.x * safe_inverse(safe_sqrt(point.x**2 + point.y**2))
    middle = Vector(point.x * onto_ring, point.y * onto_ring, jnp.zeros_like(point.z))
    away = point - middle
    apart = away.norm()
    return where(apart < sizes.y, middle + away * (sizes.y * safe_inverse(apart)), point)


def _outside(point: Float[Array, " 3"], sizes: Vector) -> Float[Array, " 3"]:
    return stack_components(_moved(vector(point), sizes))


def _norm(vectors: Float[Array, "*vectors 3"]) -> Float[Array, "*vectors"]:
    return safe_sqrt(jnp.sum(vectors**2, axis=-1))


def _matrix(_: Float[Array, " 2"]) -> Float[Array, "3 3"]:
    return jnp.eye(3)


def _factors(
    surface: Float[Array, " 2"], about_tube: Float[Array, "*node"], ring_angle: Float[Array, "*node"]
) -> tuple[tuple[Jet, Jet, Jet], tuple[Jet, Jet, Jet]]:
    """Chart by the angles about the tube, zero at its inner edge, and about the ring."""
    ring, tube = surface
    sine, cosine = tube * jnp.sin(about_tube), tube * jnp.cos(about_tube)
    outward = (ring - cosine, sine, cosine, -sine)
    upward = (-sine, -cosine, sine, cosine)
    ring_sine, ring_cosine = jnp.sin(ring_angle), jnp.cos(ring_angle)
    ones, zeros = jnp.ones_like(ring_angle), jnp.zeros_like(ring_angle)
    return (
        (outward, outward, upward),
        (
            (ring_cosine, -ring_sine, -ring_cosine, ring_sine),
            (ring_sine, ring_cosine, -ring_sine, -ring_cosine),
            (ones, zeros, zeros, zeros),
        ),
    )


def _tangent(
    surface: Float[Array, " 2"],
    point: Float[Array, " 3"],
    at: Touch,
    variable: Float[Array, ""],
) -> Float[Array, " 2"]:
    """Angles of the point where a line is tangent to the tube's cross section at a ring angle.

    From a point on the surface the path begins there, whatever the ring angle.
    """
    ring, tube = surface
    # Elsewhere not used, and without a derivative on the torus' axis.
    own = jnp.arctan2(jnp.where(at.on_surface, point[1], 0.0), jnp.where(at.on_surface, point[0], 1.0))
    own = own + 2.0 * jnp.pi * jax.lax.stop_gradient(jnp.round((variable - own) / (2.0 * jnp.pi)))
    place = jnp.where(at.on_surface, own, variable)
    outward = point[0] * jnp.cos(place) + point[1] * jnp.sin(place) - ring
    toward = jnp.arctan2(-point[2], -outward)
    apart = jnp.arctan2(safe_sqrt(outward**2 + point[2] ** 2 - tube**2), tube)
    return jnp.stack([toward + jnp.where(at.on_surface, 0.0, at.direction * apart), place])


_FAMILY = Family(_matrix, _factors, _tangent)
