"""Textbook curves of walking and one recording with natural variation between cycles.

Key points are rounded from Winter (1991, The Biomechanics and Motor Control of Human Gait) and Perry (1992,
Gait Analysis), for about 1.25 m/s, in per cent of the cycle from heel strike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from .leg import Leg, frames
from .muscle import RATE

NORMAL_SPEED = 1.25
_P = [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85, 90, 95]
#: Degrees: flexion and adduction of the hip, internal rotation, knee flexion, dorsiflexion, inversion.  Hip
#: flexion, adduction and knee flexion were shifted by up to 3 degrees in swing so that the swing moments are
#: Winter's.
ANGLES = (
    [29.5, 29.4, 27.1, 23.2, 18.2, 12.6, 7.1, 2, -3.2, -7.4,
     -10.5, -11, -5.7, 4.5, 16.3, 24.8, 29.6, 31.2, 30.7, 28.8],
    [0.4, 3.1, 4.8, 5.6, 5.8, 5.6, 5.3, 4.7, 3.9, 2.6,
     1.6, -1.1, -4.7, -4.5, -4.3, -4.3, -3.7, -2.7, -0.8, 0.9],
    [-1, 1, 2.5, 3, 3, 2.5, 2, 1.5, 1, 0.5, 0, -1.5, -3, -4, -4.5, -5, -5, -4, -3, -2],
    [5.6, 9.1, 15.6, 18.5, 17.4, 14.2, 10.2, 6.9, 5.9, 7.2,
     12.6, 22.6, 36.2, 49.8, 57.5, 56.3, 45, 29.4, 14.3, 6.7],
    [0, -4, -4, 0, 3, 5, 7, 8.5, 10, 11, 8, -3, -14, -16, -9, -3, 0, 2, 2, 1],
    [2, -2, -4, -5, -5, -5, -4.5, -4, -3, -1, 1, 3, 5, 4, 2.5, 1.5, 1, 1, 1, 1.5],
)  # fmt: skip
#: Moments in Nm/kg, positive along the coordinates above (knee: extension), stance only is used as a target.
MOMENTS = (
    [-0.3, -0.7, -0.65, -0.5, -0.33, -0.15, 0.02, 0.2, 0.4, 0.6,
     0.75, 0.72, 0.5, 0.3, 0.2, 0.1, 0, -0.15, -0.3, -0.33],
    [-0.1, -0.4, -0.72, -0.82, -0.78, -0.7, -0.65, -0.68, -0.75, -0.8,
     -0.66, -0.35, -0.05, 0, 0, 0, 0, 0, 0, -0.02],
    [0, 0.04, 0.06, 0.06, 0.04, 0.0, -0.04, -0.07, -0.09, -0.09, -0.06, -0.02, 0, 0, 0, 0, 0, 0, 0, 0],
    [-0.25, 0.0, 0.42, 0.58, 0.5, 0.3, 0.1, -0.08, -0.2, -0.22,
     -0.08, 0.1, 0.15, 0.12, 0.06, 0, -0.1, -0.2, -0.28, -0.3],
    [0.0, 0.1, -0.02, -0.2, -0.4, -0.58, -0.75, -0.93, -1.12, -1.38, -1.38, -0.8, -0.15, 0, 0, 0, 0, 0, 0, 0],
    [0, 0.0, 0.02, 0.04, 0.06, 0.07, 0.09, 0.11, 0.14, 0.17, 0.17, 0.1, 0.02, 0, 0, 0, 0, 0, 0, 0],
)  # fmt: skip
#: Ground reaction over the stance phase, body weights: forward, up, to the right; and centre of pressure (m)
#: in the foot frame, forward and to the right.
_S = [0, 0.04, 0.08, 0.15, 0.22, 0.35, 0.5, 0.65, 0.77, 0.85, 0.92, 0.97, 1.0]
GRF = (
    [0, 0.01, -0.05, -0.16, -0.17, -0.08, -0.01, 0.06, 0.16, 0.20, 0.14, 0.04, 0],
    [0, 0.25, 0.55, 0.92, 1.10, 0.90, 0.76, 0.90, 1.10, 0.95, 0.50, 0.14, 0],
    [0, 0.01, -0.01, -0.04, -0.055, -0.045, -0.035, -0.04, -0.055, -0.045, -0.02, -0.005, 0],
)
COP = (
    [0.005, 0.01, 0.02, 0.045, 0.065, 0.09, 0.11, 0.135, 0.155, 0.17, 0.185, 0.20, 0.205],
    [-0.002, -0.002, 0, 0.004, 0.006, 0.008, 0.008, 0.006, 0.002, -0.002, -0.006, -0.008, -0.008],
)
#: Textbook bursts of the electrodes (centre %, width %, height), a weak prior of the drive (Perry 1992).
BURSTS: dict[str, list[tuple[float, float, float]]] = {
    "gluteus_maximus": [(5, 9, 0.25), (97, 5, 0.15)],
    "gluteus_medius": [(12, 14, 0.35)],
    "adductors": [(65, 9, 0.15), (3, 6, 0.10)],
    "iliopsoas": [(62, 12, 0.35)],
    "tensor_fasciae_latae": [(25, 18, 0.15)],
    "rectus_femoris": [(60, 7, 0.12), (5, 8, 0.10)],
    "vastus_lateralis": [(8, 9, 0.25)],
    "vastus_medialis": [(8, 9, 0.25)],
    "medial_hamstrings": [(95, 9, 0.25)],
    "biceps_femoris": [(95, 9, 0.25)],
    "gastrocnemius_medialis": [(40, 11, 0.40)],
    "gastrocnemius_lateralis": [(40, 11, 0.35)],
    "soleus": [(40, 12, 0.40)],
    "tibialis_anterior": [(3, 6, 0.35), (78, 16, 0.20)],
    "tibialis_posterior": [(28, 16, 0.25)],
    "peroneus": [(35, 14, 0.20)],
    "extensor_digitorum": [(3, 6, 0.25), (78, 16, 0.20)],
}


def stance_fraction(speed: float) -> float:
    """Return the part of the cycle spent in stance."""
    return float(np.clip(0.62 - 0.05 * (speed - NORMAL_SPEED), 0.58, 0.68))


def period(speed: float) -> float:
    """Return the cycle time in s (cadence and step length share the speed, Grieve 1968)."""
    return 1.10 * (speed / NORMAL_SPEED) ** -0.5


def _harmonics(values: list[float], phase: np.ndarray, order: int = 7) -> np.ndarray:
    """Return a truncated Fourier series through a periodic curve given each 5 % of the cycle."""
    c = np.fft.rfft(np.asarray(values, float)) / len(values)
    k = np.arange(1, order + 1)
    taper = np.where(k == order, 0.75, 1.0)
    terms = 2 * np.real(np.exp(2j * np.pi * phase[:, None] * k) * (c[1 : order + 1] * taper))
    return c[0].real + terms.sum(axis=1)


@dataclass
class Recording:
    """Motion and ground reaction of one recording at constant speed.

    Attributes
    ----------
    speed : float
        m/s.
    time, phase : ndarray
        Time (s) and cycle count (cycle 0 begins at phase 0), shape (T,).
    events : ndarray
        Heel strikes, s; the recorded cycles are those between ``events[0]`` and ``events[-1]``.
    q, pelvis : ndarray
        Coordinates, shapes (T, 6).
    force, cop, free : ndarray
        Ground reaction on the leg, centre of pressure and free moment.
    other_force, other_cop : ndarray
        The same of the other foot, half a cycle later.
    target : ndarray
        Textbook joint moments, Nm.
    kept : slice
        Frames written to file.
    """

    speed: float
    time: np.ndarray
    phase: np.ndarray
    events: np.ndarray
    q: np.ndarray
    pelvis: np.ndarray
    force: np.ndarray
    cop: np.ndarray
    free: np.ndarray
    other_force: np.ndarray
    other_cop: np.ndarray
    target: np.ndarray
    kept: slice


def _wander(rng: np.random.Generator, phase: np.ndarray, count: int, sd: float, columns: int) -> np.ndarray:
    """Return slow random curves of unit-lag correlation 0.3 between cycles, shape (T, columns)."""
    knots = np.arange(-2, count + 3)
    values = rng.standard_normal((len(knots), columns)) * sd
    for i in range(1, len(knots)):
        values[i] = 0.3 * values[i - 1] + np.sqrt(1 - 0.09) * values[i]
    return CubicSpline(knots + 0.5, values)(phase)


def textbook_angles(phase: np.ndarray, speed: float) -> np.ndarray:
    """Return leg angles in degrees (knee flexion positive), shape (T, 6)."""
    size = (speed / NORMAL_SPEED) ** np.array([0.45, 0.3, 0.3, 0.2, 0.2, 0.2])
    out = np.stack([_harmonics(a, phase, k) for a, k in zip(ANGLES, (3, 3, 3, 4, 5, 3), strict=True)], axis=1)
    mean = out.mean(axis=0)
    return mean + (out - mean) * size


def stance_curves(phase: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return force in body weights (T, 3) and centre of pressure in the foot (T, 2); zero force in swing."""
    s = np.mod(phase, 1.0) / stance_fraction(speed)
    inside = s < 1.0
    force = np.stack([PchipInterpolator(_S, g)(np.minimum(s, 1.0)) * inside for g in GRF], axis=1)
    window = np.stack([np.interp(s, [0, 0.1, 0.9, 1.0], [0, 1, 1, 0]) * inside], axis=1)[:, 0]
    bumps = force[:, 1] - 0.9 * np.clip(np.sin(np.pi * np.minimum(s, 1.0)) * 1.2, 0, 1) * inside
    force[:, 1] += bumps * window * (0.9 * (speed / NORMAL_SPEED - 1.0))
    force[:, 0] *= speed / NORMAL_SPEED
    cop = np.stack([PchipInterpolator(_S, c)(np.clip(s, 0, 1)) for c in COP], axis=1)
    return force, cop


def record(
    rng: np.random.Generator,
    leg: Leg,
    mass: float,
    speed: float,
    cycles: int,
    style: np.ndarray,
    steady: bool = False,
) -> Recording:
    """Return one recording.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the variation between cycles.
    leg : Leg
        True leg.
    mass : float
        Body mass, kg.
    speed : float
        m/s.
    cycles : int
        Number of cycles recorded.
    style : ndarray
        Personal offset (degrees) and relative amplitude of the six angles, shape (2, 6).
    steady : bool
        Without variation between cycles.

    Returns
    -------
    Recording
        The recording, with a further cycle before and after.
    """
    vary = 0.0 if steady else 1.0
    durations = period(speed) * (1 + 0.015 * vary * rng.standard_normal(cycles + 2))
    marks = np.concatenate([[0.0], np.cumsum(durations)])
    marks -= marks[1]
    start = np.round(marks[0], 2)
    time = start + np.arange(int((marks[-1] - start) * RATE) + 1) / RATE
    phase = CubicSpline(marks, np.arange(-1, cycles + 2))(time)

    degrees = textbook_angles(phase, speed)
    mean = degrees.mean(axis=0)
    grow = style[1] * (1 + _wander(rng, phase, cycles, 0.02 * vary, 6))
    degrees = mean + (degrees - mean) * grow + style[0] + _wander(rng, phase, cycles, 0.6 * vary, 6)
    q = np.radians(degrees)
    q[:, 3] *= leg.knee_sign
    ph = 2 * np.pi * phase
    pelvis = np.zeros((len(time), 6))
    pelvis[:, 0] = (
        np.radians(-6 + 1.2 * np.cos(2 * ph - 0.6))
        + np.radians(_wander(rng, phase, cycles, 0.5 * vary, 1))[:, 0]
    )
    pelvis[:, 1] = np.radians(2.2 * np.sin(ph + 0.2))
    pelvis[:, 2] = np.radians(4.0 * np.cos(ph))
    pelvis[:, 3] = 0.012 * np.sin(2 * ph + 0.4)
    pelvis[:, 5] = 0.02 * np.sin(ph - 0.3)
    # Height: the foot of the mean cycle rests on the ground in mid-stance; two waves per cycle.
    rot, org = frames(leg, q, pelvis)
    sole = np.minimum(org[:, 4, 1], (org[:, 4] + rot[:, 4] @ np.array([0.2, 0.0, 0.0]))[:, 1])
    middle = (np.mod(phase, 1) > 0.1) & (np.mod(phase, 1) < 0.5)
    basis = np.stack([np.ones_like(ph), np.cos(2 * ph), np.sin(2 * ph)], axis=1)
    coef = np.linalg.lstsq(basis[middle], -sole[middle], rcond=None)[0]
    wave = np.hypot(coef[1], coef[2])
    coef[1:] *= min(1.0, 0.022 / max(wave, 1e-9))
    pelvis[:, 4] = basis @ coef

    weight = mass * 9.80665

    def contact(shift: float, amount: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f, c = stance_curves(phase + shift, speed)
        return f * weight * (1 + amount), c

    amount = _wander(rng, phase, cycles, 0.015 * vary, 3)
    force, foot_cop = contact(0.0, amount)
    rot, org = frames(leg, q, pelvis)
    local = np.stack([foot_cop[:, 0] * leg.notes["foot_scale"], 0 * phase, foot_cop[:, 1]], axis=1)
    cop = org[:, 4] + np.einsum("tij,tj->ti", rot[:, 4], local)
    cop[:, 1] = 0.0
    other_force, other_foot = contact(0.5, amount)
    other_force[:, 2] *= -1
    early = np.mod(phase + 0.5, 1) / stance_fraction(speed)
    other_cop = np.stack([0.25 - 0.62 * early + other_foot[:, 0], 0 * phase, -0.09 - 0 * phase], axis=1)
    target = np.stack([_harmonics(m, phase, 6) for m in MOMENTS], axis=1) * mass
    target[:, 3] *= leg.knee_sign * -1
    target *= (speed / NORMAL_SPEED) ** np.array([0.6, 0.1, 0.3, 0.6, 0.35, 0.3])
    target *= 1 + _wander(rng, phase, cycles, 0.02 * vary, 6)
    inside = np.flatnonzero((time > marks[1] - 0.35) & (time < marks[-2] + 0.35))
    kept = slice(int(inside[0]), int(inside[-1]) + 1)
    return Recording(
        speed,
        time,
        phase,
        marks[1:-1],
        q,
        pelvis,
        force,
        cop,
        0 * phase,
        other_force,
        other_cop,
        target,
        kept,
    )
