"""Kinematic chain of one leg, lengths and moment arms of its muscles.

All quantities are those of a right leg; a left leg is mirrored when files are written.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from . import anatomy


@dataclass
class Cylinder:
    """A cylinder with axis along z of its body.

    Attributes
    ----------
    body : int
        Index of the body.
    centre : ndarray
        Centre in the body, m.
    radius : float
        Radius, m.
    side : int
        +1 when the path passes in front (+x), -1 when behind.
    """

    body: int
    centre: np.ndarray
    radius: float
    side: int


@dataclass
class Leg:
    """Geometry and inertia of a leg.

    Attributes
    ----------
    joints, axes : dict
        Joint centres (m, in the parent body) and axes of knee, ankle and subtalar joint.
    segments : dict
        Mass, centre of mass and principal inertia of each body.
    paths : dict
        For each muscle the bodies (n,) and points (n, 3) of its path.
    wraps : dict
        For each muscle the name of its cylinder and the index of the point before it, or None.
    cylinders : dict
        Cylinders by name.
    knee_sign : int
        +1 when flexion of the knee is the positive direction of ``knee_angle``, else -1.
    """

    joints: dict[str, np.ndarray]
    axes: dict[str, np.ndarray]
    segments: dict[str, tuple[float, np.ndarray, np.ndarray]]
    paths: dict[str, tuple[np.ndarray, np.ndarray]]
    wraps: dict[str, tuple[str, int] | None]
    cylinders: dict[str, Cylinder]
    knee_sign: int = 1
    notes: dict[str, float] = field(default_factory=dict)

    def copy(self) -> Leg:
        """Return an independent copy."""
        return copy.deepcopy(self)


def generic_leg(
    scale: np.ndarray | None = None, mass: float = anatomy.GENERIC_MASS, knee_sign: int = 1
) -> Leg:
    """Return the generic leg with each body scaled by a factor.

    Parameters
    ----------
    scale : ndarray, optional
        One factor per body.
    mass : float
        Body mass in kg.
    knee_sign : int
        Sign of knee flexion.

    Returns
    -------
    Leg
        Scaled generic leg.
    """
    k = np.ones(5) if scale is None else np.asarray(scale, float)
    joints = {n: np.array(v) * k[i] for i, (n, v) in enumerate(anatomy.JOINTS.items())}
    axes = {n: np.array(v) / np.linalg.norm(v) for n, v in anatomy.AXES.items()}
    axes["knee"] = axes["knee"] * knee_sign
    m = mass / anatomy.GENERIC_MASS
    segments = {
        n: (mi * m, np.array(c) * k[i], np.array(inertia) * m * k[i] ** 2)
        for i, (n, (mi, c, inertia)) in enumerate(anatomy.SEGMENTS.items())
    }
    paths, wraps = {}, {}
    for name, (_, _, _, _, points, wrap) in anatomy.MUSCLES.items():
        bodies = np.array([p[0] for p in points])
        paths[name] = (bodies, np.array([p[1:] for p in points]) * k[bodies][:, None])
        wraps[name] = wrap
    cylinders = {
        n: Cylinder(b, np.array(c) * k[b], r * k[b], s) for n, (b, c, r, s) in anatomy.CYLINDERS.items()
    }
    return Leg(joints, axes, segments, paths, wraps, cylinders, knee_sign)


def rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the rotation matrices about a fixed axis, shape (T, 3, 3) (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * k + (1 - c) * (k @ k)


def frames(leg: Leg, q: np.ndarray, pelvis: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations and origins of all bodies in the ground frame.

    Parameters
    ----------
    leg : Leg
        The leg.
    q : ndarray
        Leg coordinates in rad, shape (T, 6).
    pelvis : ndarray, optional
        Pelvis coordinates (rad, m), shape (T, 6); the pelvis frame is the ground when left out.

    Returns
    -------
    tuple of ndarray
        Rotations (T, 5, 3, 3) and origins (T, 5, 3).
    """
    n = len(q)
    ex, ey, ez = np.eye(3)
    rot, org = np.empty((n, 5, 3, 3)), np.zeros((n, 5, 3))
    if pelvis is None:
        rot[:, 0] = np.eye(3)
    else:
        rot[:, 0] = rotation(ez, pelvis[:, 0]) @ rotation(ex, pelvis[:, 1]) @ rotation(ey, pelvis[:, 2])
        org[:, 0] = pelvis[:, 3:]
    hip = rotation(ez, q[:, 0]) @ rotation(ex, q[:, 1]) @ rotation(ey, q[:, 2])
    steps = [hip] + [rotation(leg.axes[a], q[:, 3 + i]) for i, a in enumerate(("knee", "ankle", "subtalar"))]
    for i, (name, step) in enumerate(zip(leg.joints, steps, strict=True)):
        org[:, i + 1] = org[:, i] + rot[:, i] @ leg.joints[name]
        rot[:, i + 1] = rot[:, i] @ step
    return rot, org


def joint_axes(leg: Leg, q: np.ndarray, rot: np.ndarray, org: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an axis and a point on it for each leg coordinate, in the ground frame, (T, 6, 3)."""
    ex, ey, ez = np.eye(3)
    first = rotation(ez, q[:, 0])
    second = first @ rotation(ex, q[:, 1])
    axes = np.empty((len(q), 6, 3))
    axes[:, 0] = rot[:, 0] @ ez
    axes[:, 1] = np.einsum("tij,tj->ti", rot[:, 0], first @ ex)
    axes[:, 2] = np.einsum("tij,tj->ti", rot[:, 0], second @ ey)
    for i, name in enumerate(("knee", "ankle", "subtalar")):
        axes[:, 3 + i] = rot[:, i + 1] @ leg.axes[name]
    points = org[:, [1, 1, 1, 2, 3, 4]]
    return axes, points


def wrapped_length(a: np.ndarray, b: np.ndarray, radius: float, side: int) -> np.ndarray:
    """Return the length of the shortest path from a to b around a cylinder with axis z at the origin.

    The path passes on the given side (sign of x) when a lies above b.  In the plane it is two tangents and an
    arc; along the axis it climbs in proportion to the planar length, which is the geodesic.

    Parameters
    ----------
    a, b : ndarray
        End points, shape (T, 3).
    radius : float
        Radius of the cylinder.
    side : int
        +1 or -1.

    Returns
    -------
    ndarray
        Length, shape (T,).
    """
    ax, ay, bx, by = a[:, 0] * side, a[:, 1], b[:, 0] * side, b[:, 1]
    ra, rb = np.hypot(ax, ay), np.hypot(bx, by)
    straight = np.hypot(bx - ax, by - ay)
    offset = -(ax * (by - ay) - ay * (bx - ax)) / np.maximum(straight, 1e-12)
    cos_a, cos_b = np.minimum(radius / ra, 1.0), np.minimum(radius / rb, 1.0)
    # Angles decrease from a to b when the path passes in front (clockwise seen from +z).
    angle = np.arctan2(ay, ax) - np.arctan2(by, bx)
    angle = np.mod(angle + 0.5 * np.pi, 2 * np.pi) - 0.5 * np.pi
    arc = angle - np.arccos(cos_a) - np.arccos(cos_b)
    touches = (offset < radius) & (arc > 0) & (ra > radius) & (rb > radius)
    tangents = np.sqrt(np.maximum(ra**2 - radius**2, 0)) + np.sqrt(np.maximum(rb**2 - radius**2, 0))
    planar = np.where(touches, tangents + radius * np.maximum(arc, 0), straight)
    return np.hypot(planar, b[:, 2] - a[:, 2])


def muscle_length(leg: Leg, name: str, rot: np.ndarray, org: np.ndarray) -> np.ndarray:
    """Return the length of one muscle-tendon unit in every frame."""
    bodies, points = leg.paths[name]
    world = [org[:, b] + rot[:, b] @ p for b, p in zip(bodies, points, strict=True)]
    wrap = leg.wraps[name]
    total = np.zeros(len(rot))
    for i in range(len(world) - 1):
        if wrap is not None and wrap[1] == i:
            cyl = leg.cylinders[wrap[0]]
            back = np.swapaxes(rot[:, cyl.body], 1, 2)
            local = [
                np.einsum("tij,tj->ti", back, w - org[:, cyl.body]) - cyl.centre
                for w in (world[i], world[i + 1])
            ]
            total += wrapped_length(local[0], local[1], cyl.radius, cyl.side)
        else:
            total += np.linalg.norm(world[i + 1] - world[i], axis=1)
    return total


def geometry(
    leg: Leg, q: np.ndarray, names: tuple[str, ...] = anatomy.NAMES, step: float = 1e-4
) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths (T, M) and moment arms (T, M, 6), the arm being minus the derivative of the length."""
    lengths = np.stack([muscle_length(leg, m, *frames(leg, q)) for m in names], axis=1)
    arms = np.zeros((*lengths.shape, 6))
    first = [1, 1, 1, 2, 3, 4]
    for k in range(6):
        dq = np.zeros(6)
        dq[k] = step
        plus, minus = frames(leg, q + dq), frames(leg, q - dq)
        for j, m in enumerate(names):
            bodies = leg.paths[m][0]
            if bodies.min() < first[k] <= bodies.max():
                difference = muscle_length(leg, m, *plus) - muscle_length(leg, m, *minus)
                arms[:, j, k] = -difference / (2 * step)
    return lengths, arms
