"""Inputs of the wrapping functions: path segments, path points and cylinders, from a model's description."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.kinematics import BodyMotion, PathPoints
from wrapjax.geometry.model_description import Muscle, PathWrap, WrapObject
from wrapjax.geometry.path_on_cylinders import PointsAndBodies
from wrapjax.geometry.vectors import vector
from wrapjax.geometry.wrapping import StraightPath, Surface


def straight_path(
    muscle: Muscle, points: PathPoints, carrier: BodyMotion, wrap: PathWrap | None
) -> StraightPath:
    """Compute a path straight from point to point, and its segments that may wrap round one cylinder.

    Parameters
    ----------
    muscle
        Muscle of the path.
    points
        Path points in every pose, in ground's frame.
    carrier
        Motion of the body that carries the cylinder; segments are given in its frame.
    wrap
        Entry of the cylinder in the muscle's path; None for a path without a cylinder.
    """
    position, velocity = _in_frame_of(_with_inactive_merged(points), carrier)
    segment, rate = np.diff(position, axis=1), np.diff(velocity, axis=2)
    length = np.linalg.norm(segment, axis=-1)
    along = np.einsum("psk,pcsk->pcs", segment / np.maximum(length, 1e-300)[..., None], rate)
    first, last = (0, 0) if wrap is None else _wrapping_range(muscle, wrap)
    return StraightPath(
        length=jnp.asarray(length.sum(axis=-1)),
        moment_arm=jnp.asarray(-along.sum(axis=-1)),
        start=vector(position[:, first:last]),
        end=vector(position[:, first + 1 : last + 1]),
        start_velocity=vector(velocity[:, :, first:last]),
        end_velocity=vector(velocity[:, :, first + 1 : last + 1]),
        eligible=jnp.asarray(_eligible(points.active, first, last)),
    )


def points_and_bodies(
    muscle: Muscle,
    points: PathPoints,
    carriers: Sequence[tuple[str, BodyMotion]],
    wraps: Sequence[PathWrap],
) -> PointsAndBodies:
    """Collect a path's points and the bodies that carry its cylinders, in ground's frame.

    Parameters
    ----------
    muscle
        Muscle of the path.
    points
        Path points in every pose, in ground's frame.
    carriers
        Name and motion of the body that carries each cylinder.
    wraps
        Entries of the cylinders in the muscle's path.
    """
    poses = len(points.position)
    names = dict.fromkeys([*points.bodies, *(name for name, _ in carriers)])
    numbers = {name: number for number, name in enumerate(names)}
    ranges = [_wrapping_range(muscle, wrap) for wrap in wraps]
    merged = _with_inactive_merged(points)

    def repeated(values: list[int]) -> Int[Array, "pose entry"]:
        return jnp.tile(jnp.asarray(values), (poses, 1))

    def active_ends(end: str) -> Int[Array, "pose wrap"]:
        place = np.arange(len(points.bodies))
        columns = []
        for first, last in ranges:
            inside = points.active & (place >= first) & (place <= last)
            backwards = end == "last"
            found = np.argmax(inside[:, ::-1] if backwards else inside, axis=1)
            columns.append(len(place) - 1 - found if backwards else found)
        return jnp.asarray(np.stack(columns, axis=1))

    return PointsAndBodies(
        position=jnp.asarray(merged.position),
        velocity=jnp.asarray(merged.velocity),
        point_body=repeated([numbers[name] for name in points.bodies]),
        rotation=jnp.stack([motion.rotation for _, motion in carriers], axis=1),
        origin=jnp.stack([motion.origin for _, motion in carriers], axis=1),
        angular=jnp.stack([motion.angular for _, motion in carriers], axis=2),
        linear=jnp.stack([motion.linear for _, motion in carriers], axis=2),
        wrap_body=repeated([numbers[name] for name, _ in carriers]),
        first_point=active_ends("first"),
        last_point=active_ends("last"),
    )


def surfaces_of(wraps: Sequence[WrapObject]) -> Surface:
    """Convert cylinders of a model's description; the first axis of all leaves is ``wrap``."""
    axes = [wrap.quadrant.lstrip("+-") for wrap in wraps]
    unrestricted = [axis == "all" for axis in axes]
    negative = [wrap.quadrant.startswith("-") for wrap in wraps]
    return Surface(
        rotation=jnp.asarray([_rotation(wrap.xyz_body_rotation) for wrap in wraps]).reshape(-1, 3, 3),
        center=jnp.asarray([wrap.translation for wrap in wraps]).reshape(-1, 3),
        radius=jnp.asarray([wrap.radius for wrap in wraps], dtype=float),
        length=jnp.asarray([wrap.length for wrap in wraps], dtype=float),
        side_axis=jnp.asarray([0 if axis == "all" else "xy".index(axis) for axis in axes], dtype=int),
        side=jnp.asarray(np.where(unrestricted, 0, np.where(negative, -1, 1)), dtype=int),
    )


def _in_frame_of(
    points: PathPoints, carrier: BodyMotion
) -> tuple[Float[np.ndarray, "pose point 3"], Float[np.ndarray, "pose coordinate point 3"]]:
    """Transform positions, and velocities relative to the body, to the body's frame."""
    arm = points.position - carrier.origin[:, None]
    carried = carrier.linear[:, :, None] + np.cross(carrier.angular[:, :, None], arm[:, None])
    position = np.einsum("pji,psj->psi", carrier.rotation, arm)
    velocity = np.einsum("pji,pcsj->pcsi", carrier.rotation, points.velocity - carried)
    return position, velocity


def _rotation(angles: tuple[float, float, float]) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of OpenSim's body-fixed x-y-z angles (rad)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def _wrapping_range(muscle: Muscle, wrap: PathWrap) -> tuple[int, int]:
    """First and last point, 0-based, of the part of the path that may wrap."""
    last = len(muscle.points) if wrap.last_point < 1 else wrap.last_point
    return max(wrap.first_point, 1) - 1, last - 1


def _with_inactive_merged(points: PathPoints) -> PathPoints:
    """Move inactive points to the active point before them or, at the path's beginning, after them."""
    place = np.arange(points.active.shape[1])
    before = np.maximum.accumulate(np.where(points.active, place, -1), axis=1)
    source = np.where(before < 0, np.argmax(points.active, axis=1)[:, None], before)
    position = np.take_along_axis(points.position, source[:, :, None], axis=1)
    velocity = np.take_along_axis(points.velocity, source[:, None, :, None], axis=2)
    return replace(points, position=position, velocity=velocity)


def _eligible(
    active: Bool[np.ndarray, "pose point"], first: int, last: int
) -> Bool[np.ndarray, "pose segment"]:
    """Whether a segment of the range lies between two active points of the range."""
    inside = active[:, first : last + 1]
    # The segment's end is active, and an active point comes before it.
    after_active = np.cumsum(inside, axis=1)[:, :-1] > 0
    return inside[:, 1:] & after_active
