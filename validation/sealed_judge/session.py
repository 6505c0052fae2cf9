"""One session of a person: recordings, drive, true moments with and without effects, measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from . import anatomy, gait
from .drive import DriveFit, channel_weights, mean_drive
from .dynamics import contact_map, inverse_dynamics
from .effect import Effect, Measured, View, forward
from .leg import Leg, geometry
from .muscle import RATE
from .person import Person


def adjust_contact(
    leg_map: np.ndarray, rec: gait.Recording, gap: np.ndarray, mass: float, slack: float
) -> None:
    """Shift force, centre of pressure and free moment so that the joint moments change by ``gap``.

    The shift is the smallest in units of 5 % of the vertical force (12 mm, 0.008 m times force), frame by
    frame; moments may miss by ``slack`` Nm/kg.  In swing nothing changes.

    Parameters
    ----------
    leg_map : ndarray
        Matrix from ground wrench to generalised forces, shape (T, 6, 6).
    rec : Recording
        Changed in place.
    gap : ndarray
        Wanted change of the joint moments, shape (T, 6).
    mass : float
        Body mass, kg.
    slack : float
        Admissible miss, Nm/kg.
    """
    n = len(gap)
    units = np.zeros((n, 6, 6))
    up = rec.force[:, 1]
    eye = np.eye(3)
    for i, size in enumerate((0.05, 0.05, 0.03)):
        units[:, :3, i] = eye[i] * (size * up)[:, None]
        units[:, 3:, i] = np.cross(rec.cop, units[:, :3, i])
    for i, axis in enumerate((0, 2)):
        units[:, 3:, 3 + i] = np.cross(0.012 * eye[axis], rec.force)
    units[:, 4, 5] = 0.008 * up
    a = -leg_map @ units
    sd = slack * mass * np.array([1, 1, 2, 1, 1, 1.0])
    s = np.einsum("tij,tkj->tik", a, a) + np.diag(sd**2)
    x = np.einsum("tji,tj->ti", a, np.linalg.solve(s, gap[:, :, None])[:, :, 0])
    # A shift of more than 4 units is shortened, which leaves part of the gap.
    x *= np.minimum(1.0, 4.0 / np.maximum(np.abs(x).max(axis=1, keepdims=True), 1e-9))
    rec.cop = rec.cop + np.stack([0.012 * x[:, 3], 0 * up, 0.012 * x[:, 4]], axis=1)
    rec.force = rec.force + np.stack([0.05 * x[:, 0], 0.05 * x[:, 1], 0.03 * x[:, 2]], axis=1) * up[:, None]
    rec.free = rec.free + 0.008 * up * x[:, 5]


def bring_near(leg: Leg, rec: gait.Recording, wanted: np.ndarray, mass: float, slack: float) -> None:
    """Shift the contact of a recording so that inverse dynamics comes near the wanted joint moments.

    Parameters
    ----------
    leg : Leg
        True leg.
    rec : Recording
        Changed in place, where the foot is loaded.
    wanted : ndarray
        Wanted joint moments, shape (T, 6).
    mass : float
        Body mass, kg.
    slack : float
        Admissible miss, Nm/kg.
    """
    contact = contact_map(leg, rec.q, rec.pelvis)
    for _ in range(2):
        now = inverse_dynamics(leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)
        adjust_contact(contact, rec, wanted - now, mass, slack)


def smooth_envelope(envelope: np.ndarray) -> np.ndarray:
    """Low-pass at 6 Hz without phase shift (fourth order, forwards and backwards) and clip at zero."""
    return np.maximum(sosfiltfilt(butter(4, 6.0, fs=RATE, output="sos"), envelope, axis=0), 0.0)


@dataclass
class Take:
    """True state of one recording."""

    view: View
    fit: DriveFit
    drive: np.ndarray
    moments: np.ndarray


class Session:
    """The recordings of one case, without effects.

    Parameters
    ----------
    person : Person
        The person.
    seed : int
        Seed of the variation between cycles.
    """

    def __init__(self, person: Person, seed: int) -> None:
        self.person = person
        rng = np.random.default_rng([seed, 23])
        self.cycles = self._plan(rng)
        self.takes: list[Take] = []
        for speed, (calibration, validation) in zip(person.speeds, self.cycles, strict=True):
            self.takes.append(self._take(rng, speed, calibration + validation))
        self.peak = np.max([np.abs(t.moments[t.view.rec.kept]).max(axis=0) for t in self.takes], axis=0)

    def _plan(self, rng: np.random.Generator) -> list[tuple[int, int]]:
        """Return calibration and validation cycles of each speed."""
        extra = int(rng.integers(2, 4))
        if len(self.person.speeds) == 2:
            return [(4, extra), (4, extra)]
        return [(4, int(rng.integers(0, 2))), (0, 4), (4, extra - 1)]

    def _target(self, rec: gait.Recording) -> np.ndarray:
        """Bring the contact of a recording near the textbook moments and return its joint moments."""
        p = self.person
        bring_near(p.leg, rec, rec.target, p.mass, 0.08)
        return inverse_dynamics(p.leg, rec.q, rec.pelvis, rec.force, rec.cop, rec.free)

    def _take(self, rng: np.random.Generator, speed: float, cycles: int) -> Take:
        """Return one recording with its drive."""
        p = self.person
        steady = gait.record(rng, p.leg, p.mass, speed, 1, p.style, steady=True)
        goal = self._target(steady)
        lmt, arms = geometry(p.leg, steady.q)
        per, slack = channel_weights(lmt, arms, p.muscles)
        phase = np.arange(110) / 110
        columns = np.concatenate([per.reshape(len(goal), -1), goal - slack], axis=1)
        at = np.stack([np.interp(phase, steady.phase, col) for col in columns.T], axis=1)
        pattern = mean_drive(phase, gait.period(speed), at[:, :-6].reshape(110, -1, 6), at[:, -6:], p.muscles)

        rec = gait.record(rng, p.leg, p.mass, speed, cycles, p.style)
        goal = self._target(rec)
        lmt, arms = geometry(p.leg, rec.q)
        view = View(p, rec, lmt, arms, p.muscles, p.speeds)
        vary = gait._wander(rng, rec.phase, cycles, 0.08, len(anatomy.CHANNELS))
        start = np.clip(pattern(rec.phase) * np.exp(vary), 0.004, 1.0)
        per, _ = channel_weights(lmt, arms, p.muscles)
        fit = DriveFit(start, per, p.muscles, goal, np.where(rec.force[:, 1] > 0, 0.5, 2.0))
        drive = fit.solve(lambda n: forward(n, view))
        moments = forward(drive, view)
        bring_near(p.leg, rec, moments, p.mass, 0.004)
        fit.wanted = moments
        return Take(view, fit, drive, moments)

    def with_effects(self, effects: Sequence[Effect], adapt: int = 3) -> list[Take]:
        """Return the true state with effects; the drive adapts so that the walk stays the same.

        Parameters
        ----------
        effects : sequence of Effect
            Effects at work.
        adapt : int
            Gauss-Newton steps of the adaptation; 0 keeps the drive.

        Returns
        -------
        list of Take
            One per recording.
        """
        out = []
        leg = self.person.leg.copy()
        for e in effects:
            leg = e.true_leg(leg)
        moved = any(type(e).true_leg is not Effect.true_leg for e in effects)
        for take in self.takes:
            v = take.view
            lmt, arms = geometry(leg, v.rec.q) if moved else (v.lmt, v.arms)
            view = View(v.person, v.rec, lmt, arms, v.muscles, v.speeds)

            def run(n: np.ndarray, view: View = view) -> np.ndarray:
                return forward(n, view, effects)

            drive = take.drive
            if adapt and effects:
                start, take.fit.start = take.fit.start, take.drive
                drive = take.fit.solve(run, adapt, fresh=False)
                take.fit.start = start
            out.append(Take(view, take.fit, drive, run(drive)))
        return out

    def measure(self, takes: list[Take], effects: Sequence[Effect]) -> list[tuple[Measured, np.ndarray]]:
        """Return noise-free measurements and lab moments of every recording.

        Parameters
        ----------
        takes : list of Take
            True states.
        effects : sequence of Effect
            Effects on the measurement.

        Returns
        -------
        list of tuple
            Measured motion and contact, and lab moments (T, 6).
        """
        p = self.person
        lab = p.lab_leg.copy()
        for e in effects:
            lab = e.lab_leg(lab)
        out = []
        for take in takes:
            r = take.view.rec
            m = Measured(r.q.copy(), r.pelvis.copy(), r.force.copy(), r.cop.copy(), r.free.copy())
            for e in effects:
                e.measure(m, take.view)
            true = inverse_dynamics(p.leg, r.q, r.pelvis, r.force, r.cop, r.free)
            seen = inverse_dynamics(lab, m.q, m.pelvis, m.force, m.cop, m.free)
            moments = take.moments + seen - true
            for e in effects:
                moments = e.report(moments, take.view)
            out.append((m, moments))
        return out
