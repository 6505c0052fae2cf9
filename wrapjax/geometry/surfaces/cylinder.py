"""Wrapping of one straight path segment round one cylinder: decision, direction and points of contact.

All coordinates are in the cylinder's frame, whose z axis is the cylinder's axis. The points of contact are
computed in one of two ways:

- `spiral_contact` reproduces ``WrapCylinder`` of OpenSim 4.6 to round-off. OpenSim slides the tangent points
  along the cylinder by an approximation, so that the path is close to the shortest path, but longer.
- `geodesic_contact` gives the shortest path, which is a straight line on the unrolled cylinder.

`decide_wrapping` is common to both.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces.placed_surface import Contact, Decision, PlacedSurface
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, where

# Negative wrap angles down to this size (rad) count as tangential contact, not as almost a full turn.
_GRAZING = 0.1
# Constants of OpenSim's iteration: largest kink (rad), length of a spiral's piece (m), most iterations.
_TANGENCY = jnp.deg2rad(0.1)
_STEP = 0.002
_MAX_SLIDES = 100


class CylinderDecision(Decision):
    """Whether straight path segments wrap round a cylinder, and on which side."""

    #: Tangent points at the heights of the two ends.
    first: Vector
    last: Vector
    #: Direction from ``first`` to ``last`` about z.
    counterclockwise: Bool[Array, "*segment"]
    #: The wrap angle exceeds half a turn.
    long_way: Bool[Array, "*segment"]


def decide_wrapping(start: Vector, end: Vector, cylinder: PlacedSurface) -> CylinderDecision:
    """Decide as OpenSim's ``WrapCylinder`` does whether straight segments wrap, and on which side.

    Parameters
    ----------
    start, end
        Ends of the segments in the cylinder's frame (m).
    cylinder
        The cylinder, of which only the radius and the side are used.
    """
    radius = cylinder.radius
    first_distance, first_left, first_right = _tangent_points(start, radius)
    last_distance, last_left, last_right = _tangent_points(end, radius)
    nearest, along = _nearest_to_axis(start, end)
    crossing = (nearest.x**2 + nearest.y**2 < radius**2) & (along > 0.0) & (along < 1.0)

    restricted = cylinder.side != 0

    on_side = cylinder.on_side
    start_on, end_on = on_side(start), on_side(end)
    passing = jnp.where(start_on | end_on, (start_on != end_on) & ~on_side(nearest), True)
    left_way, right_way = _flat_dot(first_left, last_right), _flat_dot(first_right, last_left)
    left_longer = left_way < right_way
    # Left is counterclockwise: from the first point's left tangent to the last one's right tangent.
    left, right = on_side(first_left), on_side(first_right)
    end_decides = jnp.where(
        left, ~on_side(last_left), ~on_side(last_left) & (on_side(last_right) | left_longer)
    )
    leftward = jnp.where(left == right, end_decides, left)

    # Unrestricted cylinders: the pair of tangent points that are closest to each other.
    same_left, same_right = _flat_dot(first_left, last_left), _flat_dot(first_right, last_right)
    both_left = (same_left > left_way) & (same_left > right_way) & (same_left > same_right)
    left_right = ~both_left & (left_way > right_way) & (left_way > same_right)
    right_left = ~both_left & ~left_right & (right_way > same_right)
    first = where(jnp.where(restricted, leftward, both_left | left_right), first_left, first_right)
    last = where(jnp.where(restricted, ~leftward, both_left | right_left), last_left, last_right)
    # Compare the directions from the ends to their tangent points with those from the axis to the tangent
    # points.
    outward = _flat_dot(first + last, (first - start) + (last - end))
    return CylinderDecision(
        inside=(first_distance < radius) | (last_distance < radius),
        mandatory=crossing & (~restricted | start_on | end_on),
        possible=restricted & ~(crossing & (start_on | end_on)) & passing,
        first=first,
        last=last,
        counterclockwise=jnp.where(restricted, leftward, ~left_longer),
        long_way=restricted & (outward < 0.0),
        start_clearance=first_distance - radius,
        end_clearance=last_distance - radius,
        increase=jnp.zeros_like(last_distance),
    )


def spiral_contact(
    start: Vector, end: Vector, cylinder: PlacedSurface, decision: CylinderDecision
) -> Contact:
    """Compute the contact as OpenSim 4.6 does for a path with a single wrap object.

    Parameters
    ----------
    start, end
        Ends of the segments in the cylinder's frame (m).
    cylinder
        The cylinder.
    decision
        Result of `decide_wrapping`.
    """
    normal = _plane_normal(start, end)
    first = _slide_into_plane(decision.first, start, end.z, end.z, start, normal)
    last = _slide_into_plane(decision.last, start, start.z, end.z, end, normal)
    return _on_spiral(start, first, last, end, cylinder, decision)


def iterated_spiral_contact(
    start: Vector, end: Vector, cylinder: PlacedSurface, decision: CylinderDecision
) -> Contact:
    """Compute the contact as OpenSim 4.6 does for a path with several wrap objects.

    Starting from `spiral_contact`, both points of contact are moved along the cylinder's axis, up to a
    hundred times, until the straight segments meet the spiral with a kink of less than 0.1 degrees.
    Parameters are those of `spiral_contact`.
    """
    contact = spiral_contact(start, end, cylinder, decision)
    long_way, radius = decision.long_way, cylinder.radius
    flat_first, flat_last = contact.first, contact.last
    turn = contact.turn
    needed = ~decision.inside & (decision.mandatory | decision.possible) & (contact.off_end >= 0.0)

    def spiral_length(first_z: Array, last_z: Array) -> Array:
        return jnp.sqrt((radius * turn) ** 2 + (last_z - first_z) ** 2)

    def point_on_spiral(first_z: Array, rise: Array, share: Array) -> Vector:
        angle = jnp.where(long_way, -1.0, 1.0) * share * turn
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        return Vector(
            cosine * flat_first.x - sine * flat_first.y,
            sine * flat_first.x + cosine * flat_first.y,
            first_z + share * rise,
        )

    def slide(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        first_z, last_z, going, count = state
        rise = last_z - first_z
        pieces = jnp.floor(spiral_length(first_z, last_z) / _STEP)
        share = 1.0 / jnp.maximum(pieces, 1.0)
        moved_first, did_first = _slide_to_tangency(
            start, Vector(flat_first.x, flat_first.y, first_z), point_on_spiral(first_z, rise, share)
        )
        # OpenSim computes the spiral's last but one point from the first point as moved in this iteration.
        moved_last, did_last = _slide_to_tangency(
            end, Vector(flat_last.x, flat_last.y, last_z), point_on_spiral(moved_first, rise, 1.0 - share)
        )
        go = going & (pieces >= 2.0)
        return (
            jnp.where(go, moved_first, first_z),
            jnp.where(go, moved_last, last_z),
            go & (did_first | did_last),
            count + 1,
        )

    def unfinished(state: tuple[Array, Array, Array, Array]) -> Array:
        return jnp.any(state[2]) & (state[3] < _MAX_SLIDES)

    first_z, last_z, _, _ = jax.lax.while_loop(
        unfinished, slide, (contact.first.z, contact.last.z, needed, jnp.asarray(0))
    )
    first = Vector(flat_first.x, flat_first.y, first_z)
    last = Vector(flat_last.x, flat_last.y, last_z)
    length = spiral_length(first_z, last_z)
    return replace(
        contact,
        first=first,
        last=last,
        length=length,
        total=(first - start).norm() + length + (end - last).norm(),
        start_pull=(first - start).unit(),
        end_pull=(end - last).unit(),
    )


def geodesic_contact(
    start: Vector, end: Vector, cylinder: PlacedSurface, decision: CylinderDecision
) -> Contact:
    """Compute the contact of the shortest path that passes the cylinder on the chosen side.

    From an end inside the cylinder there is no such path. The end then counts as on the surface, so that the
    length is continuous as an end moves into the cylinder. Parameters are those of `spiral_contact`.
    """
    radius = cylinder.radius
    leftward = decision.counterclockwise
    _, start_left, start_right = _tangent_points(start, radius)
    _, end_left, end_right = _tangent_points(end, radius)
    first, last = where(leftward, start_left, start_right), where(leftward, end_right, end_left)
    angle = jnp.where(leftward, 1.0, -1.0) * _angle_between(first, last)
    # A path that only just touches must not become a full turn while a solver iterates over its ends.
    turn = jnp.where(angle < -_GRAZING, angle + 2.0 * jnp.pi, angle)
    to_first = safe_sqrt(start.x**2 + start.y**2 - radius**2)
    from_last = safe_sqrt(end.x**2 + end.y**2 - radius**2)
    # The unrolled path is straight: z changes at a constant rate from end to end.
    slope = (end.z - start.z) * safe_inverse(to_first + radius * turn + from_last)
    first = Vector(first.x, first.y, start.z + slope * to_first)
    last = Vector(last.x, last.y, end.z - slope * from_last)
    stretch = jnp.sqrt(1.0 + slope**2)
    forward = jnp.where(leftward, 1.0, -1.0) / (radius * stretch)
    off_end = cylinder.half_length - jnp.minimum(jnp.abs(first.z), jnp.abs(last.z))
    return Contact(
        first=first,
        last=last,
        length=radius * turn * stretch,
        total=(to_first + radius * turn + from_last) * stretch,
        start_pull=Vector(-first.y * forward, first.x * forward, slope / stretch),
        end_pull=Vector(-last.y * forward, last.x * forward, slope / stretch),
        valid=off_end >= 0.0,
        turn=turn,
        off_end=off_end,
    )


def _tangent_points(
    point: Vector, radius: Float[Array, "*surface"]
) -> tuple[Float[Array, "*segment"], Vector, Vector]:
    """Compute a point's distance from the axis, and its left and right tangent points at its height."""
    square = point.x**2 + point.y**2
    inverse = safe_inverse(square)
    # A point inside has no tangents: the nearest point of the surface replaces both tangent points.
    toward = jnp.where(square < radius**2, radius * safe_sqrt(inverse), radius**2 * inverse)
    aside = radius * safe_sqrt(square - radius**2) * inverse
    x, y = toward * point.x, toward * point.y
    left = Vector(x - aside * point.y, y + aside * point.x, point.z)
    right = Vector(x + aside * point.y, y - aside * point.x, point.z)
    return safe_sqrt(square), left, right


def _nearest_to_axis(start: Vector, end: Vector) -> tuple[Vector, Float[Array, "*segment"]]:
    """Compute the point of a line nearest to the axis, and its position: 0 at the start, 1 at the end."""
    way = end - start
    along = -_flat_dot(start, way) * safe_inverse(_flat_dot(way, way))
    return start + way * along, along


def _flat_dot(one: Vector, other: Vector) -> Float[Array, "*segment"]:
    """Scalar product of the components normal to the axis."""
    return one.x * other.x + one.y * other.y


def _angle_between(one: Vector, other: Vector) -> Float[Array, "*segment"]:
    """Signed angle about z (rad)."""
    return jnp.arctan2(one.x * other.y - one.y * other.x, _flat_dot(one, other))


def _plane_normal(start: Vector, end: Vector) -> Vector:
    """Compute the normal of the plane through both ends and a point of the axis between their heights.

    OpenSim replaces the point of the axis by a point of the cylinder, which lies in the same plane.
    """
    first_distance = safe_sqrt(_flat_dot(start, start))
    last_distance = safe_sqrt(_flat_dot(end, end))
    height = start.z + (end.z - start.z) * first_distance * safe_inverse(first_distance + last_distance)
    zero = jnp.zeros_like(height)
    on_axis = Vector(zero, zero, height)
    return (start - on_axis).unit().cross((end - on_axis).unit()).unit()


def _slide_into_plane(
    tangent: Vector,
    start: Vector,
    toward: Float[Array, "*segment"],
    end_height: Float[Array, "*segment"],
    own_end: Vector,
    normal: Vector,
) -> Vector:
    """Move a tangent point along the cylinder into the plane, if that brings it nearer to the other end.

    ``toward`` is the other end's height. OpenSim uses the second end's projection on the axis as the axis'
    direction; where that projection is at height zero, the point is not moved.
    """
    steep = jnp.abs(20.0 * normal.z) >= 1e-5
    drop = normal.x * (tangent.x - start.x) + normal.y * (tangent.y - start.y)
    height = start.z - drop * safe_inverse(normal.z)
    within = jnp.abs(height - tangent.z) <= 10.0 + 2e-4
    seen = jnp.where(end_height == 0.0, start.z, height)
    nearer = jnp.abs(seen - toward) < jnp.abs(own_end.z - toward)
    return Vector(tangent.x, tangent.y, jnp.where(steep & within & nearer, height, tangent.z))


def _on_spiral(
    start: Vector,
    first: Vector,
    last: Vector,
    end: Vector,
    cylinder: PlacedSurface,
    decision: CylinderDecision,
) -> Contact:
    """Compute the contact along the spiral between two given points of contact."""
    angle = _angle_between(first, last)
    # As OpenSim 4.6: with a negative angle, a long wrap becomes more than a full turn.
    turn = jnp.where(decision.long_way, 2.0 * jnp.pi - angle, angle)
    length = jnp.sqrt((cylinder.radius * turn) ** 2 + (last.z - first.z) ** 2)
    off_end = cylinder.half_length - jnp.minimum(jnp.abs(first.z), jnp.abs(last.z))
    return Contact(
        first=first,
        last=last,
        length=length,
        total=(first - start).norm() + length + (end - last).norm(),
        start_pull=(first - start).unit(),
        end_pull=(end - last).unit(),
        valid=~decision.inside & (off_end >= 0.0),
        turn=turn,
        off_end=off_end,
    )


def _slide_to_tangency(
    end: Vector, tangent: Vector, on_spiral: Vector
) -> tuple[Float[Array, "*segment"], Bool[Array, "*segment"]]:
    """Move a tangent point along the axis to remove the kink there, with an over-relaxation of 1.5."""
    straight, spiral = (tangent - end).unit(), (on_spiral - tangent).unit()
    kink = jnp.abs(jnp.arccos(straight.z) - jnp.arccos(spiral.z))
    way = on_spiral - end
    along = _flat_dot(tangent - end, way) * safe_inverse(_flat_dot(way, way))
    height = end.z + along * way.z
    needed = kink > _TANGENCY
    return jnp.where(needed, tangent.z + 1.5 * (height - tangent.z), tangent.z), needed
