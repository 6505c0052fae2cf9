"""Wrap surfaces and the six parameters that move, turn and scale them.

A path that may wrap round one cylinder: its length, moment arms and margins, in one pose.

Everything is in the frame of the body that carries the cylinder, so that only the path's points move.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.cylinder import HALF_TURN, Contact, Cylinder, Decision, decide
from wrapjax.geometry.vectors import Vector, vector

#: A surface's parameters, in their order: translation along the nominal frame's axes, turns about its
#: x and then its own y axis, and the radius as a multiple of the nominal one.
WRAP_PARAMETERS = (
    "translation_x_m",
    "translation_y_m",
    "translation_z_m",
    "rotation_x_rad",
    "rotation_y_rad",
    "radius_factor",
)

#: Leaves a surface as the model has it.
NOMINAL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Surface(eqx.Module):
    """A cylinder as the model has it, in the frame of the body that carries it."""

    #: Columns are the cylinder's axes.
    rotation: Float[Array, "*surface 3 3"]
    #: m
    center: Float[Array, "*surface 3"]
    radius: Float[Array, "*surface"]
    length: Float[Array, "*surface"]
    side_axis: Array
    side: Array

    def placed(self, parameters: Float[Array, " wrap_parameter"]) -> Cylinder:
        """Move, turn and scale the cylinder: ``R_nominal Rx Ry``, the paper's six wrap parameters."""
        x_axis, y_axis, z_axis = (vector(self.rotation[:, column]) for column in range(3))
        shift = x_axis * parameters[0] + y_axis * parameters[1] + z_axis * parameters[2]
        sine_x, cosine_x = jnp.sin(parameters[3]), jnp.cos(parameters[3])
        sine_y, cosine_y = jnp.sin(parameters[4]), jnp.cos(parameters[4])
        turned_y = y_axis * cosine_x + z_axis * sine_x
        turned_z = z_axis * cosine_x - y_axis * sine_x
        return Cylinder(
            x_axis=x_axis * cosine_y - turned_z * sine_y,
            y_axis=turned_y,
            z_axis=turned_z * cosine_y + x_axis * sine_y,
            center=vector(self.center) + shift,
            radius=self.radius * parameters[5],
            half_length=0.5 * self.length,
            side_axis=self.side_axis,
            side=self.side,
        )


#: How a contact is found: `geodesic_contact` or `spiral_contact`.
FindContact = Callable[[Vector, Vector, Cylinder, Decision], Contact]

#: What a margin is where nothing is near enough to matter.
FREE = 1.0


class Margins(eqx.Module):
    """How far a path is from where its length would jump; negative where that has happened.

    Smooth in pose and wrap parameters, but for the change from one piece of path to another.
    """

    #: Distance of the nearest path point from the surface (m): inside, OpenSim does not wrap.
    inside: Float[Array, "*pose"]
    #: Distance of the path on the surface from the cylinder's end (m): beyond it does not wrap.
    off_end: Float[Array, "*pose"]
    #: What is left of half a turn (rad).
    long_wrap: Float[Array, "*pose"]


class WrappedPath(eqx.Module):
    """What one muscle's path is in a pose."""

    #: m
    length: Float[Array, "*pose"]
    #: By coordinate, m/rad: -dL/dq.
    moment_arm: Float[Array, "*pose coordinate"]
    #: How far it runs on each of its cylinders (m): zero where it does not lie on one.
    on_surface: Float[Array, "*pose wrap"]
    margins: Margins
    #: Distances (m) from everything that would make the length jump, one by one: each is smooth by itself.
    clearances: Float[Array, "*pose wall"]

    @property
    def touching(self) -> Bool[Array | np.ndarray, "*pose wrap"]:
        """Which of its cylinders it lies on."""
        return self.on_surface > 0.0


class StraightPath(eqx.Module):
    """A path as it would be without its cylinder, and the pieces of it that may wrap."""

    length: Float[Array, "*pose"]
    moment_arm: Float[Array, "*pose coordinate"]
    #: Ends of the pieces (m) and their velocities by coordinate; velocities lead with it.
    start: Vector
    end: Vector
    start_velocity: Vector
    end_velocity: Vector
    #: False for a piece that is there only to fill up.
    eligible: Bool[Array, "*pose piece"]

    def filled(self, pieces: int) -> StraightPath:
        """Fill up to a number of pieces: copies of the last one that do not count."""
        missing = pieces - self.eligible.shape[-1]

        def repeated(leaf: Array) -> Array:
            known = np.asarray(leaf)
            return jnp.asarray(np.concatenate([known, np.repeat(known[..., -1:], missing, axis=-1)], axis=-1))

        ends = (self.start, self.end, self.start_velocity, self.end_velocity)
        start, end, start_velocity, end_velocity = jax.tree.map(repeated, ends)
        none = np.zeros((*self.eligible.shape[:-1], missing), dtype=bool)
        eligible = jnp.asarray(np.concatenate([np.asarray(self.eligible), none], axis=-1))
        return StraightPath(self.length, self.moment_arm, start, end, start_velocity, end_velocity, eligible)


def wrap_once(path: StraightPath, cylinder: Cylinder, find_contact: FindContact) -> WrappedPath:
    """Wrap a path round a cylinder, in one pose.

    Of several pieces that might wrap the first that runs through the cylinder does; if none does, the
    one that gets longer by least.

    Parameters
    ----------
    path
        Pieces in the frame of the body that carries the cylinder.
    cylinder
        Where it is in that frame.
    find_contact
        `geodesic_contact` for the shortest path, `spiral_contact` for OpenSim's.
    """
    start, end = cylinder.inward(path.start), cylinder.inward(path.end)
    decision = decide(start, end, cylinder)
    contact = find_contact(start, end, cylinder, decision)
    crossing = path.eligible & (decision.mandatory | decision.possible)
    wraps = crossing & contact.made
    straight = end - start
    longer = contact.total - straight.norm()
    # Mandatory ones come first, in their order; the others by how much longer they make the path.
    order = jnp.arange(path.eligible.shape[-1])
    rank = jnp.where(decision.mandatory, order - 1e6, longer)
    rank = jnp.where(wraps, rank, jnp.inf)
    chosen = wraps & (order == jnp.argmin(rank, axis=-1))

    first_pull = cylinder.turn_outward(contact.start_pull)
    last_pull = cylinder.turn_outward(contact.end_pull)
    straight_pull = cylinder.turn_outward(straight.unit())
    # The surface stands still: what moves are the ends, towards it or away.
    at_start, at_end = (first_pull - straight_pull).at(None), (last_pull - straight_pull).at(None)
    change = at_start.dot(path.start_velocity) - at_end.dot(path.end_velocity)
    margins = Margins(
        inside=jnp.min(jnp.where(path.eligible, decision.clearance, FREE), axis=-1),
        off_end=jnp.min(jnp.where(crossing, contact.off_end, FREE), axis=-1),
        long_wrap=jnp.min(jnp.where(wraps, HALF_TURN - jnp.abs(contact.turn), FREE), axis=-1),
    )
    at_starts = jnp.where(path.eligible, decision.start_clearance, FREE)
    at_last = jnp.where(jnp.any(path.eligible, axis=-1), decision.end_clearance[..., -1], FREE)
    others = jnp.stack([at_last, margins.off_end, cylinder.radius * margins.long_wrap], axis=-1)
    return WrappedPath(
        length=path.length + jnp.sum(jnp.where(chosen, longer, 0.0), axis=-1),
        moment_arm=path.moment_arm + jnp.sum(jnp.where(chosen[None], change, 0.0), axis=-1),
        on_surface=jnp.sum(jnp.where(chosen, contact.length, 0.0), axis=-1, keepdims=True),
        margins=margins,
        clearances=jnp.concatenate([at_starts, others], axis=-1),
    )


def unwrapped(path: StraightPath) -> WrappedPath:
    """Leave a path straight."""
    free = jnp.full(path.length.shape, FREE)
    return WrappedPath(
        length=path.length,
        moment_arm=path.moment_arm,
        on_surface=jnp.zeros((*path.length.shape, 0)),
        margins=Margins(free, free, free),
        clearances=jnp.zeros((*path.length.shape, 0)),
    )
