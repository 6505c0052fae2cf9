"""From a model and poses to what the wrapping formulas take: pieces of path in a surface's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.kinematics import BodyMotion, PathPoints
from wrapjax.geometry.model_description import Muscle, PathWrap, WrapObject
from wrapjax.geometry.path_on_cylinders import PointsAndCarriers
from wrapjax.geometry.vectors import vector
from wrapjax.geometry.wrapping import StraightPath, Surface


def straight_path(
    muscle: Muscle, points: PathPoints, carrier: BodyMotion, wrap: PathWrap | None
) -> StraightPath:
    """Lay a path straight from point to point, and name the pieces that may wrap.

    Parameters
    ----------
    carrier
        The body that carries the cylinder: pieces are in its frame.
    wrap
        What the path says of its cylinder; None where it has none.
    """
    position, velocity = _in_frame_of(_filled(points), carrier)
    way, rate = np.diff(position, axis=1), np.diff(velocity, axis=2)
    length = np.linalg.norm(way, axis=-1)
    along = np.einsum("psk,pcsk->pcs", way / np.maximum(length, 1e-300)[..., None], rate)
    first, last = (0, 0) if wrap is None else _range(muscle, wrap)
    return StraightPath(
        length=jnp.asarray(length.sum(axis=-1)),
        moment_arm=jnp.asarray(-along.sum(axis=-1)),
        start=vector(position[:, first:last]),
        end=vector(position[:, first + 1 : last + 1]),
        start_velocity=vector(velocity[:, :, first:last]),
        end_velocity=vector(velocity[:, :, first + 1 : last + 1]),
        eligible=jnp.asarray(_eligible(points.active, first, last)),
    )


def points_and_carriers(
    muscle: Muscle,
    points: PathPoints,
    carriers: Sequence[tuple[str, BodyMotion]],
    wraps: Sequence[PathWrap],
) -> PointsAndCarriers:
    """Gather a path's points and the bodies that carry its cylinders, in ground's frame.

    Parameters
    ----------
    carriers
        Name and motion of each cylinder's body.
    wraps
        What the path says of each cylinder.
    """
    poses = len(points.position)
    names = dict.fromkeys([*points.bodies, *(name for name, _ in carriers)])
    numbers = {name: number for number, name in enumerate(names)}
    ranges = [_range(muscle, wrap) for wrap in wraps]
    filled = _filled(points)

    def repeated(values: list[int]) -> Int[Array, "pose entry"]:
        return jnp.tile(jnp.asarray(values), (poses, 1))

    def ends(end: str) -> Int[Array, "pose wrap"]:
        place = np.arange(len(points.bodies))
        columns = []
        for first, last in ranges:
            inside = points.active & (place >= first) & (place <= last)
            backwards = end == "last"
            found = np.argmax(inside[:, ::-1] if backwards else inside, axis=1)
            columns.append(len(place) - 1 - found if backwards else found)
        return jnp.asarray(np.stack(columns, axis=1))

    return PointsAndCarriers(
        position=jnp.asarray(filled.position),
        velocity=jnp.asarray(filled.velocity),
        point_body=repeated([numbers[name] for name in points.bodies]),
        rotation=jnp.stack([motion.rotation for _, motion in carriers], axis=1),
        origin=jnp.stack([motion.origin for _, motion in carriers], axis=1),
        angular=jnp.stack([motion.angular for _, motion in carriers], axis=2),
        linear=jnp.stack([motion.linear for _, motion in carriers], axis=2),
        wrap_body=repeated([numbers[name] for name, _ in carriers]),
        first_point=ends("first"),
        last_point=ends("last"),
    )


def surfaces_of(wraps: Sequence[WrapObject]) -> Surface:
    """Take cylinders from a model's description; leaves lead with ``wrap``."""
    axes = [wrap.quadrant.lstrip("+-") for wrap in wraps]
    whole = [axis == "all" for axis in axes]
    negative = [wrap.quadrant.startswith("-") for wrap in wraps]
    return Surface(
        rotation=jnp.asarray([_rotation(wrap.xyz_body_rotation) for wrap in wraps]).reshape(-1, 3, 3),
        center=jnp.asarray([wrap.translation for wrap in wraps]).reshape(-1, 3),
        radius=jnp.asarray([wrap.radius for wrap in wraps], dtype=float),
        length=jnp.asarray([wrap.length for wrap in wraps], dtype=float),
        side_axis=jnp.asarray([0 if axis == "all" else "xy".index(axis) for axis in axes], dtype=int),
        side=jnp.asarray(np.where(whole, 0, np.where(negative, -1, 1)), dtype=int),
    )


def _in_frame_of(
    points: PathPoints, carrier: BodyMotion
) -> tuple[Float[np.ndarray, "pose point 3"], Float[np.ndarray, "pose coordinate point 3"]]:
    """Positions and velocities as someone sees them who moves with the body."""
    arm = points.position - carrier.origin[:, None]
    carried = carrier.linear[:, :, None] + np.cross(carrier.angular[:, :, None], arm[:, None])
    position = np.einsum("pji,psj->psi", carrier.rotation, arm)
    velocity = np.einsum("pji,pcsj->pcsi", carrier.rotation, points.velocity - carried)
    return position, velocity


def _rotation(angles: tuple[float, float, float]) -> Float[np.ndarray, "3 3"]:
    """Turn about x, then the turned y, then the turned z, as OpenSim writes orientations."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_x @ about_y @ about_z


def _range(muscle: Muscle, wrap: PathWrap) -> tuple[int, int]:
    """First and last point, 0-based, of the stretch that may wrap."""
    last = len(muscle.points) if wrap.last_point < 1 else wrap.last_point
    return max(wrap.first_point, 1) - 1, last - 1


def _filled(points: PathPoints) -> PathPoints:
    """Lay inactive points on the active one before them (at the beginning: after them)."""
    place = np.arange(points.active.shape[1])
    before = np.maximum.accumulate(np.where(points.active, place, -1), axis=1)
    source = np.where(before < 0, np.argmax(points.active, axis=1)[:, None], before)
    position = np.take_along_axis(points.position, source[:, :, None], axis=1)
    velocity = np.take_along_axis(points.velocity, source[:, None, :, None], axis=2)
    return replace(points, position=position, velocity=velocity)


def _eligible(
    active: Bool[np.ndarray, "pose point"], first: int, last: int
) -> Bool[np.ndarray, "pose piece"]:
    """Whether a piece is between active points of the stretch: then its end is active, and not its first."""
    inside = active[:, first : last + 1]
    begun = np.cumsum(inside, axis=1)[:, :-1] > 0
    return inside[:, 1:] & begun
