"""Muscle constants, activation dynamics and muscle force.

Activation: neural drive, delayed by the electromechanical delay, passes a critically damped second-order
twitch (Milner-Brown et al. 1973, doi:10.1113/jphysiol.1973.sp010087) and an exponential shape (Buchanan et
al. 2004, doi:10.1123/jab.20.4.367).  Force: Hill-type muscle with rigid tendon and constant fiber thickness,
so that pennation changes with length (Zajac 1989).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import fftconvolve

from . import anatomy
from .curves import Curves, active, passive, velocity

RATE = 200.0


@dataclass(frozen=True)
class Constants:
    """Constants of all muscles, one array entry per muscle.

    Attributes
    ----------
    fmax, lo, ls, pennation : ndarray
        Maximum isometric force (N), optimal fiber length (m), tendon slack length (m), pennation (rad).
    vmax : ndarray
        Maximum shortening velocity in optimal lengths per second.
    delay, twitch : ndarray
        Electromechanical delay (s) and twitch time constant (s).
    shape : ndarray
        Exponent of the activation shape, negative.
    curves : Curves
        Constants of the curves.
    """

    fmax: np.ndarray
    lo: np.ndarray
    ls: np.ndarray
    pennation: np.ndarray
    vmax: np.ndarray
    delay: np.ndarray
    twitch: np.ndarray
    shape: np.ndarray
    curves: Curves = field(default_factory=Curves)

    def with_(self, **changes: Any) -> Constants:
        """Return a copy with some constants changed."""
        return replace(self, **changes)


def generic_constants(lengths_at_mean: np.ndarray) -> Constants:
    """Return generic constants with the tendon slack length that puts each fiber at its textbook length.

    Parameters
    ----------
    lengths_at_mean : ndarray
        Length of each muscle-tendon unit in the mean posture of walking.

    Returns
    -------
    Constants
        Generic constants.
    """
    rows = list(anatomy.MUSCLES.values())
    fmax, lo = (np.array([r[i] for r in rows], float) for i in (0, 1))
    pen = np.radians([r[2] for r in rows])
    fiber = np.array([r[3] for r in rows]) * lo
    ls = lengths_at_mean - np.sqrt(fiber**2 - (lo * np.sin(pen)) ** 2)
    one = np.ones(len(rows))
    return Constants(fmax, lo, ls, pen, 10.0 * one, 0.04 * one, 0.02 * one, -1.0 * one)


def kernel(delay: float, twitch: float, rate: float = RATE) -> np.ndarray:
    """Return the sampled impulse response of delay and twitch, with unit sum."""
    n = int(np.ceil((delay + 9 * twitch) * rate)) + 2
    fine = np.arange(n * 8) / (8 * rate) - delay
    response = np.where(fine > 0, fine * np.exp(-np.maximum(fine, 0) / twitch), 0.0)
    taps = response.reshape(n, 8).mean(axis=1)
    return taps / taps.sum()


def twitch_filter(drive: np.ndarray, delay: np.ndarray, twitch: np.ndarray) -> np.ndarray:
    """Return the filtered drive of each muscle; the value before the record is the first sample.

    Parameters
    ----------
    drive : ndarray
        Neural drive, shape (T, M).
    delay, twitch : ndarray
        Per muscle.

    Returns
    -------
    ndarray
        Filtered drive, shape (T, M).
    """
    pad = 120
    out = np.empty_like(drive)
    held = np.concatenate([np.repeat(drive[:1], pad, axis=0), drive])
    for j in range(drive.shape[1]):
        taps = kernel(float(delay[j]), float(twitch[j]))
        out[:, j] = fftconvolve(held[:, j], taps)[pad : pad + len(drive)]
    return np.maximum(out, 0.0)


def activation_shape(u: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return the activation for a filtered drive."""
    return np.expm1(shape * u) / np.expm1(shape)


def fiber(lmt: np.ndarray, c: Constants) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normalised fiber length, normalised velocity and cosine of pennation with a rigid tendon."""
    thick = c.lo * np.sin(c.pennation)
    along = np.maximum(lmt - c.ls, 0.05 * c.lo)
    length = np.hypot(along, thick)
    v = np.gradient(length, 1.0 / RATE, axis=0) / (c.lo * c.vmax)
    return length / c.lo, v, along / length


def unit_forces(lmt: np.ndarray, c: Constants) -> tuple[np.ndarray, np.ndarray]:
    """Return tendon force per unit activation and passive tendon force, (T, M), with a rigid tendon."""
    length, v, cosine = fiber(lmt, c)
    gain = c.fmax * cosine * active(length, c.curves) * velocity(v, c.curves)
    return gain, c.fmax * cosine * passive(length, c.curves)
