"""Movements beside walking, squats or running: the same person, motion, plates and electrodes.

Static optimisation (least squares with non-negative activations, frame by frame) gives a first drive, which
is corrected as in walking; what the muscles cannot make is taken up by the contact.  What a cause does at a
phase of walking alone is absent.  Moments are those of inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from . import gait, running, squats
from .case_files import added_trials, write_trial
from .drive import FIRST, DriveFit, channel_weights
from .dynamics import inverse_dynamics
from .effect import Effect, View, forward
from .leg import geometry
from .muscle import RATE
from .other_tasks import OF_WALKING
from .person import Person
from .session import Session, Take, bring_near
from .signals import envelope, session_peak

#: Smallest drive, and weight of activations against moments (Nm) in static optimisation.
REST, EFFORT = 0.02, 40.0


@dataclass(frozen=True)
class Movement:
    """A movement.

    Attributes
    ----------
    name : str
        Name of the trial.
    record : callable
        Motion and ground reaction of a person.
    interval : callable
        Start and end (s) of what is written of a recording.
    absent : tuple of str
        Causes without effect in it.
    stream : int
        Number that makes its noise differ from that of other trials.
    step, smoothing, lead : int and float
        Frames between those of static optimisation; standard deviation of the smoothing of its drive; time by
        which the drive is earlier than the activation, s.
    noise, noise_time : float
        Noise of the moments relative to walking, and its correlation time, s.
    """

    name: str
    record: Callable[[Person, np.random.Generator], gait.Recording]
    interval: Callable[[gait.Recording], tuple[float, float]]
    absent: tuple[str, ...]
    stream: int
    step: int
    smoothing: float
    lead: float
    noise: float
    noise_time: float


SQUATS = Movement(
    name="squats",
    record=squats.record,
    interval=lambda rec: (0.5 * squats.STANDING, rec.time[-1] - 0.5 * squats.STANDING),
    # Squats have no impact at heel strike and no belt.
    absent=(*OF_WALKING, "wobbling_mass", "belt_acceleration"),
    stream=47,
    step=20,
    smoothing=0.1,
    lead=0.0,
    noise=1.0,
    noise_time=0.15,
)
RUNNING = Movement(
    name="running",
    record=running.record,
    interval=lambda rec: (rec.events[0], rec.events[-1]),
    absent=OF_WALKING,
    stream=59,
    step=4,
    smoothing=0.02,
    lead=0.06,
    noise=2.0,
    noise_time=0.03,
)


def _static_drive(per: np.ndarray, rest: np.ndarray, shape: np.ndarray, movement: Movement) -> np.ndarray:
    """Return the drive of static optimisation, shape (T, C)."""
    places = np.arange(0, len(rest), movement.step)
    channels = per.shape[1]
    found = []
    for i in places:
        a = np.vstack([per[i].T, EFFORT * np.eye(channels)])
        found.append(nnls(a, np.concatenate([rest[i], np.zeros(channels)]))[0])
    activation = np.clip(np.array(found), 0.0, 0.9)
    u = np.log1p(activation * np.expm1(shape)) / shape
    at = np.arange(len(rest)) + movement.lead * RATE
    drive = np.stack([np.interp(at, places, one) for one in u.T], axis=1)
    return np.clip(gaussian_filter1d(drive, movement.smoothing * RATE, axis=0, mode="nearest"), REST, 1.0)


def take(
    movement: Movement, session: Session, effects: Sequence[Effect], rng: np.random.Generator
) -> tuple[Take, Take]:
    """Return the true state of a movement without causes, and with them.

    Parameters
    ----------
    movement : Movement
        The movement.
    session : Session
        Session of the person.
    effects : sequence of Effect
        Causes at work in it.
    rng : numpy.random.Generator
        Source of the variation.

    Returns
    -------
    tuple of Take
        Motion, drive and true joint moments, which are the same for both as far as the drive can adapt.
    """
    p = session.person
    rec = movement.record(p, rng)
    goal = inverse_dynamics(p.leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
    lmt, arms = geometry(p.leg, rec.q)
    walking = session.takes[0].view
    view = View(p, rec, lmt, arms, p.muscles, p.speeds, walking)
    per, slack = channel_weights(lmt, arms, p.muscles)
    start = _static_drive(per, goal - slack, p.muscles.shape[FIRST], movement)
    fit = DriveFit(start, per, p.muscles, goal, np.where(rec.force[:, 1] > 0, 0.5, 2.0))
    drive = fit.solve(lambda n: forward(n, view))
    moments = forward(drive, view)
    bring_near(p.leg, rec, moments, p.mass, 0.004)
    fit.wanted = moments
    plain = Take(view, fit, drive, moments)

    leg = p.leg.copy()
    for e in effects:
        leg = e.true_leg(leg)
    changed = View(p, rec, *geometry(leg, rec.q), p.muscles, p.speeds, walking)
    fit.start = drive
    adapted = fit.solve(lambda n: forward(n, changed, effects), 3, fresh=False) if effects else drive
    return plain, Take(changed, fit, adapted, forward(adapted, changed, effects))


def add_movement(
    movement: Movement,
    case: Path,
    out: Path,
    session: Session,
    effects: Sequence[Effect],
    seed: int,
    scale: np.ndarray,
) -> None:
    """Copy a case of walking and add a movement, with EMG in the same units.

    Parameters
    ----------
    movement : Movement
        The movement.
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
        p, name = session.person, movement.name
        rng = np.random.default_rng([seed, movement.stream])
        acting = [e for e in effects if e.id not in movement.absent]
        _, one = take(movement, session, acting, rng)
        ((measured, moments),) = session.measure([one], acting)
        noise = gaussian_filter1d(rng.standard_normal(moments.shape), movement.noise_time * RATE, axis=0)
        noise *= movement.noise * p.noise["moment"] * session.peak / noise.std(axis=0)
        peak = session_peak(session.takes)
        emg = envelope(one, peak, acting, rng, p.noise["emg_cv"]) * peak / scale
        full = (case / "trials/speed1/angles.sto").exists()
        write_trial(work / f"trials/{name}", measured, moments + noise, emg, one, p.side, full)
        start, end = movement.interval(one.view.rec)
        lines += [
            "", "[[trial]]", f'name = "{name}"', 'use = "calibration"', 'task = "movement"',
            f'angles = "trials/{name}/angles.{"sto" if full else "mot"}"',
            f'moments = "trials/{name}/moments.sto"', f'emg = "trials/{name}/emg.sto"',
            f'ground_forces = "trials/{name}/ground_forces.mot"',
            f'external_loads = "trials/{name}/external_loads.xml"',
            f"interval = [{start:.2f}, {end:.2f}]",
        ]  # fmt: skip
