"""Wrapping of one straight path segment round one sphere: decision, side and points of contact.

All coordinates are in the sphere's frame. The path lies in the plane of its two ends and the center, on
either side of the center. The shorter side is the shortest path. A quadrant can make the path pass on the
longer one, which is a path of stationary length but not a shortest one; the margin `Contact.turn` leaves to
half a turn is then negative.

From an end inside the sphere there is no path. Shortest paths then count the end as on the surface, so that
length is continuous as an end moves into the sphere; OpenSim does not wrap. If the segment passes through the
center, the plane is undetermined; the path then passes on the side of the quadrant or, without one, on the
side of the coordinate axis that is most nearly normal to the segment.
"""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces.placed_surface import Contact, Decision, PlacedSurface
from wrapjax.geometry.vectors import Vector, safe_inverse, safe_sqrt, where

# Distance of the segment from the center, as a share of its ends' distances, below which the plane is not
# determined by them.
_COLLINEAR = 1e-9


class SphereDecision(Decision):
    """Whether straight path segments wrap round a sphere, and on which side of its center."""

    #: Unit vectors from the center towards both ends, and normal to these towards the near side of the path.
    to_start: Vector
    to_end: Vector
    start_normal: Vector
    end_normal: Vector
    #: Angles at the center (rad): between both ends, and from each end to its point of contact.
    between: Float[Array, "*segment"]
    start_angle: Float[Array, "*segment"]
    end_angle: Float[Array, "*segment"]
    #: The path passes on the longer side.
    far: Bool[Array, "*segment"]


def decide_wrapping(start: Vector, end: Vector, sphere: PlacedSurface) -> SphereDecision:
    """Decide as OpenSim's ``WrapSphere`` does whether straight segments wrap, and on which side.

    Parameters
    ----------
    start, end
        Ends of the segments in the sphere's frame (m).
    sphere
        The sphere, of which only the radius and the side are used.
    """
    radius = sphere.radius
    first_distance, last_distance = start.norm(), end.norm()
    to_start, to_end = start * safe_inverse(first_distance), end * safe_inverse(last_distance)
    crossing = intersects(start, end, radius)
    start_normal, end_normal, sine = _plane(to_start, to_end, sphere)
    start_angle, end_angle = (
        jnp.arctan2(safe_sqrt(distance**2 - radius**2), jnp.minimum(radius, distance))
        for distance in (first_distance, last_distance)
    )
    decision = SphereDecision(
        inside=(first_distance < radius) | (last_distance < radius),
        mandatory=crossing,
        possible=jnp.zeros_like(crossing),
        start_clearance=first_distance - radius,
        end_clearance=last_distance - radius,
        increase=jnp.zeros_like(last_distance),
        to_start=to_start,
        to_end=to_end,
        start_normal=start_normal,
        end_normal=end_normal,
        between=jnp.arctan2(sine, to_start.dot(to_end)),
        start_angle=start_angle,
        end_angle=end_angle,
        far=jnp.zeros_like(crossing),
    )
    restricted = sphere.side != 0
    start_on, end_on = sphere.on_side(start), sphere.on_side(end)
    # The far side is tried first: straight lines to its points of contact must point to the active side.
    first, last = _points_of_contact(decision, radius, jnp.ones_like(crossing))
    way = (first - start) + (last - end)
    along = jnp.where(sphere.side_axis == 0, way.x, jnp.where(sphere.side_axis == 1, way.y, way.z))
    passes_far = restricted & ~(start_on & end_on) & (along * sphere.side >= 0.0)
    # Of several segments that intersect an unrestricted sphere, OpenSim wraps the one that becomes longer by
    # the least, and not the first one as round other surfaces.
    first_wraps = restricted & (start_on | end_on)
    return replace(
        decision, mandatory=crossing & first_wraps, possible=crossing & ~first_wraps, far=passes_far
    )


def intersects(start: Vector, end: Vector, radius: Float[Array, "*surface"]) -> Bool[Array, "*segment"]:
    """Whether segments come nearest to the origin between their ends, and nearer than a radius."""
    way = end - start
    along = -start.dot(way) * safe_inverse(way.dot(way))
    nearest = start + way * along
    return (nearest.dot(nearest) < radius**2) & (along > 0.0) & (along < 1.0)


def geodesic_contact(start: Vector, end: Vector, sphere: PlacedSurface, decision: SphereDecision) -> Contact:
    """Compute the contact of the path that passes on the decided side.

    Parameters
    ----------
    start, end
        Ends of the segments in the sphere's frame (m).
    sphere
        The sphere.
    decision
        Result of `decide_wrapping`.
    """
    radius = sphere.radius
    first, last = _points_of_contact(decision, radius, decision.far)
    between = jnp.where(decision.far, 2.0 * jnp.pi - decision.between, decision.between)
    turn = between - decision.start_angle - decision.end_angle
    to_first = safe_sqrt(decision.start_clearance * (decision.start_clearance + 2.0 * radius))
    from_last = safe_sqrt(decision.end_clearance * (decision.end_clearance + 2.0 * radius))
    # Directions at the points of contact: from an end inside, the path starts along the surface.
    side = jnp.where(decision.far, -1.0, 1.0)
    start_pull = _tangent(decision.to_start, decision.start_normal * side, decision.start_angle)
    end_pull = _tangent(decision.to_end, decision.end_normal * side, decision.end_angle) * -1.0
    return Contact(
        first=first,
        last=last,
        length=radius * turn,
        total=to_first + radius * turn + from_last,
        start_pull=start_pull,
        end_pull=end_pull,
        valid=jnp.ones_like(decision.far),
        # The path is no shortest one if its ends are more than half a turn apart.
        turn=jnp.where(decision.far, between, turn),
        off_end=jnp.ones_like(turn),
    )


def opensim_contact(start: Vector, end: Vector, sphere: PlacedSurface, decision: SphereDecision) -> Contact:
    """Compute the contact as OpenSim 4.6 does, where an arc of more than half a turn has a negative length.

    Parameters are those of `geodesic_contact`.
    """
    contact = geodesic_contact(start, end, sphere, decision)
    # OpenSim computes the angle between the points of contact, which is at most half a turn, and takes its
    # complement with a negative sign if the path is longer than half a turn.
    between = jnp.where(decision.far, 2.0 * jnp.pi - decision.between, decision.between)
    angle = jnp.abs(between - decision.start_angle - decision.end_angle)
    signed = jnp.where(decision.far & (angle > jnp.pi), -angle, angle)
    length = sphere.radius * signed
    return replace(
        contact,
        length=length,
        total=(contact.first - start).norm() + length + (end - contact.last).norm(),
        start_pull=(contact.first - start).unit(),
        end_pull=(end - contact.last).unit(),
        valid=~decision.inside,
        turn=angle,
    )


def _plane(
    to_start: Vector, to_end: Vector, sphere: PlacedSurface
) -> tuple[Vector, Vector, Float[Array, "*segment"]]:
    """Compute the normals to both directions within their plane, each towards the other, and their sine."""
    cosine = to_start.dot(to_end)
    toward_end = to_end - to_start * cosine
    sine = toward_end.norm()
    determined = sine > _COLLINEAR
    # A direction normal to the segment: the quadrant's axis, or the axis most nearly normal to it.
    size = Vector(jnp.abs(to_start.x), jnp.abs(to_start.y), jnp.abs(to_start.z))
    least_x = (size.x <= size.y) & (size.x <= size.z)
    least_y = ~least_x & (size.y <= size.z)
    axis = jnp.where(sphere.side != 0, sphere.side_axis, jnp.where(least_x, 0, jnp.where(least_y, 1, 2)))
    sign = jnp.where(sphere.side != 0, sphere.side, 1)
    chosen = Vector(*(sign * (axis == number).astype(float) for number in range(3)))
    aside = (chosen - to_start * chosen.dot(to_start)).unit()
    start_normal = where(determined, toward_end.unit(), aside)
    end_normal = where(determined, (to_start - to_end * cosine).unit(), aside)
    return start_normal, end_normal, sine


def _points_of_contact(
    decision: SphereDecision, radius: Float[Array, "*surface"], far: Bool[Array, "*segment"]
) -> tuple[Vector, Vector]:
    side = jnp.where(far, -1.0, 1.0)

    def point(toward: Vector, normal: Vector, angle: Float[Array, "*segment"]) -> Vector:
        return (toward * jnp.cos(angle) + normal * (side * jnp.sin(angle))) * radius

    return (
        point(decision.to_start, decision.start_normal, decision.start_angle),
        point(decision.to_end, decision.end_normal, decision.end_angle),
    )


def _tangent(toward: Vector, normal: Vector, angle: Float[Array, "*segment"]) -> Vector:
    """Direction in which an angle from one unit vector to another one increases."""
    return normal * jnp.cos(angle) - toward * jnp.sin(angle)
