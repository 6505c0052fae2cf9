"""Geodesics of given length on spheres, ellipsoids and tori, for drawing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

# Vertices per step of the integration.
_VERTICES = 2
# Length (m) below which a vector has no direction.
_NO_LENGTH = 1e-9


def geodesic_arc(
    kind: str,
    sizes: Sequence[float],
    ends: Float[np.ndarray, "2 3"],
    direction: Float[np.ndarray, " 3"],
    length: float,
    vertices: int,
) -> Float[np.ndarray, "vertex 3"]:
    """Sample the geodesic that leaves a point of a surface in a given direction.

    The equation ``x'' = -(x' H x') g / |g|^2``, with gradient g and Hessian H of the surface's function, is
    integrated by the classical Runge-Kutta method, and interpolated by cubic polynomials with its tangents.
    The remaining distance from the known last point, some micrometers, is distributed over the arc.

    Parameters
    ----------
    kind
        ``sphere``, ``ellipsoid`` or ``torus``, in its own frame.
    sizes
        Semi-axes of a sphere or an ellipsoid; radii of a torus' ring and tube, m.
    ends
        First and last point, m.
    direction
        Direction at the first point, of any length. If it has none, the arc starts towards the last point.
    length
        Length of the arc, m.
    vertices
        Number of vertices after the first.
    """
    first, last = ends
    if np.linalg.norm(direction) < _NO_LENGTH:
        direction = last - first
    gradient, _ = _derivatives(kind, sizes, first, direction)
    normal = gradient / np.linalg.norm(gradient)
    tangent = direction - normal * (normal @ direction)
    size = np.linalg.norm(tangent)
    if size < _NO_LENGTH or length < _NO_LENGTH:
        return np.stack([first, last])

    def rate(state: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "2 3"]:
        gradient, bend = _derivatives(kind, sizes, state[0], state[1])
        return np.stack([state[1], -bend * gradient / (gradient @ gradient)])

    steps = -(-vertices // _VERTICES)
    states, step = [np.stack([first, tangent / size])], length / steps
    for _ in range(steps):
        state = states[-1]
        one = rate(state)
        two = rate(state + 0.5 * step * one)
        three = rate(state + 0.5 * step * two)
        four = rate(state + step * three)
        states.append(state + step / 6.0 * (one + 2.0 * two + 2.0 * three + four))
    points, tangents = np.stack(states, axis=1)
    share = np.linspace(0.0, 1.0, vertices + 1)
    arc = CubicHermiteSpline(np.linspace(0.0, 1.0, steps + 1), points, length * tangents)(share)
    return arc + share[:, None] * (last - points[-1])


def _derivatives(
    kind: str, sizes: Sequence[float], point: Float[np.ndarray, " 3"], along: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """Gradient of the surface's function, and its second derivative along a direction."""
    if kind == "torus":
        distance = np.hypot(point[0], point[1])
        outward = np.array([point[0], point[1], 0.0]) / distance
        aside = distance - sizes[0]
        gradient = 2.0 * aside * outward + np.array([0.0, 0.0, 2.0 * point[2]])
        outwards = outward @ along
        around = along[0] ** 2 + along[1] ** 2 - outwards**2
        return gradient, float(2.0 * (outwards**2 + aside / distance * around + along[2] ** 2))
    inverse = 1.0 / np.square(np.asarray(sizes, dtype=float))
    return 2.0 * point * inverse, float(2.0 * np.sum(along**2 * inverse))
