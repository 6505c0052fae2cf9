"""Wrap surfaces in the frames of the bodies that carry them, and the contact of path segments with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.vectors import Vector

#: Value of a margin or clearance to which no discontinuity applies.
FREE = 1.0
#: Half a turn (rad), above which a contact is not the shortest round its surface.
HALF_TURN = jnp.pi


_Result = TypeVar("_Result")


class PlacedSurface(eqx.Module):
    """A wrap surface with its pose in the frame of the body that carries it.

    ``x_axis``, ``y_axis`` and ``z_axis`` are unit vectors; ``center``, ``radius`` and ``half_length`` are in
    m. ``side_axis`` and ``side`` are OpenSim's quadrant: paths pass on the side where the coordinate
    ``side_axis`` (0: x, 1: y, 2: z) of the surface's frame has the sign ``side``; ``side`` zero means
    unrestricted.
    """

    x_axis: Vector
    y_axis: Vector
    z_axis: Vector
    center: Vector
    #: Radius of a cylinder, a sphere or a torus' tube; mean semi-axis of an ellipsoid.
    radius: Float[Array, "*surface"]
    #: Half the length of a cylinder.
    half_length: Float[Array, "*surface"]
    side_axis: Int[Array, "*surface"]
    side: Int[Array, "*surface"]
    #: Semi-axes of an ellipsoid; ring and tube radius of a torus, and the tube radius again. None on paths
    #: round cylinders alone.
    sizes: Vector | None = None

    def to_surface_frame(self, point: Vector) -> Vector:
        """Transform a point from the body's frame to the surface's frame."""
        arm = point - self.center
        return Vector(self.x_axis.dot(arm), self.y_axis.dot(arm), self.z_axis.dot(arm))

    def rotate_to_body_frame(self, direction: Vector) -> Vector:
        """Rotate a direction from the surface's frame to the body's frame."""
        return self.x_axis * direction.x + self.y_axis * direction.y + self.z_axis * direction.z

    def to_body_frame(self, point: Vector) -> Vector:
        """Transform a point from the surface's frame to the body's frame."""
        return self.center + self.rotate_to_body_frame(point)

    def on_side(self, point: Vector) -> Bool[Array, "*segment"]:
        """Whether points in the surface's frame are on the side where paths pass."""
        value = jnp.where(self.side_axis == 0, point.x, jnp.where(self.side_axis == 1, point.y, point.z))
        return jnp.where(value >= 0.0, 1, -1) == self.side


class Decision(eqx.Module):
    """Whether straight path segments wrap round a surface."""

    #: An end of the segment is inside the surface: OpenSim does not wrap then.
    inside: Bool[Array, "*segment"]
    #: The segment intersects the surface.
    mandatory: Bool[Array, "*segment"]
    #: The segment passes the surface on the side that its quadrant excludes.
    possible: Bool[Array, "*segment"]
    #: Distances of the two ends from the surface (m), negative inside.
    start_clearance: Float[Array, "*segment"]
    end_clearance: Float[Array, "*segment"]

    #: Estimate of the increase of length (m) by which segments are ranked before their contact is known.
    increase: Float[Array, "*segment"]

    @property
    def clearance(self) -> Float[Array, "*segment"]:
        """Distance of the nearer end from the surface (m)."""
        return jnp.minimum(self.start_clearance, self.end_clearance)


class Contact(eqx.Module):
    """Contact of path segments with a surface, in the surface's frame."""

    #: Points where the path comes to the surface and leaves it (m).
    first: Vector
    last: Vector
    #: Length on the surface (m).
    length: Float[Array, "*segment"]
    #: Length from the segment's start to its end (m).
    total: Float[Array, "*segment"]
    #: Unit vectors along the path at the segment's start and end, both from start to end.
    start_pull: Vector
    end_pull: Vector
    #: Whether the path wraps in this way.
    valid: Bool[Array, "*segment"]
    #: Wrap angle (rad).
    turn: Float[Array, "*segment"]
    #: Distance of the nearer point of contact from the cylinder's end (m), negative beyond the end.
    off_end: Float[Array, "*segment"]


#: Function that decides whether segments wrap, and on which side.
Decide = Callable[[Vector, Vector, PlacedSurface], Decision]
#: Function that computes the contact of segments: from their ends, the surface and their decision, whose
#: class is that of the surface's kind.
FindContact = Callable[..., Contact]


class WrapMethod(NamedTuple):
    """How segments wrap round one kind of surface: functions of segments in the surface's frame."""

    decide: Decide
    find_contact: FindContact
    #: The segment that wraps is known from the decisions, and only its contact is computed.
    decided_first: bool = False
    #: OpenSim's outcome is that of a segment that wraps, whether one does or not.
    always_wrapped: bool = False
    #: Distance (m) of segments from where an unrestricted path changes to the other side of the surface, if
    #: that is to be kept from. `FREE` where a quadrant determines the side.
    side_clearance: Callable[[Vector, Vector, PlacedSurface], Float[Array, "*segment"]] | None = None


def over_segments(function: Callable[..., _Result], segments: Vector) -> Callable[..., _Result]:
    """Extend a function of a single segment to all axes of segments."""
    for _ in range(segments.x.ndim):
        function = jax.vmap(function)
    return function
