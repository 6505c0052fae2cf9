"""Trials of a dynamometer beside walking: passive rotations and isometric ramps of the same person.

The moment about the one joint is that of muscles, passive structures and devices, with the noise of the
device; no inverse dynamics.  What a cause does at a phase of walking alone is absent.  A rotation ends where
the joint resists with 40 Nm.  A ramp ends at a drive of 0.6, or at 1.5 times that of an electrode in walking,
so that envelopes stay near the unit of walking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from . import anatomy, gait
from .case_files import added_trials, write_table
from .effect import Effect, View, forward
from .leg import geometry
from .muscle import RATE, unit_forces
from .session import Session, Take
from .signals import envelope, session_peak

#: Causes that act at a phase of walking, or between recordings of walking.
OF_WALKING = ("missing_drive", "device_torque", "event_jitter", "speed_dependent_delay", "emg_drift")
#: Noise of the device, Nm, and its correlation time, s.
DEVICE_NOISE, DEVICE_TIME = 0.8, 0.1
#: Largest drive of a ramp, also relative to that of walking; drive of the electrodes that do not act.
RAMP, RAMP_OF_WALKING, REST = 0.6, 1.5, 0.02
#: Moment at which a rotation ends, Nm.
RESISTANCE = 40.0


@dataclass(frozen=True)
class Plan:
    """One trial: name, task, joint, its range (degrees, flexion positive), posture, direction of effort."""

    name: str
    task: str
    joint: str
    low: float
    high: float
    posture: dict[str, float]
    sign: int = 0


PLANS = (
    Plan("passive_ankle_knee_straight", "passive", "ankle_angle", -25, 15, {}),
    Plan("passive_ankle_knee_bent", "passive", "ankle_angle", -25, 20, {"hip_flexion": 60, "knee_angle": 90}),
    Plan("passive_knee", "passive", "knee_angle", 10, 100, {"hip_flexion": 30}),
    Plan("passive_hip", "passive", "hip_flexion", -10, 70, {"knee_angle": 40}),
    Plan("ramp_plantarflexion", "isometric", "ankle_angle", 0, 0, {"hip_flexion": 60, "knee_angle": 30}, -1),
    Plan("ramp_dorsiflexion", "isometric", "ankle_angle", 0, 0, {"hip_flexion": 60, "knee_angle": 30}, 1),
    Plan("ramp_knee_extension", "isometric", "knee_angle", 60, 60, {"hip_flexion": 60}, -1),
    Plan("ramp_knee_flexion", "isometric", "knee_angle", 45, 45, {"hip_flexion": 60}, 1),
    Plan("ramp_hip_extension", "isometric", "hip_flexion", 30, 30, {"knee_angle": 40}, -1),
    Plan("ramp_hip_flexion", "isometric", "hip_flexion", 20, 20, {"knee_angle": 40}, 1),
)


def _recording(session: Session, plan: Plan) -> gait.Recording:
    """Return the motion of a trial, there and back in 8 s, or held for 5 s."""
    seconds = 8.0 if plan.low != plan.high else 5.0
    time = np.arange(round(seconds * RATE) + 1) / RATE
    turn = 0.5 * (1 - np.cos(2 * np.pi * time / seconds))
    q = np.zeros((len(time), 6))
    for name, degrees in plan.posture.items():
        q[:, anatomy.COORDS.index(name)] = np.radians(degrees)
    q[:, anatomy.COORDS.index(plan.joint)] = np.radians(plan.low + (plan.high - plan.low) * turn)
    q[:, 3] *= session.person.leg.knee_sign
    none, still = np.zeros((len(time), 3)), np.zeros(len(time))
    return gait.Recording(
        session.person.speeds[0], time, still, np.array([0.0, 1.0]), q, np.zeros((len(time), 6)),
        none, none, still, none, none, np.zeros((len(time), 6)), slice(0, len(time)),
    )  # fmt: skip


def _view(session: Session, rec: gait.Recording, effects: Sequence[Effect]) -> View:
    """Return what an effect may look at, with the ranges of the first recording of walking."""
    leg = session.person.leg.copy()
    for e in effects:
        leg = e.true_leg(leg)
    first = session.takes[0].view
    common = session.person.muscles, session.person.speeds
    walking = View(session.person, first.rec, *geometry(leg, first.rec.q), *common)
    return View(session.person, rec, *geometry(leg, rec.q), *common, walking)


def _resisted(session: Session, plan: Plan, effects: Sequence[Effect]) -> Plan:
    """Return a rotation that ends where the joint resists, about the middle of the planned range."""
    rec = _recording(session, plan)
    joint = anatomy.COORDS.index(plan.joint)
    view = _view(session, rec, effects)
    idle = np.zeros((len(rec.time), len(anatomy.CHANNEL_NAMES)))
    free = np.abs(forward(idle, view, effects)[:, joint]) < RESISTANCE
    half = slice(0, len(rec.time) // 2 + 1)
    angle, free = np.degrees(view.flexion[half, joint]), free[half]
    middle = int(np.argmin(np.abs(angle - 0.5 * (plan.low + plan.high))))
    blocked = np.flatnonzero(~free)
    first = max((i + 1 for i in blocked if i < middle), default=0)
    last = min((i - 1 for i in blocked if i > middle), default=len(angle) - 1)
    return replace(plan, low=float(angle[first]), high=float(angle[max(last, first)]))


def take(session: Session, plan: Plan, effects: Sequence[Effect], largest: np.ndarray) -> Take:
    """Return the true state of a trial with causes.

    Parameters
    ----------
    session : Session
        Session of the person.
    plan : Plan
        The trial.
    effects : sequence of Effect
        Causes at work; those of walking alone do nothing.
    largest : ndarray
        Largest drive of each electrode in walking.

    Returns
    -------
    Take
        Motion, drive and true joint moments.
    """
    person = session.person
    acting = [e for e in effects if e.id not in OF_WALKING]
    if not plan.sign:
        plan = _resisted(session, plan, acting)
    rec = _recording(session, plan)
    view = _view(session, rec, acting)
    drive = np.zeros((len(rec.time), len(anatomy.CHANNEL_NAMES)))
    if plan.sign:
        gain, _ = unit_forces(view.lmt, person.muscles)
        joint = anatomy.COORDS.index(plan.joint)
        along = plan.sign * (person.leg.knee_sign if plan.joint == "knee_angle" else 1)
        moment = along * (gain * view.arms[:, :, joint]).mean(axis=0)
        of_channel = moment @ anatomy.channel_matrix()
        ramp = 1 - np.abs(2 * rec.time / rec.time[-1] - 1)
        drive += REST
        top = np.minimum(RAMP, RAMP_OF_WALKING * largest)
        acts = of_channel > 0.15 * of_channel.max()
        drive[:, acts] = (REST + np.outer(ramp, np.maximum(top - REST, 0.0)))[:, acts]
    moments = forward(drive, view, acting)
    return Take(view, session.takes[0].fit, drive, moments)


def add_tasks(
    case: Path, out: Path, session: Session, effects: Sequence[Effect], seed: int, scale: np.ndarray
) -> None:
    """Copy a case of walking and add the trials of a dynamometer, with EMG in the same units.

    Parameters
    ----------
    case, out : Path
        Folder of the case, and folder to write.
    session : Session
        Session without causes.
    effects : sequence of Effect
        Causes at work.
    seed : int
        Seed of the session, from which the noise of walking was drawn.
    scale : ndarray
        Drive of each electrode at an envelope of one, as in walking.
    """
    with added_trials(case, out) as (work, lines):
        side = session.person.side
        peak = session_peak(session.takes)
        rng = np.random.default_rng([seed, 43])
        cv = session.person.noise["emg_cv"]
        acting = [e for e in effects if e.id not in OF_WALKING]
        for plan in PLANS:
            one = take(session, plan, effects, scale)
            rec, joint = one.view.rec, anatomy.COORDS.index(plan.joint)
            noise = gaussian_filter1d(rng.standard_normal(len(rec.time)), DEVICE_TIME * RATE)
            noise *= DEVICE_NOISE / noise.std()
            folder = work / "trials" / plan.name
            folder.mkdir()
            half = slice(0, None, 2)
            names = [*anatomy.PELVIS_COORDS, *(f"{c}_{side}" for c in anatomy.COORDS)]
            angles = np.degrees(np.hstack([rec.pelvis, rec.q]))
            write_table(folder / "angles.mot", "Coordinates", names, rec.time[half], angles[half], True)
            write_table(
                folder / "moments.sto", "Moment of the device", [f"{plan.joint}_{side}_moment"],
                rec.time[half], (one.moments[:, joint] + noise)[half, None],
            )  # fmt: skip
            lines += [
                "", "[[trial]]", f'name = "{plan.name}"', 'use = "calibration"', f'task = "{plan.task}"',
                f'angles = "trials/{plan.name}/angles.mot"', f'moments = "trials/{plan.name}/moments.sto"',
                f"interval = [0.0, {rec.time[half][-1]:.2f}]",
            ]  # fmt: skip
            if plan.sign:
                emg = envelope(one, peak, acting, rng, cv) * peak / scale
                names = list(anatomy.CHANNEL_NAMES)
                write_table(folder / "emg.sto", "Electromyography", names, rec.time, emg)
                lines.append(f'emg = "trials/{plan.name}/emg.sto"')
