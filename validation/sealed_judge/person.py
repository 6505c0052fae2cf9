"""Draw a person: the true leg with its muscles, and the scaled generic model that the lab uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import anatomy, gait
from .curves import Curves
from .leg import Leg, generic_leg, geometry
from .muscle import Constants, generic_constants

FOOT = {"foot_scale": 1.0}


@dataclass
class Person:
    """A simulated person.

    Attributes
    ----------
    name : str
        Identifier.
    mass : float
        Body mass, kg.
    side : str
        ``l`` or ``r``.
    leg, muscles : Leg, Constants
        The truth.
    lab_leg, lab_muscles : Leg, Constants
        What the lab's model file holds.
    speeds : tuple of float
        Two or three walking speeds, m/s, from slow to fast.
    style : ndarray
        Offsets (degrees) and relative amplitudes of the angles.
    gain : ndarray
        Gain of each electrode.
    noise : dict
        Levels of noise of this person's recordings.
    """

    name: str
    mass: float
    side: str
    leg: Leg
    muscles: Constants
    lab_leg: Leg
    lab_muscles: Constants
    speeds: tuple[float, ...]
    style: np.ndarray
    gain: np.ndarray
    noise: dict[str, float]


def draw_person(seed: int, name: str) -> Person:
    """Return the person of a seed.

    Parameters
    ----------
    seed : int
        Seed.
    name : str
        Identifier.

    Returns
    -------
    Person
        The person.
    """
    rng = np.random.default_rng([seed, 11])
    height = rng.uniform(0.93, 1.08)
    mass = float(np.round(68.0 * height**2 * np.exp(0.09 * rng.standard_normal()), 1))
    scale = height * np.exp(0.02 * rng.standard_normal(5))
    scale[anatomy.TALUS] = scale[anatomy.CALCN]
    sign = int(rng.choice([-1, 1]))
    lab = generic_leg(scale, mass, sign)
    lab.notes["foot_scale"] = float(scale[anatomy.CALCN])

    # Generic fibers at their textbook length in the mean posture, scaled with the segments they cross.
    phase = np.arange(0, 1, 0.02)
    posture = np.radians(gait.textbook_angles(phase, gait.NORMAL_SPEED))
    posture[:, 3] *= sign
    generic = generic_leg(knee_sign=sign)
    base = generic_constants(_mean_length(generic, posture))
    ratio = _mean_length(lab, posture) / _mean_length(generic, posture)
    # Young adults are about 1.8 times stronger than the cadavers of the generic model (Rajagopal et al.
    # 2016).
    strong = 1.8 * (mass / anatomy.GENERIC_MASS) ** 0.67
    lab_muscles = base.with_(lo=base.lo * ratio, ls=base.ls * ratio, fmax=base.fmax * strong)

    leg = lab.copy()
    for muscle, (bodies, points) in leg.paths.items():
        leg.paths[muscle] = (bodies, points + 0.0015 * rng.standard_normal(points.shape))
    for cylinder in leg.cylinders.values():
        cylinder.radius *= float(np.exp(0.03 * rng.standard_normal()))
        cylinder.centre = cylinder.centre + 0.0015 * rng.standard_normal(3)
    for joint, sd in (("hip", 0.0025), ("knee", 0.0015), ("ankle", 0.0012), ("subtalar", 0.001)):
        leg.joints[joint] = leg.joints[joint] + sd * rng.standard_normal(3)
    n = len(anatomy.NAMES)

    def spread(sd: float) -> np.ndarray:
        return np.exp(sd * np.clip(rng.standard_normal(n), -2, 2))

    curves = Curves(
        width=spread(0.06),
        passive_strain=0.7 * spread(0.08),
        slope=5.0 * float(np.exp(0.10 * rng.standard_normal())),
        plateau=1.4 * float(np.exp(0.03 * rng.standard_normal())),
    )
    # The true slack length is drawn about the one that keeps the textbook fiber length with the true fibers.
    lo = lab_muscles.lo * spread(0.10)
    mean = _mean_length(leg, posture)
    cosine = np.cos(lab_muscles.pennation)
    centre = mean - (mean - lab_muscles.ls) / (lab_muscles.lo * cosine) * lo * cosine
    ls = np.clip(centre, 0.95 * lab_muscles.ls, 1.05 * lab_muscles.ls)
    ls = ls + np.minimum(0.03 * ls, 0.07 * lo) * np.clip(rng.standard_normal(n), -2, 2)
    muscles = Constants(
        lab_muscles.fmax * spread(0.15),
        lo,
        ls,
        lab_muscles.pennation * spread(0.08),
        10.0 * spread(0.05),
        np.clip(0.040 + 0.010 * rng.standard_normal(n), 0.018, 0.070),
        np.clip(0.018 + 0.004 * rng.standard_normal(n), 0.010, 0.030),
        rng.uniform(-2.2, -0.3, n),
        curves,
    )
    # One delay, twitch and shape per electrode: its muscles share the motor nerve.
    for members in anatomy.CHANNELS.values():
        rows = [anatomy.NAMES.index(m) for m in members]
        for values in (muscles.delay, muscles.twitch, muscles.shape):
            values[rows] = values[rows].mean()
    # Silent muscles stay slack in every posture, so that they carry no passive force either.
    for muscle in anatomy.SILENT:
        i = anatomy.NAMES.index(muscle)
        muscles.ls[i] = mean[i] - 0.72 * lo[i] * cosine[i]
    slow = rng.uniform(0.75, 0.95)
    fast = slow + rng.uniform(0.35, 0.50)
    speeds = (slow, fast) if rng.random() < 0.5 else (slow, 0.5 * (slow + fast), fast)
    style = np.stack([1.2 * rng.standard_normal(6), np.exp(0.04 * rng.standard_normal(6))])
    noise = {
        "moment": float(rng.uniform(0.010, 0.022)),
        "repeatable": float(rng.uniform(0.3, 0.6)),
        "emg_cv": float(rng.uniform(0.05, 0.10)),
    }
    gain = np.exp(0.5 * rng.standard_normal(len(anatomy.CHANNELS)))
    return Person(
        name, mass, str(rng.choice(["l", "r"])), leg, muscles, lab, lab_muscles,
        tuple(float(np.round(s, 2)) for s in speeds), style, gain, noise,
    )  # fmt: skip


def _mean_length(leg: Leg, posture: np.ndarray) -> np.ndarray:
    """Return the mean length of each muscle-tendon unit over a set of postures."""
    lengths, _ = geometry(leg, posture)
    return lengths.mean(axis=0)
