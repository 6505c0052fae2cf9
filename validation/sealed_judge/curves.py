"""Normalised muscle and tendon curves with the constants of Millard et al. 2013 (doi:10.1115/1.4023390).

The published curves are quintic Bezier splines.  The pieces used here pass through the same published values
and slopes: quintic Hermite pieces for active force and length, power laws for passive force and tendon, a
hyperbola and a saturating exponential for force and velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Curves:
    """Constants of the curves; each may be a number or an array over muscles.

    Attributes
    ----------
    width : float or ndarray
        Factor on the distance of the active curve's nodes from the optimal length (1: published).
    passive_strain : float or ndarray
        Fiber strain at which passive force equals the maximum isometric force.
    slope : float or ndarray
        Isometric slope of the force-velocity curve on the shortening side.
    plateau : float or ndarray
        Greatest force while lengthening, relative to isometric.
    """

    width: float | np.ndarray = 1.0
    passive_strain: float | np.ndarray = 0.7
    slope: float | np.ndarray = 5.0
    plateau: float | np.ndarray = 1.4

    def with_(self, **changes: float | np.ndarray) -> Curves:
        """Return a copy with some constants changed."""
        return replace(self, **changes)


# Length, value, slope of the active curve (Millard et al. 2013, table of defaults; value at 0.73 follows from
# the published shallow slope 0.8616 rounded at the top).
_NODES = ((0.4441, 0.0, 0.0), (0.73, 0.79, 0.8616), (1.0, 1.0, 0.0), (1.8123, 0.0, 0.0))


def _quintic(x: np.ndarray, left: tuple, right: tuple) -> np.ndarray:
    """Quintic Hermite piece with given values and slopes and zero curvature at both ends."""
    h = right[0] - left[0]
    t = np.clip((x - left[0]) / h, 0.0, 1.0)
    b = 10 * t**3 - 15 * t**4 + 6 * t**5
    s0 = t - 6 * t**3 + 8 * t**4 - 3 * t**5
    s1 = -4 * t**3 + 7 * t**4 - 3 * t**5
    return left[1] + (right[1] - left[1]) * b + h * (left[2] * s0 + right[2] * s1)


def active(length: np.ndarray, curves: Curves) -> np.ndarray:
    """Return the active force at a normalised fiber length."""
    x = 1.0 + (length - 1.0) / curves.width
    out = np.zeros_like(x)
    for left, right in pairwise(_NODES):
        inside = (x >= left[0]) & (x < right[0])
        out = np.where(inside, _quintic(x, left, right), out)
    return np.maximum(out, 0.0)


def passive(length: np.ndarray, curves: Curves) -> np.ndarray:
    """Return the passive force: quadratic up to the maximum force (slope there 2 / strain), then straight."""
    e = np.maximum(length - 1.0, 0.0) / curves.passive_strain
    return np.where(e < 1.0, e**2, 2.0 * e - 1.0)


def velocity(v: np.ndarray, curves: Curves) -> np.ndarray:
    """Return the force-velocity factor; v is a share of the maximum velocity, shortening negative."""
    c = 1.0 / (curves.slope - 1.0)
    shortening = np.maximum(1.0 + v, 0.0) / (1.0 - np.minimum(v, 0.0) / c)
    rise = curves.plateau - 1.0
    lengthening = 1.0 + rise * (1.0 - np.exp(-curves.slope * np.maximum(v, 0.0) / rise))
    return np.where(v < 0, shortening, lengthening)


def tendon(strain: np.ndarray, strain_at_fmax: np.ndarray) -> np.ndarray:
    """Return the tendon force: power-law toe up to 2/3 of the maximum force, then slope 1.375 / strain."""
    toe = strain_at_fmax * (1.0 - (1.0 - 0.667) / 1.375)
    e = np.maximum(strain, 0.0)
    power = 1.375 * toe / strain_at_fmax / 0.667
    low = 0.667 * (np.minimum(e, toe) / toe) ** power
    return np.where(e < toe, low, 0.667 + 1.375 * (e - toe) / strain_at_fmax)


def tendon_strain(force: np.ndarray, strain_at_fmax: np.ndarray) -> np.ndarray:
    """Return the strain of a tendon under a normalised force (inverse of :func:`tendon`)."""
    toe = strain_at_fmax * (1.0 - (1.0 - 0.667) / 1.375)
    power = 1.375 * toe / strain_at_fmax / 0.667
    f = np.maximum(force, 0.0)
    return np.where(f < 0.667, toe * (f / 0.667) ** (1 / power), toe + (f - 0.667) * strain_at_fmax / 1.375)
