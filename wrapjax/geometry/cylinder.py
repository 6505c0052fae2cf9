"""One straight piece of path meeting one cylinder: whether it wraps, which way, and where it touches.

All in the cylinder's own frame, its axis along z. Two ways to find the points of contact:

- `spiral_contact` does what OpenSim 4.6 does, to round-off: it slides the tangent points along the
  cylinder by an approximation, so that the path is close to, but not exactly, the shortest one.
- `geodesic_contact` unrolls the cylinder: the path is a straight line on it, the shortest there is.

Whether a path wraps, and on which side, is decided in the same way for both.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, where

#: Wraps that go more than half way round are long.
HALF_TURN = jnp.pi
_GRAZING = 0.1
_TANGENCY = jnp.deg2rad(0.1)
_STEP = 0.002
_SLIDES = 100


class Cylinder(eqx.Module):
    """A cylinder where it is: axes (columns), center (m), in the frame of the body that carries it.

    ``side_axis`` and ``side`` restrict the surface to the half where that coordinate (0: x, 1: y) has
    that sign; ``side`` zero stands for all of it.
    """

    x_axis: Vector
    y_axis: Vector
    z_axis: Vector
    center: Vector
    radius: Float[Array, "*cylinder"]
    half_length: Float[Array, "*cylinder"]
    side_axis: Int[Array, "*cylinder"]
    side: Int[Array, "*cylinder"]

    def inward(self, point: Vector) -> Vector:
        """Bring a point from the body's frame into the cylinder's."""
        arm = point - self.center
        return Vector(self.x_axis.dot(arm), self.y_axis.dot(arm), self.z_axis.dot(arm))

    def turn_outward(self, direction: Vector) -> Vector:
        """Turn a direction from the cylinder's frame into the body's."""
        return self.x_axis * direction.x + self.y_axis * direction.y + self.z_axis * direction.z

    def outward(self, point: Vector) -> Vector:
        """Bring a point from the cylinder's frame into the body's."""
        return self.center + self.turn_outward(point)


class Decision(eqx.Module):
    """What is to become of pieces of path.

    ``mandatory`` pieces run through the cylinder; ``possible`` ones pass it on the wrong side.
    """

    inside: Bool[Array, "*piece"]
    mandatory: Bool[Array, "*piece"]
    possible: Bool[Array, "*piece"]
    #: Tangent points at the heights of the two ends.
    first: Vector
    last: Vector
    #: Counterclockwise about z.
    counterclockwise: Bool[Array, "*piece"]
    long_way: Bool[Array, "*piece"]
    #: Distances of the two ends from the surface (m), negative inside.
    start_clearance: Float[Array, "*piece"]
    end_clearance: Float[Array, "*piece"]

    @property
    def clearance(self) -> Float[Array, "*piece"]:
        """Distance of the nearer end from the surface (m)."""
        return jnp.minimum(self.start_clearance, self.end_clearance)


class Contact(eqx.Module):
    """Where pieces of path touch, in the cylinder's frame.

    ``length`` is that on the surface, ``total`` that from end to end (m). A piece pulls its ends along
    ``start_pull`` and against ``end_pull``, unit vectors along the path. ``off_end`` (m) is positive
    while a point of contact is on the cylinder, ``turn`` is how far the path goes round (rad).
    """

    first: Vector
    last: Vector
    length: Float[Array, "*piece"]
    total: Float[Array, "*piece"]
    start_pull: Vector
    end_pull: Vector
    #: Whether such a contact is made at all.
    made: Bool[Array, "*piece"]
    turn: Float[Array, "*piece"]
    off_end: Float[Array, "*piece"]


def decide(start: Vector, end: Vector, cylinder: Cylinder) -> Decision:
    """Decide as OpenSim's ``WrapCylinder`` does whether straight pieces wrap, and on which side.

    Parameters
    ----------
    start, end
        Ends of the pieces, in the cylinder's frame (m).
    cylinder
        Only its radius and side matter here.
    """
    radius = cylinder.radius
    first_distance, first_left, first_right = _tangent_points(start, radius)
    last_distance, last_left, last_right = _tangent_points(end, radius)
    nearest, along = _nearest_to_axis(start, end)
    crossing = (nearest.x**2 + nearest.y**2 < radius**2) & (along > 0.0) & (along < 1.0)

    restricted = cylinder.side != 0

    def on_side(point: Vector) -> Bool[Array, "*piece"]:
        value = jnp.where(cylinder.side_axis == 0, point.x, point.y)
        return jnp.where(value >= 0.0, 1, -1) == cylinder.side

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

    # Unrestricted: the two tangent points closest to each other, be they on one side or not.
    same_left, same_right = _flat_dot(first_left, last_left), _flat_dot(first_right, last_right)
    both_left = (same_left > left_way) & (same_left > right_way) & (same_left > same_right)
    left_right = ~both_left & (left_way > right_way) & (left_way > same_right)
    right_left = ~both_left & ~left_right & (right_way > same_right)
    first = where(jnp.where(restricted, leftward, both_left | left_right), first_left, first_right)
    last = where(jnp.where(restricted, ~leftward, both_left | right_left), last_left, last_right)
    # The way from an end to its tangent point, against the tangent points' own directions.
    outward = _flat_dot(first + last, (first - start) + (last - end))
    return Decision(
        inside=(first_distance < radius) | (last_distance < radius),
        mandatory=crossing & (~restricted | start_on | end_on),
        possible=restricted & ~(crossing & (start_on | end_on)) & passing,
        first=first,
        last=last,
        counterclockwise=jnp.where(restricted, leftward, ~left_longer),
        long_way=restricted & (outward < 0.0),
        start_clearance=first_distance - radius,
        end_clearance=last_distance - radius,
    )


def spiral_contact(start: Vector, end: Vector, cylinder: Cylinder, decision: Decision) -> Contact:
    """Find the contact as OpenSim 4.6 does for a path with a single wrap object."""
    normal = _plane_normal(start, end)
    first = _slid_into_plane(decision.first, start, end.z, end.z, start, normal)
    last = _slid_into_plane(decision.last, start, start.z, end.z, end, normal)
    return _on_spiral(start, first, last, end, cylinder, decision)


def settled_spiral_contact(start: Vector, end: Vector, cylinder: Cylinder, decision: Decision) -> Contact:
    """Find the contact as OpenSim 4.6 does for a path with several wrap objects.

    Both points are slid along the cylinder, up to a hundred times, until the straight pieces meet the
    spiral at the same angle to within 0.1 degrees.
    """
    contact = spiral_contact(start, end, cylinder, decision)
    long_way, radius = decision.long_way, cylinder.radius
    flat_first, flat_last = contact.first, contact.last
    turn = contact.turn
    needed = ~decision.inside & (decision.mandatory | decision.possible) & (contact.off_end >= 0.0)

    def heights_to_length(first_z: Array, last_z: Array) -> Array:
        return jnp.sqrt((radius * turn) ** 2 + (last_z - first_z) ** 2)

    def on_spiral(first_z: Array, rise: Array, share: Array) -> Vector:
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
        pieces = jnp.floor(heights_to_length(first_z, last_z) / _STEP)
        share = 1.0 / jnp.maximum(pieces, 1.0)
        moved_first, did_first = _slid_to_tangency(
            start, Vector(flat_first.x, flat_first.y, first_z), on_spiral(first_z, rise, share)
        )
        # OpenSim takes the already moved first point for the spiral's last but one.
        moved_last, did_last = _slid_to_tangency(
            end, Vector(flat_last.x, flat_last.y, last_z), on_spiral(moved_first, rise, 1.0 - share)
        )
        go = going & (pieces >= 2.0)
        return (
            jnp.where(go, moved_first, first_z),
            jnp.where(go, moved_last, last_z),
            go & (did_first | did_last),
            count + 1,
        )

    def unfinished(state: tuple[Array, Array, Array, Array]) -> Array:
        return jnp.any(state[2]) & (state[3] < _SLIDES)

    first_z, last_z, _, _ = jax.lax.while_loop(
        unfinished, slide, (contact.first.z, contact.last.z, needed, jnp.asarray(0))
    )
    first = Vector(flat_first.x, flat_first.y, first_z)
    last = Vector(flat_last.x, flat_last.y, last_z)
    length = heights_to_length(first_z, last_z)
    return replace(
        contact,
        first=first,
        last=last,
        length=length,
        total=(first - start).norm() + length + (end - last).norm(),
        start_pull=(first - start).unit(),
        end_pull=(end - last).unit(),
    )


def geodesic_contact(start: Vector, end: Vector, cylinder: Cylinder, decision: Decision) -> Contact:
    """Find the contact of the shortest path that goes round the chosen side.

    An end inside the cylinder, from where there is no such path, counts as on its surface: so length does
    not jump as an end goes in.
    """
    radius = cylinder.radius
    leftward = decision.counterclockwise
    _, start_left, start_right = _tangent_points(start, radius)
    _, end_left, end_right = _tangent_points(end, radius)
    first, last = where(leftward, start_left, start_right), where(leftward, end_right, end_left)
    angle = jnp.where(leftward, 1.0, -1.0) * _angle_between(first, last)
    # A path that only just touches must not go all the way round while its ends are being found.
    turn = jnp.where(angle < -_GRAZING, angle + 2.0 * jnp.pi, angle)
    to_first = safe_sqrt(start.x**2 + start.y**2 - radius**2)
    from_last = safe_sqrt(end.x**2 + end.y**2 - radius**2)
    # Unrolled, the path is straight: it climbs evenly from end to end.
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
        made=off_end >= 0.0,
        turn=turn,
        off_end=off_end,
    )


def _tangent_points(point: Vector, radius: Float[Array, ""]) -> tuple[Float[Array, "*piece"], Vector, Vector]:
    """Distance from the axis, and the points of tangency to the left and right, at the point's height."""
    square = point.x**2 + point.y**2
    inverse = safe_inverse(square)
    # From inside there are no tangents: the nearest point of the surface stands for both.
    toward = jnp.where(square < radius**2, radius * safe_sqrt(inverse), radius**2 * inverse)
    aside = radius * safe_sqrt(square - radius**2) * inverse
    x, y = toward * point.x, toward * point.y
    left = Vector(x - aside * point.y, y + aside * point.x, point.z)
    right = Vector(x + aside * point.y, y - aside * point.x, point.z)
    return safe_sqrt(square), left, right


def _nearest_to_axis(start: Vector, end: Vector) -> tuple[Vector, Float[Array, "*piece"]]:
    """The point of a straight line nearest to the axis, and where it is: 0 at the start, 1 at the end."""
    way = end - start
    along = -_flat_dot(start, way) * safe_inverse(_flat_dot(way, way))
    return start + way * along, along


def _flat_dot(one: Vector, other: Vector) -> Float[Array, "*piece"]:
    return one.x * other.x + one.y * other.y


def _angle_between(one: Vector, other: Vector) -> Float[Array, "*piece"]:
    """Signed angle about z."""
    return jnp.arctan2(one.x * other.y - one.y * other.x, _flat_dot(one, other))


def _plane_normal(start: Vector, end: Vector) -> Vector:
    """Normal of the plane through both ends and the axis, at a height between them.

    OpenSim goes on from here to an apex on the cylinder, but that lies in this plane, too.
    """
    first_distance = safe_sqrt(_flat_dot(start, start))
    last_distance = safe_sqrt(_flat_dot(end, end))
    height = start.z + (end.z - start.z) * first_distance * safe_inverse(first_distance + last_distance)
    zero = jnp.zeros_like(height)
    on_axis = Vector(zero, zero, height)
    return (start - on_axis).unit().cross((end - on_axis).unit()).unit()


def _slid_into_plane(
    tangent: Vector,
    start: Vector,
    toward: Float[Array, "*piece"],
    end_height: Float[Array, "*piece"],
    own_end: Vector,
    normal: Vector,
) -> Vector:
    """Slide a tangent point along the cylinder into the plane, if that brings it nearer to the other end.

    ``toward`` is the other end's height. OpenSim takes the second end's foot on the axis for the axis'
    direction; where that is at height zero, it has none, and nothing is slid.
    """
    steep = jnp.abs(20.0 * normal.z) >= 1e-5
    drop = normal.x * (tangent.x - start.x) + normal.y * (tangent.y - start.y)
    height = start.z - drop * safe_inverse(normal.z)
    within = jnp.abs(height - tangent.z) <= 10.0 + 2e-4
    seen = jnp.where(end_height == 0.0, start.z, height)
    nearer = jnp.abs(seen - toward) < jnp.abs(own_end.z - toward)
    return Vector(tangent.x, tangent.y, jnp.where(steep & within & nearer, height, tangent.z))


def _on_spiral(
    start: Vector, first: Vector, last: Vector, end: Vector, cylinder: Cylinder, decision: Decision
) -> Contact:
    angle = _angle_between(first, last)
    # OpenSim 4.6: where the angle is negative, a long wrap becomes more than a full turn.
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
        made=~decision.inside & (off_end >= 0.0),
        turn=turn,
        off_end=off_end,
    )


def _slid_to_tangency(
    end: Vector, tangent: Vector, on_spiral: Vector
) -> tuple[Float[Array, "*piece"], Bool[Array, "*piece"]]:
    """Slide a tangent point one and a half times as far as would make the path straight there."""
    straight, spiral = (tangent - end).unit(), (on_spiral - tangent).unit()
    kink = jnp.abs(jnp.arccos(straight.z) - jnp.arccos(spiral.z))
    way = on_spiral - end
    along = _flat_dot(tangent - end, way) * safe_inverse(_flat_dot(way, way))
    height = end.z + along * way.z
    needed = kink > _TANGENCY
    return jnp.where(needed, tangent.z + 1.5 * (height - tangent.z), tangent.z), needed
