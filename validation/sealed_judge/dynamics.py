"""Inverse dynamics of the leg by the moment of momentum of its segments about each joint axis."""

from __future__ import annotations

import numpy as np

from . import anatomy
from .leg import Leg, frames, joint_axes
from .muscle import RATE

GRAVITY = np.array([0.0, -9.80665, 0.0])


def inertial_moments(leg: Leg, q: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """Return the moments that move the leg without ground contact.

    Parameters
    ----------
    leg : Leg
        The leg.
    q, pelvis : ndarray
        Coordinates sampled at RATE, shapes (T, 6).

    Returns
    -------
    ndarray
        Generalised forces of the leg coordinates, shape (T, 6).
    """
    rot, org = frames(leg, q, pelvis)
    axes, points = joint_axes(leg, q, rot, org)
    dt = 1.0 / RATE
    out = np.zeros((len(q), 6))
    first = np.array([1, 1, 1, 2, 3, 4])
    for body in range(1, 5):
        mass, com, inertia = leg.segments[anatomy.BODIES[body]]
        r = rot[:, body]
        centre = org[:, body] + r @ com
        force = mass * (np.gradient(np.gradient(centre, dt, axis=0), dt, axis=0) - GRAVITY)
        spin = np.gradient(r, dt, axis=0) @ np.swapaxes(r, 1, 2)
        omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        momentum = np.einsum("tij,tj->ti", r * inertia, np.einsum("tji,tj->ti", r, omega))
        couple = np.gradient(momentum, dt, axis=0)
        moment = np.cross(centre[:, None] - points, force[:, None]) + couple[:, None]
        out += np.einsum("tki,tki->tk", axes, moment) * (first <= body)
    return out


def contact_map(leg: Leg, q: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """Return the matrix from a wrench about the ground origin to generalised forces, (T, 6, 6)."""
    rot, org = frames(leg, q, pelvis)
    axes, points = joint_axes(leg, q, rot, org)
    # axis . (moment - point x force) = axis . moment + (point x axis) . force
    return np.concatenate([np.cross(points, axes), axes], axis=2)


def wrench(force: np.ndarray, cop: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return force and moment about the ground origin, shape (T, 6); ``free`` is the vertical free moment."""
    moment = np.cross(cop, force)
    moment[:, 1] += free
    return np.concatenate([force, moment], axis=1)


def inverse_dynamics(
    leg: Leg, q: np.ndarray, pelvis: np.ndarray, force: np.ndarray, cop: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """Return the joint moments that balance inertia, weight and ground reaction, shape (T, 6)."""
    contact = np.einsum("tij,tj->ti", contact_map(leg, q, pelvis), wrench(force, cop, free))
    return inertial_moments(leg, q, pelvis) - contact
