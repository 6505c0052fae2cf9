"""Families of muscle curves and activation dynamics.

`millard` (OpenSim's Millard 2012 curves and a two-stage twitch) is reserved for the test banks; the
development bank uses `thelen` and `spline`, and the bank of worlds also `polynomial` and `gordon`. Arguments
of all curves are fiber lengths in optimal fiber lengths and velocities in maximum velocities, positive for
lengthening.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from validation.blind.opensim_leg import millard_tables

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Curves:
    """Normalized curves: active and passive force over length, force over velocity."""

    active: Curve
    velocity: Curve
    passive: Curve


@dataclass(frozen=True)
class Family:
    """Muscle curves with activation dynamics.

    ``rate`` returns the rate constants of the stages (1/s) from excitation, activation, rise time and ratio
    of fall to rise time. ``shape`` applies the activation nonlinearity, from linear (0) to strongest (1).
    """

    name: str
    curves: Callable[[], Curves]
    stages: int
    rate: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    shape: Callable[[np.ndarray, np.ndarray], np.ndarray]


#: Ratio of deactivation to activation time.
FALL_TO_RISE = 4.0


def _clipped(x: np.ndarray, y: np.ndarray) -> Curve:
    spline = CubicSpline(x, y)
    return lambda value: spline(np.clip(value, x[0], x[-1]))


def millard_curves() -> Curves:
    return Curves(**{name: _clipped(x, y) for name, (x, y) in millard_tables().items()})


def thelen_curves() -> Curves:
    """Build Gaussian, exponential and hyperbolic curves similar to Thelen 2003 (doi:10.1115/1.1531112)."""
    af, plateau = 0.28, 1.45

    def velocity(v):
        v = np.clip(v, -1.0, 1.5)
        slow = np.minimum(v, 0.0)
        shortening = (1.0 + slow) / (1.0 - slow / af)
        fast = np.maximum(v, 0.0)
        bend = (2.0 + 2.0 / af) * fast / (plateau - 1.0)
        lengthening = (1.0 + bend * plateau) / (1.0 + bend)
        return np.where(v < 0.0, shortening, lengthening)

    def passive(length):
        strain = np.clip(length - 1.0, 0.0, 0.9) / 0.6
        return np.expm1(4.0 * strain) / np.expm1(4.0)

    return Curves(lambda length: np.exp(-((length - 1.0) ** 2) / 0.42), velocity, passive)


def spline_curves() -> Curves:
    """Build piecewise polynomials similar to Blemker 2005 (doi:10.1016/j.jbiomech.2004.04.012)."""
    active = PchipInterpolator(
        [0.30, 0.45, 0.60, 0.75, 0.88, 1.00, 1.10, 1.25, 1.40, 1.55, 1.75, 2.2],
        [0.00, 0.14, 0.45, 0.78, 0.96, 1.00, 0.98, 0.82, 0.55, 0.27, 0.02, 0.0],
    )
    velocity = PchipInterpolator(
        [-1.2, -1.0, -0.8, -0.6, -0.4, -0.25, -0.12, -0.05, 0.0, 0.04, 0.1, 0.2, 0.4, 0.8, 1.2],
        [0.0, 0.0, 0.045, 0.115, 0.235, 0.39, 0.62, 0.82, 1.0, 1.13, 1.25, 1.35, 1.43, 1.49, 1.51],
    )

    def passive(length):
        stretched = np.clip(length - 1.0, 0.0, 1.2)
        toe = 0.05 * np.expm1(6.6 * np.minimum(stretched, 0.4))
        return toe + 0.05 * 6.6 * np.exp(6.6 * 0.4) * np.maximum(stretched - 0.4, 0.0)

    return Curves(lambda x: active(np.clip(x, 0.30, 2.2)), lambda v: velocity(np.clip(v, -1.2, 1.2)), passive)


def polynomial_curves() -> Curves:
    """Build the curves of EMG-driven models of the 1990s.

    Active force is a parabola (van Soest and Bobbert 1993, doi:10.1007/BF00198959), force over velocity the
    function of Schutte 1993, and passive force an exponential without a slack range.
    """

    def active(length):
        # A smooth corner where the parabola reaches zero.
        parabola = 1.0 - ((length - 1.0) / 0.56) ** 2
        return 0.02 * np.logaddexp(0.0, parabola / 0.02)

    def velocity(v):
        v = np.clip(v, -1.0, 1.2)
        return 0.1472 / (0.1074 + np.exp(-1.3 * np.sinh(2.8 * v + 1.64)))

    def passive(length):
        toe = np.exp(10.0 * (np.minimum(length, 1.6) - 1.5))
        return toe + 10.0 * np.e * np.maximum(length - 1.6, 0.0)

    return Curves(active, velocity, passive)


def gordon_curves() -> Curves:
    """Build piecewise linear active force (Gordon, Huxley and Julian 1966) and the curve of Hill and Katz.

    Lengths are those of human filaments (Walker and Schrodt 1974); corners are rounded. Katz 1939 found a
    steeper slope in lengthening than in shortening.
    """
    grid = np.linspace(0.2, 2.0, 721)
    corners = np.interp(grid, [0.47, 0.72, 0.94, 1.06, 1.58], [0.0, 0.80, 1.0, 1.0, 0.0])
    rounded = gaussian_filter1d(corners, 0.035 / (grid[1] - grid[0]), mode="nearest")
    active = _clipped(grid, rounded / rounded.max())

    def velocity(v):
        v = np.clip(v, -1.0, 1.2)
        slow, fast = np.minimum(v, 0.0), np.maximum(v, 0.0)
        shortening = (1.0 + slow) / (1.0 - slow / 0.22)
        slope = 3.0 * (1.0 + 1.0 / 0.22)
        lengthening = 1.0 + 0.7 * slope * fast / (0.7 + slope * fast)
        return np.where(v < 0.0, shortening, lengthening)

    def passive(length):
        stretched = np.clip(length - 0.95, 0.0, None) / 0.6
        return np.where(stretched < 1.3, stretched**3, 1.3**3 + 3.0 * 1.3**2 * (stretched - 1.3))

    return Curves(active, velocity, passive)


def _twitch(u, a, rise, fall):
    # Two equal stages, critically damped (Milner-Brown 1973): half the time constant each.
    return 2.0 / rise * (1.0 / fall + (1.0 - 1.0 / fall) * np.sqrt(np.clip(u, 0.0, 1.0)))


def _winters(u, a, rise, fall):
    slower = 0.5 + 1.5 * np.clip(a, 0.0, 1.0)
    # A smooth transition between rising and falling: a sudden one would oscillate.
    rising = 0.5 + 0.5 * np.tanh((u - a) / 0.02)
    return rising / (0.7 * rise * slower) + (1.0 - rising) * slower / (0.7 * rise * fall)


def _cascade(u, a, rise, fall):
    return 2.0 / rise * (1.0 / fall + (1.0 - 1.0 / fall) * u / (0.25 + 0.75 * u + 1e-9))


def _zajac(u, a, rise, fall):
    # One stage whose rate is linear in excitation (Zajac 1989).
    return (1.0 / fall + (1.0 - 1.0 / fall) * np.clip(u, 0.0, 1.0)) / rise


def _calcium(u, a, rise, fall):
    # Three stages; the release of calcium is sigmoid in excitation, similar to Hatze 1977.
    released = np.clip(u, 0.0, 1.0) ** 2
    return 3.0 / rise * (1.0 / fall + (1.0 - 1.0 / fall) * 1.09 * released / (released + 0.09))


def _exponential(a, bend):
    power = -(0.3 + 2.2 * bend)
    return np.expm1(power * a) / np.expm1(power)


def _logarithmic(a, bend):
    steep = 0.2 + 4.0 * bend
    return np.log1p(steep * a) / np.log1p(steep)


def _hyperbolic(a, bend):
    half = 4.0 - 3.2 * bend
    return a * (1.0 + half) / (a + half)


def _lloyd(a, bend):
    # Exponential with a shape factor between -3 and 0 (Lloyd and Besier 2003).
    factor = -(0.01 + 2.99 * bend)
    return np.expm1(factor * a) / np.expm1(factor)


def _parabolic(a, bend):
    return a * (1.0 + 0.6 * bend * (1.0 - a))


FAMILIES = {
    family.name: family
    for family in (
        Family("millard", millard_curves, 2, _twitch, _exponential),
        Family("thelen", thelen_curves, 1, _winters, _logarithmic),
        Family("spline", spline_curves, 2, _cascade, _hyperbolic),
        Family("polynomial", polynomial_curves, 1, _zajac, _lloyd),
        Family("gordon", gordon_curves, 3, _calcium, _parabolic),
    )
}
BANKS = {"test": ("millard",), "second_test": ("millard",), "development": ("thelen", "spline")}


def activate(
    family: Family, excitation: np.ndarray, rise: np.ndarray, fall: np.ndarray, step: float
) -> np.ndarray:
    """Compute activation before the nonlinearity, exactly for excitation that is constant within a step.

    Parameters
    ----------
    family
        Activation dynamics.
    excitation
        Excitation, (..., frame).
    rise, fall
        Rise time (s), and ratio of fall to rise time, (...).
    step
        Time step, s.
    """
    frames = np.moveaxis(np.ascontiguousarray(excitation), -1, 0)
    out = np.empty_like(frames)
    stages = [np.array(frames[0]) for _ in range(family.stages)]
    for index, u in enumerate(frames):
        keep = np.exp(-step * family.rate(u, stages[-1], rise, fall))
        target = u
        for order, value in enumerate(stages):
            stages[order] = target + (value - target) * keep
            target = stages[order]
        out[index] = target
    return np.moveaxis(out, 0, -1)
