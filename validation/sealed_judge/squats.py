"""Motion and ground reaction of two slow squats: feet flat on the ground, half of the body on each."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from . import gait
from .leg import frames
from .muscle import RATE
from .person import Person

#: Duration of a squat, number of them, and standing before and after, s.
SECONDS, COUNT, STANDING = 4.0, 2, 1.0
#: Degrees when standing and at the lowest point: flexion, adduction and rotation of the hip, knee flexion,
#: dorsiflexion, inversion.
HIGH = (8.0, -3.0, 0.0, 6.0, 3.0, 0.0)
LOW = (58.0, -6.0, 2.0, 68.0, 20.0, 0.0)
#: Centre of pressure in the foot, forward: standing, and lower (m).
FORWARD = (0.07, 0.065)


def _depth(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the depth of the squats, 0 standing and about 1 at the lowest point."""
    since = time - STANDING
    number = np.clip(np.floor(since / SECONDS).astype(int), 0, COUNT - 1)
    own = np.clip(since - number * SECONDS, 0, SECONDS)
    depth = 1 + 0.05 * rng.standard_normal(COUNT)
    wave = 0.5 * (1 - np.cos(2 * np.pi * own / SECONDS))
    # Smoother than the cosine where a squat begins and ends.
    return depth[number] * gaussian_filter1d(wave, 0.12 * RATE, mode="nearest")


def record(person: Person, rng: np.random.Generator) -> gait.Recording:
    """Return motion and ground reaction of the squats.

    Parameters
    ----------
    person : Person
        The person; the first speed of walking stands for this recording.
    rng : numpy.random.Generator
        Source of the variation.

    Returns
    -------
    Recording
        The recording; its phase is that of no event.
    """
    leg, mass = person.leg, person.mass
    total = 2 * STANDING + COUNT * SECONDS
    time = np.arange(round(total * RATE) + 1) / RATE
    depth = _depth(time, rng)[:, None]
    knots = np.linspace(0, total, 8)
    sway = CubicSpline(knots, 0.8 * rng.standard_normal((len(knots), 6)))(time)
    q = np.radians(np.array(HIGH) + depth * (np.array(LOW) - np.array(HIGH)) + sway)
    q[:, 3] *= leg.knee_sign
    pelvis = np.zeros((len(time), 6))
    for _ in range(4):
        rot, _ = frames(leg, q, pelvis)
        pelvis[:, 0] -= np.arctan2(rot[:, 4, 1, 0], rot[:, 4, 0, 0])
    _, org = frames(leg, q, pelvis)
    pelvis[:, 3:] = np.array([0.0, 0.03, 0.1]) - org[:, 4]
    rot, org = frames(leg, q, pelvis)
    height = gaussian_filter1d(pelvis[:, 4], 0.05 * RATE, mode="nearest")
    lift = np.gradient(np.gradient(height, 1 / RATE), 1 / RATE)
    force = np.zeros((len(time), 3))
    force[:, 1] = 0.5 * mass * (9.80665 + 0.8 * lift)
    force[:, 2] = -0.03 * force[:, 1]
    local = np.zeros((len(time), 3))
    local[:, 0] = (FORWARD[0] + depth[:, 0] * (FORWARD[1] - FORWARD[0])) * leg.notes["foot_scale"]
    cop = org[:, 4] + np.einsum("tij,tj->ti", rot[:, 4], local)
    cop[:, 1] = 0.0
    mirror = np.array([1.0, 1.0, -1.0])
    other = cop * mirror + np.array([0.0, 0.0, 2 * pelvis[0, 5]])
    still = np.full(len(time), 0.999)
    return gait.Recording(
        person.speeds[0], time, still, np.array([0.0, 1e4]), q, pelvis, force, cop, np.zeros(len(time)),
        force * mirror, other, np.zeros((len(time), 6)), slice(0, len(time)),
    )  # fmt: skip
