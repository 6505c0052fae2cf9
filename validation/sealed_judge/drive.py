"""Neural drive that reproduces the joint moments of walking.

First the mean cycle of a speed: non-negative least squares over periodic cubic B-splines, one drive per
electrode, with a penalty on effort and a weak prior of textbook bursts.  Then a whole recording: the repeated
mean drive times the exponential of a spline, corrected by Gauss-Newton steps with a banded normal matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from . import anatomy, gait
from .muscle import RATE, Constants, activation_shape, kernel, unit_forces

#: Weight of the six moments in the fit; hip rotation counts little.
WEIGHT = np.array([1.0, 1.0, 0.15, 1.0, 1.0, 1.5])
FIRST = [anatomy.NAMES.index(m[0]) for m in anatomy.CHANNELS.values()]


#: Standard deviation (s) of the Gaussian that limits the bandwidth of every drive to about 6 Hz.
SMOOTH = 0.040
#: Penalty on the logarithmic correction of the drive.
PULL = 3.0


def band_limit(drive: np.ndarray) -> np.ndarray:
    """Return the drive without content that no low-passed electromyogram could show."""
    return gaussian_filter1d(drive, SMOOTH * RATE, axis=0, mode="nearest")


def channel_weights(lmt: np.ndarray, arms: np.ndarray, c: Constants) -> tuple[np.ndarray, np.ndarray]:
    """Return moment per unit activation of each electrode (T, C, 6) and the passive moment (T, 6)."""
    gain, slack = unit_forces(lmt, c)
    per = np.einsum("tm,tmk,mc->tck", gain, arms, anatomy.channel_matrix())
    return per, np.einsum("tm,tmk->tk", slack, arms)


def burst_prior(phase: np.ndarray) -> np.ndarray:
    """Return the textbook bursts of every electrode, shape (T, C)."""
    out = np.zeros((len(phase), len(anatomy.CHANNELS)))
    for j, name in enumerate(anatomy.CHANNELS):
        for centre, width, height in gait.BURSTS[name]:
            gap = np.mod(100 * phase - centre + 50, 100) - 50
            out[:, j] += height * np.exp(-0.5 * (gap / (0.7 * width)) ** 2)
    return out


def mean_drive(
    phase: np.ndarray, period: float, per: np.ndarray, rest: np.ndarray, c: Constants, knots: int = 16
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the periodic drive of a mean cycle as a function of phase.

    Parameters
    ----------
    phase : ndarray
        Evenly spaced phases of one cycle, shape (N,).
    period : float
        Cycle time, s.
    per : ndarray
        Moment per unit activation, shape (N, C, 6).
    rest : ndarray
        Moment that active muscles must supply, shape (N, 6).
    c : Constants
        Muscle constants.
    knots : int
        Spline knots in a cycle.

    Returns
    -------
    callable
        Drive of the electrodes (T, C) at given phases.
    """
    channels = len(anatomy.CHANNELS)
    scale = WEIGHT / np.maximum(0.02 * np.abs(rest).max(axis=0), 0.4)
    fine = _periodic_basis(np.arange(int(period * RATE)) / int(period * RATE), knots)
    filtered = []
    for j in FIRST:
        taps = kernel(float(c.delay[j]), float(c.twitch[j]))
        loop = np.zeros(len(fine))
        np.add.at(loop, np.arange(len(taps)) % len(fine), taps)
        smooth = np.fft.irfft(np.fft.rfft(loop)[:, None] * np.fft.rfft(fine, axis=0), len(fine), axis=0)
        at = phase * len(fine)
        low = np.floor(at).astype(int)
        part = (at - low)[:, None]
        filtered.append((1 - part) * smooth[low % len(fine)] + part * smooth[(low + 1) % len(fine)])
    centres = (np.arange(knots) + 0.0) / knots
    prior = 0.6 * burst_prior(centres) + 0.015
    x = prior.copy()
    shape = c.shape[FIRST]
    trust = np.where(phase < 0.62, 0.6, 1.5)
    second = np.eye(knots) - 0.5 * (np.roll(np.eye(knots), 1, 0) + np.roll(np.eye(knots), -1, 0))
    for _ in range(4):
        u = np.stack([filtered[j] @ x[:, j] for j in range(channels)], axis=1)
        a = activation_shape(u, shape)
        slope = shape * np.exp(shape * u) / np.expm1(shape)
        blocks, target = [], []
        for k in range(6):
            cols = [scale[k] * (per[:, j, k] * slope[:, j])[:, None] * filtered[j] for j in range(channels)]
            lin = sum(per[:, j, k] * (a[:, j] - slope[:, j] * u[:, j]) for j in range(channels))
            blocks.append(trust[:, None] * np.hstack(cols))
            target.append(trust * scale[k] * (rest[:, k] - lin))
        pull = np.eye(knots * channels) * 4.0
        blocks += [pull, np.kron(np.eye(channels), second) * 5.0]
        target += [4.0 * prior.T.ravel(), np.zeros(knots * channels)]
        normal = np.vstack(blocks)
        chol = np.linalg.cholesky(normal.T @ normal)
        solved = nnls(chol.T, np.linalg.solve(chol, normal.T @ np.concatenate(target)), maxiter=20000)[0]
        x = np.clip(solved.reshape(channels, knots).T, 0.008, 0.95)
    return lambda at: _periodic_basis(at, knots) @ x


def _periodic_basis(phase: np.ndarray, knots: int) -> np.ndarray:
    """Return periodic cubic B-splines, shape (T, knots)."""
    gap = np.mod(np.asarray(phase)[:, None] * knots - np.arange(knots) + knots / 2, knots) - knots / 2
    d = np.abs(gap)
    return np.where(d < 1, 2 / 3 - d**2 + d**3 / 2, np.where(d < 2, (2 - d) ** 3 / 6, 0.0))


class DriveFit:
    """Correct the drive of one recording until the forward moments meet the wanted ones.

    Parameters
    ----------
    start : ndarray
        First drive, shape (T, C).
    per : ndarray
        Moment per unit activation, shape (T, C, 6).
    c : Constants
        Muscle constants.
    wanted : ndarray
        Wanted moments, shape (T, 6).
    trust : ndarray
        Weight of each frame: low in stance, where a shift of the ground reaction can absorb the rest.
    """

    def __init__(
        self, start: np.ndarray, per: np.ndarray, c: Constants, wanted: np.ndarray, trust: np.ndarray
    ) -> None:
        self.start, self.wanted = start, wanted
        frames, channels = start.shape
        spacing = 18
        count = frames // spacing + 4
        knots = np.arange(-3, count + 1) * spacing
        self.basis = sp.csr_matrix(
            BSpline.design_matrix(np.arange(frames, dtype=float), knots.astype(float), 3)
        )
        self.scale = trust[:, None] * WEIGHT / np.maximum(0.008 * np.abs(wanted).max(axis=0), 0.15)
        self.rows = slice(0, frames, 2)
        # Taps of the band limit, as a matrix.
        width = int(4 * SMOOTH * RATE)
        bell = np.exp(-0.5 * (np.arange(-width, width + 1) / (SMOOTH * RATE)) ** 2)
        bell = sp.diags(list(bell / bell.sum()), list(range(-width, width + 1)), shape=(frames, frames))
        columns = []
        for j in range(channels):
            m = FIRST[j]
            taps = kernel(float(c.delay[m]), float(c.twitch[m]))
            toeplitz = sp.diags(list(taps), list(-np.arange(len(taps))), shape=(frames, frames), format="csr")
            u = toeplitz @ start[:, j]
            slope = c.shape[m] * np.exp(c.shape[m] * u) / np.expm1(c.shape[m])
            block = (toeplitz @ (bell @ (sp.diags(start[:, j]) @ self.basis)).tocsr())[self.rows]
            weights = (per[:, j] * slope[:, None] * self.scale)[self.rows]
            columns.append(sp.vstack([sp.diags(weights[:, k]) @ block for k in range(6)]).tocsc())
        splines = self.basis.shape[1]
        order = np.arange(channels * splines).reshape(channels, splines).T.ravel()
        self.jac = sp.hstack(columns).tocsc()[:, order]
        self.size = (splines, channels)
        normal = (self.jac.T @ self.jac + sp.eye(self.jac.shape[1]) * PULL).tocoo()
        width = int((normal.row - normal.col).max())
        band = np.zeros((width + 1, normal.shape[0]))
        lower = normal.row >= normal.col
        band[(normal.row - normal.col)[lower], normal.col[lower]] = normal.data[lower]
        self.factor = cholesky_banded(band, lower=True)

    def solve(
        self, forward: Callable[[np.ndarray], np.ndarray], steps: int = 10, fresh: bool = True
    ) -> np.ndarray:
        """Return the drive for a forward model of the moments.

        Parameters
        ----------
        forward : callable
            Moments (T, 6) of a drive (T, C).
        steps : int
            Number of Gauss-Newton steps.
        fresh : bool
            Limit the bandwidth of the result; False where the first drive is limited already.

        Returns
        -------
        ndarray
            Drive, shape (T, C).
        """
        limit = band_limit if fresh else (lambda x: x)

        def drive_of(c: np.ndarray) -> np.ndarray:
            return limit(np.minimum(self.start * np.exp(self.basis @ c), 1.0))

        def gap_of(c: np.ndarray) -> np.ndarray:
            return ((self.wanted - forward(drive_of(c))) * self.scale)[self.rows].T.ravel()

        c = np.zeros(self.size)
        gap = gap_of(c)
        length = 1.0
        for _ in range(steps):
            move = cho_solve_banded((self.factor, True), self.jac.T @ gap - PULL * c.ravel()).reshape(
                self.size
            )
            trial = np.clip(c + length * move, -1.6, 1.6)
            new = gap_of(trial)
            if new @ new + PULL * np.sum(trial**2) < gap @ gap + PULL * np.sum(c**2):
                c, gap, length = trial, new, min(1.0, 2.0 * length)
            else:
                length *= 0.4
        return drive_of(c)
