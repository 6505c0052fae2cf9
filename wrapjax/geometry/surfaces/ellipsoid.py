"""Shortest path of one straight segment round one ellipsoid.

All coordinates are in the ellipsoid's frame. Scaled by the semi-axes, the ellipsoid is a unit sphere, and
planes, straight lines and tangency stay what they are. A plane through the segment cuts the sphere in a
circle, so that the path within the plane has a closed form up to its length, an integral over the arc. The
shortest of such paths in planes at all angles about the segment is the initial path of `find_curve`, which
leaves the plane. Paths on both sides of the ellipsoid are computed and the shorter one is taken.

A quadrant requires that the middle of the contact is on the active side. If the shortest path is not, the
path on the opposite side is taken, which need not be locally shortest; the margin that `Contact.turn` leaves
to half a turn is then negative. From an end inside there is no path: the end then counts as on the surface,
along which the path begins.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces.curve_length import Ends, Family, Jet
from wrapjax.geometry.surfaces.placed_surface import (
    HALF_TURN,
    Contact,
    Decision,
    PlacedSurface,
    over_segments,
)
from wrapjax.geometry.surfaces.sphere import intersects
from wrapjax.geometry.surfaces.surface_curve import Curve, Search, find_curve, pull_at
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, stack_components, vector

# Angles about the segment of the planes that are compared, and nodes of the quadrature of their paths.
_PLANES, _PLANE_NODES = 16, 12
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(_PLANE_NODES)
# The path on the opposite side is computed if its plane's path is longer by less than this share of the
# detour.
_CLOSE = 0.3
# Distance from the center, in units of the sphere's radius, to which a segment is moved that passes outside.
_HIGHEST = 0.9999
# Least share of a segment on either side of its point nearest to the center. In place of other segments,
# whose contact is not used, some segment is computed that has one.
_LEAST_SHARE = 1e-6
_ANYWHERE = np.array([[-2.0, 0.3, 0.1], [2.0, 0.4, -0.2]])


class Plane(NamedTuple):
    """A plane through a segment, in the coordinates in which the ellipsoid is a unit sphere.

    Angles are about ``normal``, from the direction against the segment towards ``aside``.
    """

    #: Unit vectors: against the segment, towards the path's side, and normal to the plane.
    backward: Float[Array, " 3"]
    aside: Float[Array, " 3"]
    normal: Float[Array, " 3"]
    #: Distance of the plane from the origin along its normal.
    height: Float[Array, ""]
    #: Angles of the points of contact (rad).
    first: Float[Array, ""]
    last: Float[Array, ""]

    def points(self, angle: Float[Array, "*angle"]) -> Float[Array, "*angle 3"]:
        """Compute points of the circle at angles (rad)."""
        radius = safe_sqrt(1.0 - self.height**2)
        around = jnp.multiply.outer(jnp.cos(angle), self.backward) + jnp.multiply.outer(
            jnp.sin(angle), self.aside
        )
        center = jnp.broadcast_to(self.height * self.normal, around.shape)
        return center + radius * around


def decide_wrapping(start: Vector, end: Vector, ellipsoid: PlacedSurface) -> Decision:
    """Decide whether straight segments wrap: those that intersect the ellipsoid do.

    Parameters
    ----------
    start, end
        Ends of the segments in the ellipsoid's frame (m).
    ellipsoid
        The ellipsoid, of which only the semi-axes are used.
    """
    scaled_start, scaled_end = scaled(start, ellipsoid), scaled(end, ellipsoid)
    crossing = intersects(scaled_start, scaled_end, jnp.asarray(1.0))
    start_clearance, end_clearance = clearance(start, ellipsoid), clearance(end, ellipsoid)
    return Decision(
        inside=(start_clearance < 0.0) | (end_clearance < 0.0),
        mandatory=crossing,
        possible=jnp.zeros_like(crossing),
        start_clearance=start_clearance,
        end_clearance=end_clearance,
        increase=jnp.zeros_like(end_clearance),
    )


def scaled(point: Vector, ellipsoid: PlacedSurface) -> Vector:
    """Divide by the semi-axes."""
    sizes = ellipsoid.sizes
    assert sizes is not None
    return Vector(point.x / sizes.x, point.y / sizes.y, point.z / sizes.z)


def clearance(point: Vector, ellipsoid: PlacedSurface) -> Float[Array, "*segment"]:
    """Distance of points from the surface along the line to the center (m), negative inside."""
    relative = scaled(point, ellipsoid).norm()
    return point.norm() * (1.0 - safe_inverse(relative))


def outside(point: Vector, ellipsoid: PlacedSurface) -> Vector:
    """Move points inside the ellipsoid to its surface, along the line from the center."""
    return point * _factor_onto_sphere(scaled(point, ellipsoid).norm())


def geodesic_contact(start: Vector, end: Vector, ellipsoid: PlacedSurface, decision: Decision) -> Contact:
    """Compute the contact of the shortest path round the ellipsoid.

    Parameters
    ----------
    start, end
        Ends of the segments in the ellipsoid's frame (m).
    ellipsoid
        The ellipsoid.
    decision
        Result of `decide_wrapping`.

    Notes
    -----
    Where a segment does not intersect the ellipsoid, the contact is a single point near the segment.
    """
    sizes = ellipsoid.sizes
    assert sizes is not None

    axes = stack_components(sizes)

    def one(start: Array, end: Array) -> tuple[Curve, Bool[Array, ""], Array, Array]:
        curve, on_side = _shortest(start, end, axes, ellipsoid)

        def to_surface(point: Array) -> Array:
            return _outside(point / axes) * axes

        pulls = (
            pull_at(start, curve.first, curve.first_direction, to_surface),
            -pull_at(end, curve.last, -curve.last_direction, to_surface),
        )
        return curve, on_side, *pulls

    curve, on_side, start_pull, end_pull = over_segments(one, start)(
        stack_components(start), stack_components(end)
    )
    locally_shortest = curve.minimal & on_side
    return Contact(
        first=vector(curve.first),
        last=vector(curve.last),
        length=curve.on_surface,
        total=curve.total,
        start_pull=vector(start_pull),
        end_pull=vector(end_pull),
        valid=jnp.ones_like(decision.inside),
        turn=jnp.where(locally_shortest, 0.5 * HALF_TURN, 1.5 * HALF_TURN),
        off_end=jnp.ones_like(curve.total),
    )


def _shortest(
    start: Float[Array, " 3"], end: Float[Array, " 3"], sizes: Float[Array, " 3"], ellipsoid: PlacedSurface
) -> tuple[Curve, Bool[Array, ""]]:
    """Shortest path of one segment, and whether it passes on the active side."""
    start, end = _crossing_segment(start / sizes, end / sizes)
    ends = jax.lax.stop_gradient((start, end))
    fixed_sizes = jax.lax.stop_gradient(sizes)
    angles = jnp.arange(_PLANES) * (2.0 * jnp.pi / _PLANES)
    lengths = jax.vmap(lambda angle: planar_length(plane_through(*ends, angle), *ends, fixed_sizes))(angles)
    best = jnp.argmin(lengths)
    # Vertex of the parabola through the best plane and its neighbors.
    before, at, after = (lengths[(best + step) % _PLANES] for step in (-1, 0, 1))
    bend = before - 2.0 * at + after
    shift = (before - after) * safe_inverse(jnp.maximum(bend, 0.0))
    angle = angles[best] + (jnp.pi / _PLANES) * jnp.clip(shift, -1.0, 1.0)

    # The planes of the shortest path and of the one on the opposite side, in one batch.
    planes = jax.vmap(lambda angle: plane_through(*ends, angle))(jnp.stack([angle, angle + jnp.pi]))
    shortest, opposite = jax.vmap(lambda plane: planar_length(plane, *ends, fixed_sizes))(planes)

    def along(plane: Plane, search: Search) -> Curve:
        frame = jnp.stack([plane.backward, plane.aside, plane.normal], axis=1)
        contacts = plane.points(jnp.stack([plane.first, plane.last]))
        choices = ((plane.aside, plane.first), (plane.aside, plane.last))
        initial = jax.vmap(lambda point, contact: _horizon_angle(point, plane.aside, contact))(
            jnp.stack(ends), contacts
        )
        given = Ends(start * sizes, end * sizes, (sizes, frame), *choices)
        return find_curve(_FAMILY, given, initial, search)

    restricted = ellipsoid.side != 0
    middle = jax.tree.map(lambda leaf: leaf[0], planes)
    apex = middle.points(0.5 * (middle.first + middle.last))
    excluded = restricted & ~ellipsoid.on_side(vector(apex))
    # The path on the opposite side cannot be shorter if its plane's path is longer by much.
    detour = shortest - _norm((ends[1] - ends[0]) * fixed_sizes)
    close = opposite - shortest < _CLOSE * detour
    search = Search(
        shortest=jnp.stack([jnp.asarray(True), ~excluded]),
        needed=jnp.stack([jnp.asarray(True), close | excluded]),
    )
    both = jax.vmap(along)(planes, search)
    on_side = ellipsoid.on_side(vector(both.middle)) | ~restricted
    # The path on the active side or, if that is none or both, the shorter one.
    length = jnp.where(search.needed & (on_side | ~jnp.any(on_side & search.needed)), both.total, jnp.inf)
    taken = jnp.argmin(length)
    return jax.tree.map(lambda leaf: leaf[taken], both), on_side[taken]


def _outside(point: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Move a point inside the unit sphere to the sphere."""
    return point * _factor_onto_sphere(safe_sqrt(jnp.sum(point**2)))


def _factor_onto_sphere(distance: Float[Array, "*point"]) -> Float[Array, "*point"]:
    """Factor that moves points inside the unit sphere to the sphere, from their distances to its center."""
    return jnp.where(distance < 1.0, safe_inverse(distance), 1.0)


def _crossing_segment(
    start: Float[Array, " 3"], end: Float[Array, " 3"]
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Return ends of a segment that intersects the unit sphere, from ends that may be inside or beside it."""
    start, end = _outside(start), _outside(end)
    way = end - start
    square = jnp.sum(way**2)
    along = -jnp.sum(start * way) * safe_inverse(square)
    nearest = start + along * way
    height = safe_sqrt(jnp.sum(nearest**2))
    shift = nearest * jnp.where(height > _HIGHEST, _HIGHEST * safe_inverse(height) - 1.0, 0.0)
    between = (along > _LEAST_SHARE) & (along < 1.0 - _LEAST_SHARE) & (square > _LEAST_SHARE**2)
    return (
        jnp.where(between, start + shift, jnp.asarray(_ANYWHERE[0])),
        jnp.where(between, end + shift, jnp.asarray(_ANYWHERE[1])),
    )


def plane_through(start: Float[Array, " 3"], end: Float[Array, " 3"], angle: Float[Array, ""]) -> Plane:
    """Plane through a segment at an angle (rad) about it, where the ellipsoid is a unit sphere."""
    way = end - start
    backward = -way * safe_inverse(safe_sqrt(jnp.sum(way**2)))
    # The coordinate axis that is most nearly normal to the segment.
    axis = jnp.eye(3)[jnp.argmin(jnp.abs(backward))]
    one = axis - backward * jnp.sum(axis * backward)
    one = one * safe_inverse(safe_sqrt(jnp.sum(one**2)))
    aside = jnp.cos(angle) * one + jnp.sin(angle) * jnp.cross(backward, one)
    return plane_towards(start, end, backward, aside)


def plane_towards(
    start: Float[Array, " 3"],
    end: Float[Array, " 3"],
    backward: Float[Array, " 3"],
    aside: Float[Array, " 3"],
) -> Plane:
    """Plane through a segment from its direction and the direction of the path's side (unit vectors)."""
    normal = jnp.cross(backward, aside)
    height = jnp.sum(normal * start)
    radius = safe_sqrt(1.0 - height**2)

    def tangent_angle(end: Float[Array, " 3"], before: float) -> Float[Array, ""]:
        x, y = jnp.sum(backward * end), jnp.sum(aside * end)
        distance = safe_sqrt(x**2 + y**2)
        return jnp.arctan2(y, x) + before * jnp.arctan2(safe_sqrt(distance**2 - radius**2), radius)

    first, last = tangent_angle(start, 1.0), tangent_angle(end, -1.0)
    last = last + jnp.where(last < first, 2.0 * jnp.pi, 0.0)
    return Plane(backward, aside, normal, height, first, last)


def planar_length(
    plane: Plane, start: Float[Array, " 3"], end: Float[Array, " 3"], sizes: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Length (m) of the path within a plane, from the ends in scaled coordinates."""
    half, middle = 0.5 * (plane.last - plane.first), 0.5 * (plane.last + plane.first)
    angle = middle + half * jnp.asarray(_NODES)
    radius = safe_sqrt(1.0 - plane.height**2)
    along = jnp.outer(jnp.cos(angle), plane.aside) - jnp.outer(jnp.sin(angle), plane.backward)
    arc = half * radius * jnp.sum(jnp.asarray(_WEIGHTS) * _norm(along * sizes[None]))
    points = plane.points(jnp.stack([plane.first, plane.last]))
    return _norm((points[0] - start) * sizes) + arc + _norm((points[1] - end) * sizes)


def _norm(vectors: Float[Array, "*vectors 3"]) -> Float[Array, "*vectors"]:
    return safe_sqrt(jnp.sum(vectors**2, axis=-1))


def _matrix(surface: tuple[Float[Array, " 3"], Float[Array, "3 3"]]) -> Float[Array, "3 3"]:
    sizes, frame = surface
    return sizes[:, None] * frame


def _factors(
    surface: tuple[Float[Array, " 3"], Float[Array, "3 3"]],
    angle: Float[Array, "*node"],
    level: Float[Array, "*node"],
) -> tuple[tuple[Jet, Jet, Jet], tuple[Jet, Jet, Jet]]:
    """Chart of the unit sphere: ``(cos angle, sin angle, level) / sqrt(1 + level^2)``.

    The level is the slope over a plane through the center, and is constant in a plane.
    """
    sine, cosine, ones, zeros = jnp.sin(angle), jnp.cos(angle), jnp.ones_like(angle), jnp.zeros_like(angle)
    scale = 1.0 / jnp.sqrt(1.0 + level**2)
    cube = scale**3
    fifth = cube * scale**2
    shrunk = (
        scale,
        -level * cube,
        (2.0 * level**2 - 1.0) * fifth,
        3.0 * level * (3.0 - 2.0 * level**2) * fifth * scale**2,
    )
    raised = (
        level * scale,
        cube,
        -3.0 * level * fifth,
        3.0 * (4.0 * level**2 - 1.0) * fifth * scale**2,
    )
    return (
        ((cosine, -sine, -cosine, sine), (sine, cosine, -sine, -cosine), (ones, zeros, zeros, zeros)),
        (shrunk, shrunk, raised),
    )


def _horizon(
    point: Float[Array, " 3"], reference: Float[Array, " 3"]
) -> tuple[Float[Array, " 3"], Float[Array, " 3"], Float[Array, " 3"]]:
    """Compute the circle on which lines from a point are tangent to the unit sphere.

    Returned are its center and its radii at 0 and 90 degrees, counted from the direction ``reference``.
    """
    square = jnp.sum(point**2)
    center = point * safe_inverse(square)
    toward = point * safe_inverse(safe_sqrt(square))
    across = reference - toward * jnp.sum(toward * reference)
    across = across * safe_inverse(_norm(across)) * safe_sqrt(1.0 - safe_inverse(square))
    return center, across, jnp.cross(toward, across)


def _horizon_angle(
    point: Float[Array, " 3"], reference: Float[Array, " 3"], contact: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Angle on the circle of `_horizon` (rad) of one of its points."""
    center, across, up = _horizon(point, reference)
    return jnp.arctan2(jnp.sum((contact - center) * up), jnp.sum((contact - center) * across))


def _tangent(
    surface: tuple[Float[Array, " 3"], Float[Array, "3 3"]],
    point: Float[Array, " 3"],
    choice: tuple[Float[Array, " 3"], Float[Array, ""]],
    variable: Float[Array, ""],
) -> Float[Array, " 2"]:
    """Coordinates of a tangent point by its angle on the circle of `_horizon`."""
    sizes, frame = surface
    reference, usual = choice
    center, across, up = _horizon(point / sizes, reference)
    x, y, z = frame.T @ (center + jnp.cos(variable) * across + jnp.sin(variable) * up)
    sine, cosine = jnp.sin(usual), jnp.cos(usual)
    angle = usual + jnp.arctan2(y * cosine - x * sine, x * cosine + y * sine)
    return jnp.stack([angle, z / jnp.sqrt(x**2 + y**2)])


_FAMILY = Family(_matrix, _factors, _tangent)
