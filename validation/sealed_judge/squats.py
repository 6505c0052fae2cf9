"""Two slow squats beside walking: the same person, motion, plates and electrodes; inverse dynamics.

The feet stay flat on the ground and each carries half of the body. Static optimisation (least squares with
non-negative activations, frame by frame) gives a first drive, which is corrected as in walking; what the
muscles cannot make is taken up by the contact.  What a cause does at a phase of walking alone is absent.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from . import gait
from .case_files import added_trials, write_trial
from .drive import FIRST, DriveFit, channel_weights
from .dynamics import contact_map, inverse_dynamics
from .effect import Effect, View, forward
from .leg import Leg, frames, geometry
from .muscle import RATE
from .other_tasks import OF_WALKING
from .session import Session, Take, adjust_contact
from .signals import envelope, session_peak

#: Causes without effect in a squat: of walking, or of the impact at heel strike and the belt.
ABSENT = (*OF_WALKING, "wobbling_mass", "belt_acceleration")
#: Duration of a squat, number of them, and standing before and after, s.
SECONDS, COUNT, STANDING = 4.0, 2, 1.0
#: Degrees when standing and at the lowest point: flexion, adduction and rotation of the hip, knee flexion,
#: dorsiflexion, inversion.
HIGH = (8.0, -3.0, 0.0, 6.0, 3.0, 0.0)
LOW = (58.0, -6.0, 2.0, 68.0, 20.0, 0.0)
#: Centre of pressure in the foot, forward: standing, and lower (m).
FORWARD = (0.07, 0.065)
#: Noise of the moments: correlation time, s.
NOISE_TIME = 0.15
#: Smallest drive, and weight of activations against moments (Nm) in static optimisation.
REST, EFFORT = 0.02, 40.0


def _depth(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the depth of the squats, 0 standing and about 1 at the lowest point."""
    since = time - STANDING
    number = np.clip(np.floor(since / SECONDS).astype(int), 0, COUNT - 1)
    own = np.clip(since - number * SECONDS, 0, SECONDS)
    depth = 1 + 0.05 * rng.standard_normal(COUNT)
    wave = 0.5 * (1 - np.cos(2 * np.pi * own / SECONDS))
    # Smoother than the cosine where a squat begins and ends.
    return depth[number] * gaussian_filter1d(wave, 0.12 * RATE, mode="nearest")


def record(leg: Leg, mass: float, speed: float, rng: np.random.Generator) -> gait.Recording:
    """Return motion and ground reaction of the squats.

    Parameters
    ----------
    leg : Leg
        True leg.
    mass : float
        Body mass, kg.
    speed : float
        Speed of the first recording of walking, m/s, which stands for this recording.
    rng : numpy.random.Generator
        Source of the variation.

    Returns
    -------
    Recording
        The recording; its phase is that of no event.
    """
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
        speed, time, still, np.array([0.0, 1e4]), q, pelvis, force, cop, np.zeros(len(time)),
        force * mirror, other, np.zeros((len(time), 6)), slice(0, len(time)),
    )  # fmt: skip


def _static_drive(per: np.ndarray, rest: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return the drive of static optimisation, shape (T, C)."""
    places = np.arange(0, len(rest), 20)
    channels = per.shape[1]
    found = []
    for i in places:
        a = np.vstack([per[i].T, EFFORT * np.eye(channels)])
        found.append(nnls(a, np.concatenate([rest[i], np.zeros(channels)]))[0])
    activation = np.clip(np.array(found), 0.0, 0.9)
    u = np.log1p(activation * np.expm1(shape)) / shape
    drive = np.stack([np.interp(np.arange(len(rest)), places, one) for one in u.T], axis=1)
    return np.clip(gaussian_filter1d(drive, 0.1 * RATE, axis=0, mode="nearest"), REST, 1.0)


def take(session: Session, effects: Sequence[Effect], rng: np.random.Generator) -> tuple[Take, Take]:
    """Return the true state of the squats without causes, and with them.

    Parameters
    ----------
    session : Session
        Session of the person.
    effects : sequence of Effect
        Causes at work in a squat.
    rng : numpy.random.Generator
        Source of the variation.

    Returns
    -------
    tuple of Take
        Motion, drive and true joint moments, which are the same for both as far as the drive can adapt.
    """
    p = session.person
    rec = record(p.leg, p.mass, p.speeds[0], rng)
    goal = inverse_dynamics(p.leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
    lmt, arms = geometry(p.leg, rec.q)
    walking = session.takes[0].view
    view = View(p, rec, lmt, arms, p.muscles, p.speeds, walking)
    per, slack = channel_weights(lmt, arms, p.muscles)
    start = _static_drive(per, goal - slack, p.muscles.shape[FIRST])
    fit = DriveFit(start, per, p.muscles, goal, np.full(len(rec.time), 0.5))
    drive = fit.solve(lambda n: forward(n, view))
    moments = forward(drive, view)
    contact = contact_map(p.leg, rec.q, rec.pelvis)
    for _ in range(2):
        now = inverse_dynamics(p.leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
        adjust_contact(contact, rec, moments - now, p.mass, 0.004)
    fit.wanted = moments
    plain = Take(view, fit, drive, moments)

    leg = p.leg.copy()
    for e in effects:
        leg = e.true_leg(leg)
    changed = View(p, rec, *geometry(leg, rec.q), p.muscles, p.speeds, walking)
    fit.start = drive
    adapted = fit.solve(lambda n: forward(n, changed, effects), 3, fresh=False) if effects else drive
    return plain, Take(changed, fit, adapted, forward(adapted, changed, effects))


def add_squats(
    case: Path, out: Path, session: Session, effects: Sequence[Effect], seed: int, scale: np.ndarray
) -> None:
    """Copy a case of walking and add the squats, with EMG in the same units.

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
        p = session.person
        rng = np.random.default_rng([seed, 47])
        acting = [e for e in effects if e.id not in ABSENT]
        _, one = take(session, acting, rng)
        ((measured, moments),) = session.measure([one], acting)
        noise = gaussian_filter1d(rng.standard_normal(moments.shape), NOISE_TIME * RATE, axis=0)
        noise *= p.noise["moment"] * session.peak / noise.std(axis=0)
        peak = session_peak(session.takes)
        emg = envelope(one, peak, acting, rng, p.noise["emg_cv"]) * peak / scale
        full = (case / "trials/speed1/angles.sto").exists()
        write_trial(work / "trials/squats", measured, moments + noise, emg, one, p.side, full)
        end = one.view.rec.time[-1]
        lines += [
            "", "[[trial]]", 'name = "squats"', 'use = "calibration"', 'task = "movement"',
            f'angles = "trials/squats/angles.{"sto" if full else "mot"}"',
            'moments = "trials/squats/moments.sto"', 'emg = "trials/squats/emg.sto"',
            'ground_forces = "trials/squats/ground_forces.mot"',
            'external_loads = "trials/squats/external_loads.xml"',
            f"interval = [{0.5 * STANDING:.2f}, {end - 0.5 * STANDING:.2f}]",
        ]  # fmt: skip
