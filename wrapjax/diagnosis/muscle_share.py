"""Which muscle forces would take the error away, as far as moment arms can tell."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.null_covariance import periodic_kernel
from wrapjax.diagnosis.result import MuscleShare

#: How far a muscle's force may be off, in maximum isometric forces, and over how much of a cycle alike.
FORCE_ERROR, WIDTH = 0.05, 0.05


def muscle_share(
    muscles: tuple[str, ...],
    residual: Float[np.ndarray, "cycle coordinate phase"],
    arms: Float[np.ndarray, "muscle cycle coordinate phase"],
    max_isometric_force: Float[np.ndarray, " muscle"],
    noise: Float[np.ndarray, " coordinate"],
    speeds: Int[np.ndarray, " cycle"],
) -> MuscleShare:
    """Share the mean residual of each speed out to muscles, the smallest forces that smoothly explain it.

    A normal prior of every muscle's force, independent of the others', and what its posterior says.

    Parameters
    ----------
    muscles
        Names.
    residual
        Measured less predicted moments, N m.
    arms
        Moment arms, m.
    max_isometric_force
        N.
    noise
        Standard deviation of each coordinate's residual between cycles, N m.
    speeds
        Of each cycle, counted from 0.
    """
    phases = residual.shape[-1]
    kernel = periodic_kernel(phases, WIDTH)
    prior = (FORCE_ERROR * max_isometric_force) ** 2
    forces, resolutions = [], []
    for speed in np.unique(speeds):
        own = speeds == speed
        mean, arm = residual[own].mean(axis=0), arms[:, own].mean(axis=1)
        rows = mean.size
        # Covariance of the moments that random forces give.
        spread = np.einsum("m,mkp,mlq->kplq", prior, arm, arm) * kernel[None, :, None, :]
        of_noise = np.repeat(noise**2 / own.sum() + 1e-6, phases)
        total = spread.reshape(rows, rows) + np.diag(of_noise)
        # Of every muscle's force with the moments.
        across = prior[:, None, None, None] * kernel[None, :, None, :] * arm[:, None, :, :]
        across = across.reshape(len(muscles), phases, rows)
        forces.append(across @ np.linalg.solve(total, mean.ravel()))
        solved = np.linalg.solve(total, across.reshape(-1, rows).T)
        known = np.einsum("ij,ji->i", across.reshape(-1, rows), solved).reshape(len(muscles), phases)
        resolutions.append(known.mean(axis=1) / prior)
    return MuscleShare(muscles, np.stack(forces, axis=1), np.clip(np.mean(resolutions, axis=0), 0.0, 1.0))
