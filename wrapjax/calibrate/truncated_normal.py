"""Draws of a normal distribution of many variables within bounds."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.special
from jaxtyping import Float

# Chains side by side, sweeps before the first draw is kept, and between two that are.
_CHAINS, _BURN_IN, _BETWEEN = 100, 25, 3


def draw_within(
    mean: Float[np.ndarray, " variable"],
    covariance: Float[np.ndarray, "variable variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "draw variable"]:
    """Draw from a normal distribution of which only what is within bounds counts.

    By Gibbs' sampler, along every variable and along the principal axes of those with bounds: the former
    leave corners quickly, the latter follow valleys. Variables without bounds follow exactly.

    Parameters
    ----------
    mean
        May lie outside the bounds.
    covariance
        Positive definite.
    lower, upper
        Infinite where there are none.
    count
        Number of draws.
    seed
        Of the draws.
    """
    generator = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    free = mean + generator.standard_normal((count, len(mean))) @ root.T
    bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not bounded.size:
        return free
    block = covariance[np.ix_(bounded, bounded)]
    box = lower[bounded], upper[bounded]
    kept = _gibbs(mean[bounded], block, *box, count, generator)
    # Others keep what they are beside what those with bounds say of them.
    follow = scipy.linalg.solve(block, covariance[bounded], assume_a="pos")
    draws = free + (kept - free[:, bounded]) @ follow
    draws[:, bounded] = kept
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
    for sweep in range(_BURN_IN + _BETWEEN * needed):
        for axis, (direction, weights, own) in enumerate(zip(axes, along, curvature, strict=True)):
            center = -((at - mean) @ weights) / own
            if axis < len(mean):
                low, high = lower[axis] - at[:, axis], upper[axis] - at[:, axis]
            else:
                with np.errstate(divide="ignore", invalid="ignore"):
                    ends = np.stack([(lower - at) / direction, (upper - at) / direction])
                ends = np.where(np.abs(direction) > 1e-12, ends, [[[-np.inf]], [[np.inf]]])
                low, high = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
            step = _within(center, 1.0 / np.sqrt(own), low, high, generator)
            at = np.clip(at + step[:, None] * direction, lower, upper)
        if sweep >= _BURN_IN and (sweep - _BURN_IN) % _BETWEEN == 0:
            draws.append(at)
    return np.concatenate(draws)[:count]


def _within(
    center: np.ndarray,
    deviation: float,
    low: np.ndarray,
    high: np.ndarray,
    generator: np.random.Generator,
) -> np.ndarray:
    """Draw single normal values between two ends, also far out in a tail."""
    first, last = (low - center) / deviation, (high - center) / deviation
    turned = first + last > 0.0  # logarithms of probabilities are exact in the lower tail
    bottom, top = np.where(turned, -last, first), np.where(turned, -first, last)
    share = generator.uniform(1e-12, 1.0, len(center))
    logs = scipy.special.log_ndtr(bottom), scipy.special.log_ndtr(top)
    drawn = scipy.special.ndtri_exp(np.logaddexp(logs[0] + np.log1p(-share), logs[1] + np.log(share)))
    drawn = np.clip(drawn, bottom, np.maximum(bottom, top))
    return np.asarray(center + deviation * np.where(turned, -drawn, drawn))
