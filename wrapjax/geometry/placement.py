"""From a model and poses to what the wrapping formulas take: pieces of path in a surface's frame."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.geometry.surfaces import Surface, surface
from wrapjax.geometry.vectors import vector
from wrapjax.geometry.wrapping import StraightPath
from wrapjax.skeleton import BodyMotion, PathPoints
from wrapjax.skeleton.description import Muscle, WrapObject


def straight_path(
    muscle: Muscle, points: PathPoints, carrier: BodyMotion, wrap_range: tuple[int, int]
) -> StraightPath:
    """Lay a path straight from point to point, and name the pieces that may wrap.

    Parameters
    ----------
    carrier
        The body that carries the wrap object: pieces are in its frame.
    wrap_range
        First and last point, 0-based, of the stretch that may wrap.
    """
    position, velocity = _in_frame_of(points, carrier)
    way, rate = np.diff(position, axis=1), np.diff(velocity, axis=2)
    length = np.linalg.norm(way, axis=-1)
    along = np.einsum("psk,pcsk->pcs", way / length[..., None], rate)
    first, last = wrap_range
    return StraightPath(
        length=jnp.asarray(length.sum(axis=-1)),
        moment_arm=jnp.asarray(-along.sum(axis=-1)),
        start=vector(position[:, first:last]),
        end=vector(position[:, first + 1 : last + 1]),
        start_velocity=vector(velocity[:, :, first:last]),
        end_velocity=vector(velocity[:, :, first + 1 : last + 1]),
        eligible=jnp.ones((len(position), last - first), dtype=bool),
    )


def surface_of(wrap: WrapObject) -> Surface:
    """Take a cylinder from a model's description."""
    assert wrap.radius is not None and wrap.length is not None
    rotation = _rotation(wrap.xyz_body_rotation)
    return surface(rotation, np.asarray(wrap.translation), wrap.radius, wrap.length, wrap.quadrant)


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
