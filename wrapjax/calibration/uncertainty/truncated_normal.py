"""Draws from a multivariate normal distribution within bounds, by Gibbs sampling."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.special
from jaxtyping import Float

# Number of parallel chains, sweeps before the first draw, and sweeps from one draw to the next.
_CHAINS, _BURN_IN, _THINNING = 100, 25, 3


def draw_truncated_normal(
    mean: Float[np.ndarray, " variable"],
    covariance: Float[np.ndarray, "variable variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "draw variable"]:
    """Draw from a normal distribution truncated to bounds.

    A Gibbs sampler draws the variables with bounds, along every variable and along the principal axes of
    their covariance; the axes make it efficient where variables are strongly correlated. Variables without
    bounds are drawn from their exact conditional distribution.

    Parameters
    ----------
    mean
        Mean before truncation; it may lie outside the bounds.
    covariance
        Covariance before truncation, positive definite.
    lower, upper
        Bounds; infinite where there are none.
    count
        Number of draws.
    seed
        Seed of the draws.

    Returns
    -------
    Array
        Draws, all within the bounds.
    """
    generator = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    free = mean + generator.standard_normal((count, len(mean))) @ root.T
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not bounded.size:
        return free
    block = covariance[np.ix_(bounded, bounded)]
    box = lower[bounded], upper[bounded]
    bounded_draws = _gibbs(mean[bounded], block, *box, count, generator)
    # Shift unbounded variables by their regression on the change of the bounded ones (exact conditional).
    regression = scipy.linalg.solve(block, covariance[bounded], assume_a="pos")
    draws = free + (bounded_draws - free[:, bounded]) @ regression
    draws[:, bounded] = bounded_draws
    return draws


def _gibbs(
    mean: np.ndarray,
    covariance: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    count: int,
    generator: np.random.Generator,
) -> Float[np.ndarray, "draw variable"]:
    precision = scipy.linalg.inv(covariance)
    axes = np.concatenate([np.eye(len(mean)), scipy.linalg.eigh(covariance)[1].T])
    along = axes @ precision
    curvature = np.einsum("ij,ij->i", along, axes)
    start = mean + generator.standard_normal((_CHAINS, len(mean))) * np.sqrt(np.diag(covariance))
    at = np.clip(start, lower, upper)
    draws: list[np.ndarray] = []
    needed = -(-count // _CHAINS)
    for sweep in range(_BURN_IN + _THINNING * needed):
        for axis, (direction, weights, precision_along) in enumerate(
            zip(axes, along, curvature, strict=True)
        ):
            center = -((at - mean) @ weights) / precision_along
            if axis < len(mean):
                low, high = lower[axis] - at[:, axis], upper[axis] - at[:, axis]
            else:
                with np.errstate(divide="ignore", invalid="ignore"):
                    ends = np.stack([(lower - at) / direction, (upper - at) / direction])
                ends = np.where(np.abs(direction) > 1e-12, ends, [[[-np.inf]], [[np.inf]]])
                low, high = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
            step = _draw_truncated_univariate(center, 1.0 / np.sqrt(precision_along), low, high, generator)
            at = np.clip(at + step[:, None] * direction, lower, upper)
        if sweep >= _BURN_IN and (sweep - _BURN_IN) % _THINNING == 0:
            draws.append(at)
    return np.concatenate(draws)[:count]


def _draw_truncated_univariate(
    center: np.ndarray,
    deviation: float,
    low: np.ndarray,
    high: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Draw from univariate normal distributions truncated to intervals, accurately also far in a tail."""
    first, last = (low - center) / deviation, (high - center) / deviation
    mirrored = first + last > 0.0  # logarithms of probabilities are accurate in the lower tail
    bottom, top = np.where(mirrored, -last, first), np.where(mirrored, -first, last)
    fraction = generator.uniform(1e-12, 1.0, len(center))
    logs = scipy.special.log_ndtr(bottom), scipy.special.log_ndtr(top)
    drawn = scipy.special.ndtri_exp(np.logaddexp(logs[0] + np.log1p(-fraction), logs[1] + np.log(fraction)))
    drawn = np.clip(drawn, bottom, np.maximum(bottom, top))
    return np.asarray(center + deviation * np.where(mirrored, -drawn, drawn))
