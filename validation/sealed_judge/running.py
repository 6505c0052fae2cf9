"""Textbook curves of slow running, and a recording of some cycles on a treadmill.

Key points are rounded from Novacheck (1998, doi:10.1016/S0966-6362(97)00038-6) and Hamner and Delp (2013,
doi:10.1016/j.jbiomech.2012.11.024), for about 2.8 m/s, in per cent of the cycle from foot strike.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from . import gait
from .leg import frames
from .muscle import RATE
from .person import Person
from .session import bring_near

#: Number of cycles, cycle time (s), and part of it in stance.
CYCLES, PERIOD, STANCE = 8, 0.78, 0.39
#: Degrees, as in `gait.ANGLES`.
ANGLES: tuple[list[float], ...] = (
    [33, 32, 29, 24, 18, 12, 6, 1, -2, -2, 1, 7, 15, 23, 30, 34, 37, 37, 36, 34],
    [5, 8, 10.5, 11, 9.5, 7, 4, 1, -2, -4, -5, -5, -4.5, -4, -3, -2, -1, 0, 1.5, 3],
    [0, 2, 4, 5, 5, 4, 2, 0, -2, -3, -3, -3, -3, -3, -2.5, -2, -2, -1.5, -1, -0.5],
    [14, 23, 32, 37, 37, 33, 27, 23, 24, 32, 45, 58, 68, 71, 68, 59, 46, 32, 20, 13],
    [4, 5, 13, 20, 23, 19, 8, -9, -20, -18, -10, -4, 0, 2, 3, 4, 5, 6, 6, 5],
    [5, 0, -5, -8, -8, -6, -2, 3, 6, 6, 5, 4, 3, 3, 3, 3, 4, 4, 5, 5],
)
#: Harmonics kept of each angle.
HARMONICS = (4, 3, 3, 4, 5, 3)
#: Moments in Nm/kg, as in `gait.MOMENTS`, of stance; beyond it they serve the harmonics alone.
MOMENTS: tuple[list[float], ...] = (
    [-0.7, -1.4, -1.4, -1, -0.5, 0, 0.4, 0.7, 0.8, 0.8, 0.7, 0.5, 0.3, 0.1, 0, -0.2, -0.4, -0.6, -0.7, -0.7],
    [-0.2, -0.9, -1.4, -1.5, -1.3, -1, -0.5, -0.2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, -0.05],
    [0, 0.05, 0.1, 0.1, 0.05, 0, -0.05, -0.05, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    [-0.1, 0.7, 1.6, 2, 1.8, 1.1, 0.4, 0, 0.1, 0.2, 0.2, 0.1, 0, 0, -0.1, -0.3, -0.5, -0.6, -0.5, -0.3],
    [0, -0.3, -1, -1.8, -2.2, -2, -1.2, -0.3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
    [0, 0.05, 0.1, 0.2, 0.25, 0.2, 0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],
)
#: Ground reaction over the stance phase, body weights: forward, up, to the right; and centre of pressure (m)
#: in the foot, forward and to the right.
_S = (0, 0.06, 0.14, 0.22, 0.35, 0.45, 0.6, 0.75, 0.88, 0.95, 1)
GRF = (
    (0, -0.05, -0.18, -0.26, -0.22, -0.08, 0.14, 0.24, 0.15, 0.05, 0),
    (0, 0.7, 1.3, 1.35, 1.75, 1.95, 1.7, 1.05, 0.4, 0.12, 0),
    (0, -0.01, -0.03, -0.05, -0.07, -0.07, -0.06, -0.04, -0.02, -0.01, 0),
)
COP = (
    (0.02, 0.03, 0.05, 0.07, 0.10, 0.12, 0.145, 0.165, 0.18, 0.19, 0.195),
    (-0.002, -0.002, 0, 0.004, 0.006, 0.008, 0.008, 0.004, 0, -0.004, -0.006),
)
#: Rise and fall of the pelvis, twice in a cycle: lowest in the middle of stance (m).
BOUNCE = 0.035


def _stance(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return force in body weights (T, 3) and centre of pressure in the foot (T, 2)."""
    s = np.mod(phase, 1.0) / STANCE
    inside = s < 1.0
    force = np.stack([PchipInterpolator(_S, g)(np.minimum(s, 1.0)) * inside for g in GRF], axis=1)
    cop = np.stack([PchipInterpolator(_S, c)(np.minimum(s, 1.0)) for c in COP], axis=1)
    return force, cop


def record(person: Person, rng: np.random.Generator) -> gait.Recording:
    """Return motion and ground reaction of running.

    Parameters
    ----------
    person : Person
        The person; the first speed of walking stands for this recording.
    rng : numpy.random.Generator
        Source of the variation between cycles.

    Returns
    -------
    Recording
        The recording, with a further cycle before and after.
    """
    leg, mass = person.leg, person.mass
    durations = PERIOD * (1 + 0.012 * rng.standard_normal(CYCLES + 2))
    marks = np.concatenate([[0.0], np.cumsum(durations)])
    marks -= marks[1]
    start = np.round(marks[0], 2)
    time = start + np.arange(int((marks[-1] - start) * RATE) + 1) / RATE
    phase = CubicSpline(marks, np.arange(-1, CYCLES + 2))(time)

    def wander(sd: float, columns: int) -> np.ndarray:
        return gait._wander(rng, phase, CYCLES, sd, columns)

    degrees = np.stack([gait._harmonics(a, phase, k) for a, k in zip(ANGLES, HARMONICS, strict=True)], axis=1)
    mean = degrees.mean(axis=0)
    degrees = mean + (degrees - mean) * person.style[1] * (1 + wander(0.02, 6)) + person.style[0]
    q = np.radians(degrees + wander(0.6, 6))
    q[:, 3] *= leg.knee_sign
    ph = 2 * np.pi * phase
    pelvis = np.zeros((len(time), 6))
    pelvis[:, 0] = np.radians(-12 + 1.5 * np.cos(2 * ph - 0.6))
    pelvis[:, 1] = np.radians(3.0 * np.sin(ph + 0.2))
    pelvis[:, 2] = np.radians(5.0 * np.cos(ph))
    pelvis[:, 5] = 0.01 * np.sin(ph - 0.3)
    rot, org = frames(leg, q, pelvis)
    sole = np.minimum(org[:, 4, 1], (org[:, 4] + rot[:, 4] @ np.array([0.2, 0.0, 0.0]))[:, 1])
    wave = -BOUNCE * np.cos(2 * (ph - np.pi * STANCE))
    middle = (np.mod(phase, 1) > 0.25 * STANCE) & (np.mod(phase, 1) < 0.75 * STANCE)
    pelvis[:, 4] = wave - np.mean((sole + wave)[middle])

    amount = wander(0.015, 3)
    force, foot_cop = _stance(phase)
    force = force * mass * 9.80665 * (1 + amount)
    rot, org = frames(leg, q, pelvis)
    local = np.stack([foot_cop[:, 0] * leg.notes["foot_scale"], 0 * phase, foot_cop[:, 1]], axis=1)
    cop = org[:, 4] + np.einsum("tij,tj->ti", rot[:, 4], local)
    cop[:, 1] = 0.0
    mirror = np.array([1.0, 1.0, -1.0])
    other = _stance(phase + 0.5)[0] * mass * 9.80665 * mirror
    target = np.stack([gait._harmonics(m, phase, 6) for m in MOMENTS], axis=1) * mass
    target[:, 3] *= leg.knee_sign * -1
    inside = np.flatnonzero((time > marks[1] - 0.35) & (time < marks[-2] + 0.35))
    rec = gait.Recording(
        person.speeds[0], time, phase, marks[1:-1], q, pelvis, force, cop, 0 * phase, other,
        cop * mirror, target, slice(int(inside[0]), int(inside[-1]) + 1),
    )  # fmt: skip
    bring_near(leg, rec, target, mass, 0.1)
    return rec
