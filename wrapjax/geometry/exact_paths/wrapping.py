"""Wrap parameters of surfaces, and length and moment arms of a path that may wrap round one surface.

The six wrap parameters of a cylinder, after Ao, Fregly et al., translate, rotate and scale it relative to its
nominal pose; other surfaces have three more. Paths round a single surface are computed in the frame of the
body that carries the surface, where only the path's points move. Paths round several surfaces are in
`several_wraps`.
"""

from __future__ import annotations

from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.surfaces.placed_surface import FREE as FREE
from wrapjax.geometry.surfaces.placed_surface import HALF_TURN, Decision, PlacedSurface, WrapMethod
from wrapjax.geometry.vectors import Vector, vector

#: Wrap parameters in their order: translation along the nominal frame's axes, rotation about its x axis and
#: then about the rotated y axis, and the radius as a multiple of the nominal radius.
WRAP_PARAMETERS = (
    "translation_x_m",
    "translation_y_m",
    "translation_z_m",
    "rotation_x_rad",
    "rotation_y_rad",
    "radius_factor",
)

#: Wrap parameters of a cylinder as the model has it.
NOMINAL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

#: Further wrap parameters of surfaces other than cylinders: rotation about the axis z as rotated by those
#: before, and factors of the second and third size in addition to ``radius_factor``, which multiplies all
#: sizes. Sizes are the semi-axes of an ellipsoid along x, y and z, and the radii of a torus' ring and tube.
FURTHER_WRAP_PARAMETERS = ("rotation_z_rad", "second_size_factor", "third_size_factor")
#: Names of all wrap parameters of any surface.
PARAMETERS = (*WRAP_PARAMETERS, *FURTHER_WRAP_PARAMETERS)
#: All wrap parameters of a surface as the model has it.
NOMINAL_PARAMETERS = np.append(NOMINAL, [0.0, 1.0, 1.0])

#: Wrap parameters on which a path round a surface depends, by OpenSim's class. Rotations of a sphere, and of
#: a torus about its axis, only turn its quadrant.
PARAMETERS_OF = {
    "WrapCylinder": WRAP_PARAMETERS,
    "WrapSphere": (*WRAP_PARAMETERS[:3], "radius_factor"),
    "WrapEllipsoid": PARAMETERS,
    "WrapTorus": (*WRAP_PARAMETERS, "second_size_factor"),
}


def parameter_names(classes: Iterable[str]) -> tuple[str, ...]:
    """Names of the wrap parameters of surfaces of OpenSim's classes: six or, if any depends on more, all."""
    own = {name for one in classes for name in PARAMETERS_OF.get(one, ())}
    return WRAP_PARAMETERS if own <= set(WRAP_PARAMETERS) else PARAMETERS


class Surface(eqx.Module):
    """A wrap surface with its nominal pose in the frame of the body that carries it."""

    #: Columns are the surface's axes.
    rotation: Float[Array, "*surface 3 3"]
    #: m
    center: Float[Array, "*surface 3"]
    #: Radius of a cylinder, a sphere or a torus' tube, mean semi-axis of an ellipsoid (m).
    radius: Float[Array, "*surface"]
    #: Length of a cylinder (m).
    length: Float[Array, "*surface"]
    #: Restriction to one side: see `PlacedSurface`.
    side_axis: Array
    side: Array
    #: Sizes (m), see `PlacedSurface`; None if all surfaces of the path are cylinders.
    sizes: Float[Array, "*surface 3"] | None = None

    def placed(self, parameters: Float[Array, " wrap_parameter"]) -> PlacedSurface:
        """Apply wrap parameters: the rotation becomes ``R_nominal Rx Ry Rz``.

        Parameters
        ----------
        parameters
            `WRAP_PARAMETERS`, and optionally `FURTHER_WRAP_PARAMETERS`.
        """
        x_axis, y_axis, z_axis = (vector(self.rotation[:, column]) for column in range(3))
        shift = x_axis * parameters[0] + y_axis * parameters[1] + z_axis * parameters[2]
        sine_x, cosine_x = jnp.sin(parameters[3]), jnp.cos(parameters[3])
        sine_y, cosine_y = jnp.sin(parameters[4]), jnp.cos(parameters[4])
        turned_y = y_axis * cosine_x + z_axis * sine_x
        turned_z = z_axis * cosine_x - y_axis * sine_x
        turned_x = x_axis * cosine_y - turned_z * sine_y
        radius, sizes = self.radius * parameters[5], None
        if self.sizes is not None:
            factors = parameters[5] * jnp.ones(3)
            if parameters.shape[0] > len(NOMINAL):
                sine_z, cosine_z = jnp.sin(parameters[6]), jnp.cos(parameters[6])
                turned_x, turned_y = (
                    turned_x * cosine_z + turned_y * sine_z,
                    turned_y * cosine_z - turned_x * sine_z,
                )
                factors = factors * jnp.concatenate([jnp.ones(1), parameters[7:9]])
            # A torus' second and third size are the same radius.
            sizes = vector(self.sizes * factors)
        return PlacedSurface(
            x_axis=turned_x,
            y_axis=turned_y,
            z_axis=turned_z * cosine_y + x_axis * sine_y,
            center=vector(self.center) + shift,
            radius=radius,
            half_length=0.5 * self.length,
            side_axis=self.side_axis,
            side=self.side,
            sizes=sizes,
        )


class Margins(eqx.Module):
    """Margins of a path from discontinuities of its length, negative beyond a discontinuity.

    They are smooth in pose and wrap parameters, except where the wrapping segment changes.
    """

    #: Distance of the nearest path point from the surface (m). OpenSim does not wrap if a point is inside.
    inside: Float[Array, "*pose"]
    #: Distance of the contact from a cylinder's end (m). Paths do not wrap beyond the end.
    off_end: Float[Array, "*pose"]
    #: Half a turn less the wrap angle (rad). OpenSim takes the long way round above half a turn. Round an
    #: ellipsoid or a torus a fixed number, positive where no path nearby is shorter. Negative where contacts
    #: with several surfaces, which overlap, do not converge.
    long_wrap: Float[Array, "*pose"]


class WrappedPath(eqx.Module):
    """Length, moment arms, contact lengths and margins of one muscle's path."""

    #: m
    length: Float[Array, "*pose"]
    #: -dL/dq about each coordinate, m (m/rad).
    moment_arm: Float[Array, "*pose coordinate"]
    #: Length of the contact with each surface (m), zero without contact.
    on_surface: Float[Array, "*pose wrap"]
    #: Smallest margins over all surfaces and segments.
    margins: Margins
    #: Distances from each discontinuity of the length (m), each of them smooth.
    clearances: Float[Array, "*pose barrier"]

    @property
    def touching(self) -> Bool[Array | np.ndarray, "*pose wrap"]:
        """Whether the path touches each of its surfaces."""
        return self.on_surface > 0.0


class StraightPath(eqx.Module):
    """A path without its surface, and the segments of it that may wrap round the surface."""

    #: Length without wrapping (m).
    length: Float[Array, "*pose"]
    #: Moment arms without wrapping, m (m/rad).
    moment_arm: Float[Array, "*pose coordinate"]
    #: Ends of the segments (m), and their velocities per unit speed of each coordinate (m/rad), of which the
    #: first axis after ``pose`` is ``coordinate``.
    start: Vector
    end: Vector
    start_velocity: Vector
    end_velocity: Vector
    #: Whether a segment may wrap; False for padding and for segments between inactive points.
    eligible: Bool[Array, "*pose segment"]

    def padded(self, segments: int) -> StraightPath:
        """Pad to a number of segments with ineligible copies of the last segment."""
        missing = segments - self.eligible.shape[-1]

        def repeated(leaf: Array) -> Array:
            known = np.asarray(leaf)
            return jnp.asarray(np.concatenate([known, np.repeat(known[..., -1:], missing, axis=-1)], axis=-1))

        ends = (self.start, self.end, self.start_velocity, self.end_velocity)
        start, end, start_velocity, end_velocity = jax.tree.map(repeated, ends)
        none = np.zeros((*self.eligible.shape[:-1], missing), dtype=bool)
        eligible = jnp.asarray(np.concatenate([np.asarray(self.eligible), none], axis=-1))
        return StraightPath(self.length, self.moment_arm, start, end, start_velocity, end_velocity, eligible)


def wrap_once(path: StraightPath, surface: PlacedSurface, method: WrapMethod) -> WrappedPath:
    """Compute a path round one surface, in one pose.

    As in OpenSim, at most one segment wraps: the first one that intersects the surface or, if none does, the
    one that becomes longer by the least.

    Parameters
    ----------
    path
        Path in the frame of the body that carries the surface.
    surface
        Surface in that frame.
    method
        How segments wrap round it, for the shortest path or for OpenSim's path.

    Returns
    -------
    WrappedPath
        ``moment_arm`` is that of unit tension along the path. It is exactly -dL/dq for the shortest path.
    """
    start, end = surface.to_surface_frame(path.start), surface.to_surface_frame(path.end)
    decision = method.decide(start, end, surface)
    crossing = path.eligible & (decision.mandatory | decision.possible)
    order = jnp.arange(path.eligible.shape[-1])
    own_ends, own_decision, start_velocity, end_velocity = (
        (start, end),
        decision,
        path.start_velocity,
        path.end_velocity,
    )
    if method.decided_first:
        # Only this segment's contact is computed, and all of the below has a single segment.
        rank = jnp.where(decision.mandatory, order - 1e6, decision.increase)
        order = jnp.argmin(jnp.where(crossing, rank, jnp.inf), axis=-1)[None]
        own_ends, own_decision, start_velocity, end_velocity, crossing = jax.tree.map(
            lambda leaf: jnp.take(leaf, order, axis=-1),
            (own_ends, decision, start_velocity, end_velocity, crossing),
        )
    clearances = _point_clearances(path, decision)
    if method.side_clearance is not None:
        side = jnp.where(path.eligible, method.side_clearance(start, end, surface), FREE)
        clearances.append(jnp.min(side, axis=-1, keepdims=True))
    start, end = own_ends
    contact = method.find_contact(start, end, surface, own_decision)
    wraps = crossing & contact.valid
    straight = end - start
    longer = contact.total - straight.norm()
    # Segments that intersect the surface rank first, in their order; the others by the increase of length.
    rank = jnp.where(own_decision.mandatory, order - 1e6, longer)
    rank = jnp.where(wraps, rank, jnp.inf)
    chosen = wraps & (jnp.arange(order.size) == jnp.argmin(rank, axis=-1))

    first_pull = surface.rotate_to_body_frame(contact.start_pull)
    last_pull = surface.rotate_to_body_frame(contact.end_pull)
    straight_pull = surface.rotate_to_body_frame(straight.unit())
    # In the frame of the surface's body only the ends of the segments move.
    at_start, at_end = (first_pull - straight_pull).at(None), (last_pull - straight_pull).at(None)
    change = at_start.dot(start_velocity) - at_end.dot(end_velocity)
    margins = Margins(
        inside=jnp.min(jnp.where(path.eligible, decision.clearance, FREE), axis=-1),
        off_end=jnp.min(jnp.where(crossing, contact.off_end, FREE), axis=-1),
        long_wrap=jnp.min(jnp.where(wraps, HALF_TURN - jnp.abs(contact.turn), FREE), axis=-1),
    )
    clearances.append(jnp.stack([margins.off_end, surface.radius * margins.long_wrap], axis=-1))
    return WrappedPath(
        length=path.length + jnp.sum(jnp.where(chosen, longer, 0.0), axis=-1),
        moment_arm=path.moment_arm + jnp.sum(jnp.where(chosen[None], change, 0.0), axis=-1),
        on_surface=jnp.sum(jnp.where(chosen, contact.length, 0.0), axis=-1, keepdims=True),
        margins=margins,
        clearances=jnp.concatenate(clearances, axis=-1),
    )


def _point_clearances(path: StraightPath, decision: Decision) -> list[Float[Array, "*pose barrier"]]:
    """Distances of all path points from the surface (m)."""
    at_starts = jnp.where(path.eligible, decision.start_clearance, FREE)
    at_last = jnp.where(jnp.any(path.eligible, axis=-1), decision.end_clearance[..., -1], FREE)
    return [at_starts, at_last[..., None]]


def unwrapped(path: StraightPath) -> WrappedPath:
    """Convert a path without surfaces to a `WrappedPath`."""
    free = jnp.full(path.length.shape, FREE)
    return WrappedPath(
        length=path.length,
        moment_arm=path.moment_arm,
        on_surface=jnp.zeros((*path.length.shape, 0)),
        margins=Margins(free, free, free),
        clearances=jnp.zeros((*path.length.shape, 0)),
    )
