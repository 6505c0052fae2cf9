"""Detectability of an effect: its signal in the moment residual, in standard deviations.

The residual is lab moments minus those of the true muscle model without effects, driven by the recorded
electromyogram on the recorded motion.  Its change by an effect is the signal s.  Its covariance holds the
noise of moments and electromyogram, the spread of muscle curves, of moment arms and of joint centres, what
the filter of the electromyogram takes off, and the free muscle parameters with broad priors (which projects
them out).  d* = sqrt(s' C^-1 s) over the calibration cycles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from . import anatomy
from .drive import channel_weights
from .dynamics import inverse_dynamics
from .effect import Effect, View, forward
from .leg import geometry
from .muscle import Constants, activation_shape, twitch_filter, unit_forces
from .session import Session, Take
from .signals import LENGTH_COMMON, LENGTH_OWN, envelope, gamma_noise, session_peak, smooth_envelope

POINTS = 26
USED = list(anatomy.USED)
#: Broad priors of the free parameters: relative (lo, ls, fmax), seconds (delay, twitch), absolute (shape).
FREE = {"lo": 0.25, "ls": 0.08, "fmax": 0.6, "delay": 0.04, "twitch": 0.015, "shape": 1.5}
RELATIVE = ("lo", "ls", "fmax")
#: Spread of curves (Millard et al. 2013; De Groote et al. 2016; Thelen 2003): logarithmic standard
#: deviations.
SPREAD = {"width": 0.10, "passive_strain": 0.12, "slope": 0.20, "plateau": 0.05}
ARM_SD, ARM_SLOPE_SD = 0.0015, 0.0015
CENTRE_SD = {"hip": 0.0025, "knee": 0.0015, "ankle": 0.0012}


def sample(values: np.ndarray, view: View, cycles: int, first: int = 0) -> np.ndarray:
    """Return columns of ``values`` (T, ...) at POINTS phases of each cycle, flattened over time only."""
    at = (first + np.arange(cycles * POINTS) / POINTS)[:]
    flat = values.reshape(len(values), -1)
    out = np.stack([np.interp(at, view.rec.phase, col) for col in flat.T], axis=1)
    return out.reshape(len(at), *values.shape[1:])


class Detector:
    """Covariance of the residual of one session.

    Parameters
    ----------
    session : Session
        Session without effects.
    seed : int
        Seed of the noise draws.
    """

    def __init__(self, session: Session, seed: int) -> None:
        self.session = session
        self.cycles = [c for c, _ in session.cycles]
        self.peak = session_peak(session.takes)
        columns: list[np.ndarray] = []
        parts = [self._columns(t, n) for t, n in zip(session.takes, self.cycles, strict=True) if n]
        columns = [np.concatenate(rows, axis=0) for rows in zip(*parts, strict=True)]
        design = np.stack([c[:, USED].ravel() for c in columns], axis=1)
        cov = self._noise(np.random.default_rng([seed, 31])) + design @ design.T
        cov[np.diag_indices_from(cov)] *= 1 + 1e-9
        self.factor = cho_factor(cov, lower=True)
        self.base = self.residual([], session.takes)

    def _columns(self, take: Take, cycles: int) -> list[np.ndarray]:
        """Return moment changes by one standard deviation of each free parameter and nuisance, (rows, 6)."""
        view, c = take.view, take.view.muscles
        drive = smooth_envelope(take.drive) @ anatomy.channel_matrix().T
        lmt = view.lmt

        def forces(c: Constants, lmt: np.ndarray = lmt, a: np.ndarray | None = None) -> np.ndarray:
            if a is None:
                a = activation_shape(twitch_filter(drive, c.delay, c.twitch), c.shape)
            gain, slack = unit_forces(lmt, c)
            return gain * a + slack

        a0 = activation_shape(twitch_filter(drive, c.delay, c.twitch), c.shape)
        base = forces(c, a=a0)
        shared = {"delay", "twitch", "shape"}
        changes: list[tuple[np.ndarray, bool]] = []
        for name, sd in FREE.items():
            value = getattr(c, name)
            step = {"lo": 0.01, "ls": 0.002, "fmax": 0.01, "delay": 0.002, "twitch": 0.001, "shape": 0.05}[
                name
            ]
            moved = c.with_(**{name: value * (1 + step) if name in RELATIVE else value + step})
            changes.append(
                ((forces(moved, a=None if name in shared else a0) - base) * (sd / step), name in shared)
            )
        curves = vars(c.curves)
        for name in ("width", "passive_strain"):
            moved = c.with_(curves=c.curves.with_(**{name: curves[name] * 1.02}))
            changes.append(((forces(moved, a=a0) - base) * (SPREAD[name] / 0.02), False))
        rows = cycles * POINTS
        arms = sample(view.arms, view, cycles)
        out = []
        groups = anatomy.channel_matrix()
        for force, by_electrode in changes:
            moments = sample(force, view, cycles)[:, :, None] * arms
            if by_electrode:
                moments = np.einsum("tmk,mc->tck", moments, groups)
            out += [moments[:, j] for j in range(moments.shape[1])]
        for name in ("slope", "plateau"):
            moved = c.with_(curves=c.curves.with_(**{name: curves[name] * 1.02}))
            change = np.einsum("tm,tmk->tk", forces(moved, a=a0) - base, view.arms)
            out.append(sample(change, view, cycles) * (SPREAD[name] / 0.02))
        # What the low-pass filter of the electromyogram takes off each electrode, with or without effects.
        sharp = activation_shape(
            twitch_filter(take.drive @ anatomy.channel_matrix().T, c.delay, c.twitch), c.shape
        )
        lost = sample(forces(c, a=sharp) - base, view, cycles)[:, :, None] * arms
        lost = np.einsum("tmk,mc->tck", lost, groups)
        out += [lost[:, j] for j in range(lost.shape[1])]
        stiffness = sample((forces(c, lmt + 1e-4, a0) - base) / 1e-4, view, cycles)
        level, q = sample(base, view, cycles), sample(view.rec.q, view, cycles)
        for m in range(arms.shape[1]):
            for k in range(6):
                if np.abs(arms[:, m, k]).max() < 1e-6:
                    continue
                z = q[:, k] - q[:, k].mean()
                for sd, dr, dl in ((ARM_SD, np.ones(rows), -z), (ARM_SLOPE_SD, z, -(z**2) / 2)):
                    column = stiffness[:, m, None] * arms[:, m] * dl[:, None]
                    column[:, k] += level[:, m] * dr
                    out.append(column * sd)
        r, leg = view.rec, view.person.leg
        ref = inverse_dynamics(leg, r.q, r.pelvis, r.force, r.cop, r.free)
        for name, sd in CENTRE_SD.items():
            for axis in range(3):
                moved_leg = leg.copy()
                moved_leg.joints[name] = moved_leg.joints[name] + 0.001 * np.eye(3)[axis]
                new = inverse_dynamics(moved_leg, r.q, r.pelvis, r.force, r.cop, r.free)
                out.append(sample((new - ref) * (sd / 0.001), view, cycles))
        return out

    def _noise(self, rng: np.random.Generator) -> np.ndarray:
        """Return the covariance of noise in moments and electromyogram."""
        s = self.session
        total = sum(self.cycles)
        phase = np.tile(np.arange(POINTS) / POINTS, total)
        cycle = np.repeat(np.arange(total), POINTS)
        gap = phase[:, None] - phase[None]
        around = np.abs(gap) - np.round(np.abs(gap))
        share, level = s.person.noise["repeatable"], s.person.noise["moment"]
        same = cycle[:, None] == cycle[None]
        time = (1 - share) * same * np.exp(-0.5 * (gap / LENGTH_OWN) ** 2)
        time = time + share * np.exp(-0.5 * (around / LENGTH_COMMON) ** 2) + 0.02 * np.eye(len(phase))
        sd = level * s.peak[USED]
        cov = np.einsum("ij,kl->ikjl", time, np.diag(sd**2)).reshape(len(phase) * 5, -1)
        # Noise of the electromyogram: independent cycles, one covariance per speed.
        blocks, draws = [], 16
        for take, n in zip(s.takes, self.cycles, strict=True):
            if not n:
                continue
            view, c = take.view, take.view.muscles
            per, _ = channel_weights(view.lmt, view.arms, c)
            first = [anatomy.NAMES.index(m[0]) for m in anatomy.CHANNELS.values()]
            weights = sample(per, view, n)[:, :, USED]

            def moments(drive: np.ndarray) -> np.ndarray:
                u = twitch_filter(drive, c.delay[first], c.twitch[first])  # noqa: B023
                a = activation_shape(u, c.shape[first])  # noqa: B023
                return np.einsum("tc,tck->tk", sample(a, view, n), weights)  # noqa: B023

            ref = moments(smooth_envelope(take.drive))
            rows = []
            for _ in range(draws):
                noise = gamma_noise(rng, take.drive.shape, s.person.noise["emg_cv"])
                rows.append((moments(smooth_envelope(take.drive * noise)) - ref).reshape(n, -1))
            x = np.concatenate(rows)
            block = x.T @ x / len(x)
            blocks += [0.8 * block + 0.2 * np.diag(np.diag(block))] * n
        size = POINTS * 5
        for i, block in enumerate(blocks):
            cov[i * size : (i + 1) * size, i * size : (i + 1) * size] += block
        return cov

    def residual(self, effects: Sequence[Effect], takes: list[Take]) -> np.ndarray:
        """Return the noise-free residual of the calibration cycles, flattened."""
        measured = self.session.measure(takes, effects)
        leg = self.session.person.leg
        for e in effects:
            leg = e.lab_leg(leg)
        out = []
        for base, take, (m, moments), n in zip(self.session.takes, takes, measured, self.cycles, strict=True):
            if not n:
                continue
            drive = envelope(take, self.peak, effects) * self.peak
            v = base.view
            if leg is not self.session.person.leg or not np.array_equal(m.q, v.rec.q):
                lmt, arms = geometry(leg, m.q)
            else:
                lmt, arms = v.lmt, v.arms
            model = forward(drive, View(v.person, v.rec, lmt, arms, v.muscles, v.speeds))
            out.append(sample(moments - model, v, n)[:, USED].ravel())
        return np.concatenate(out)

    def evaluate(self, effects: Sequence[Effect], adapt: int = 3) -> tuple[float, np.ndarray, list[Take]]:
        """Return d*, the signal and the true states of a case with effects."""
        takes = self.session.with_effects(effects, adapt)
        signal = self.residual(effects, takes) - self.base
        value = float(signal @ cho_solve(self.factor, signal))
        return float(np.sqrt(max(value, 0.0))), signal, takes
