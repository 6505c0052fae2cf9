"""How far the error shrinks on cycles that a fit has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import factorial

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from wrapjax.gap.result import Estimate

#: Resamples of cycles.
RESAMPLES = 500
# Of the variance between cycles: some of it is always noise.
_MOST_DRIVEN = 0.8
Errors = Float[np.ndarray, " cycle"]


def cycle_errors(residuals: Float[np.ndarray, "cycle coordinate frame"]) -> Errors:
    """Mean squared error of each cycle, (N m)^2."""
    return np.mean(residuals**2, axis=(1, 2))


def cycle_floor(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    driven: Float[np.ndarray, " speed"] | None = None,
) -> Errors:
    """Mean squared error of each cycle that would be left of a model right on average, (N m)^2.

    From how far it is from the mean cycle of its speed, which is a little too near. A cycle alone at its
    speed takes the mean of the others.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Counted from 0.
    driven
        Variance between cycles that follows what was recorded of them, by speed: no noise.
    """
    floor = np.full(len(residuals), np.nan)
    for speed in np.unique(speeds):
        own = speeds == speed
        if own.sum() > 1:
            apart = residuals[own] - residuals[own].mean(axis=0)
            floor[own] = cycle_errors(apart) * own.sum() / (own.sum() - 1.0)
            if driven is not None:
                share = driven[speed] / np.mean(floor[own])
                floor[own] *= 1.0 - np.clip(share, 0.0, _MOST_DRIVEN)
    return np.where(np.isnan(floor), np.nanmean(floor) if np.isfinite(floor).any() else np.nan, floor)


def explainable_share(
    before: Errors, floor: Errors, speeds: Int[np.ndarray, " cycle"], seed: int = 0
) -> Estimate:
    """Part of the whole error that a better model could take away; see `shrinkage`."""
    if not np.isfinite(floor).all():
        return Estimate.unknown(_ALONE)
    return _ratio(before - floor, before, speeds, seed)


def shrinkage(
    before: Errors, after: Errors, floor: Errors, speeds: Int[np.ndarray, " cycle"], seed: int = 0
) -> Estimate:
    """Share of the explainable error that is gone: (before - after) / (before - floor), not clipped.

    Parameters
    ----------
    before, after
        Mean squared errors of cycles that fits have not seen, without and with the effect.
    floor
        What a right model would leave.
    speeds
        Cycles are drawn again within each.
    seed
        Of the draws.

    Notes
    -----
    The interval is a percentile bootstrap over cycles, widened by Student's t as that of few cycles is too
    narrow.
    """
    if not np.isfinite(floor).all():
        return Estimate.unknown(_ALONE)
    return _ratio(before - after, before - floor, speeds, seed)


_ALONE = "one cycle a speed cannot show how much of the error is noise"


def _ratio(of: Errors, to: Errors, speeds: Int[np.ndarray, " cycle"], seed: int) -> Estimate:
    """Give the ratio of two means over cycles."""
    generator = np.random.default_rng(seed)
    groups = [np.flatnonzero(speeds == speed) for speed in np.unique(speeds)]
    drawn = np.concatenate([generator.choice(own, (RESAMPLES, len(own))) for own in groups], axis=1)
    freedom = max(len(to) - len(groups), 1)
    wider = stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975) * np.sqrt(len(to) / freedom)
    middle, below = float(np.mean(to)), np.mean(to[drawn], axis=1)
    if middle - wider * (middle - np.quantile(below, 0.025)) <= 0.0:
        return Estimate.unknown("the error cannot be told from noise on these cycles")
    value = float(np.mean(of) / middle)
    shares = np.mean(of[drawn], axis=1) / below
    low, high = (value + wider * (np.quantile(shares, at) - value) for at in (0.025, 0.975))
    return Estimate(value, float(low), float(high))


def shapley(members: Sequence[str], removed: Callable[[tuple[str, ...]], float]) -> dict[str, float]:
    """Share out what several effects remove together, averaged over the orders in which they can enter.

    Parameters
    ----------
    members
        Ids.
    removed
        What any part of them removes, in their order; of none it is asked for, too.
    """
    count = len(members)
    worth = {part: removed(part) for size in range(count + 1) for part in combinations(members, size)}
    shares = {}
    for member in members:
        total = 0.0
        for part, value in worth.items():
            if member not in part:
                joined = tuple(name for name in members if name in part or name == member)
                weight = factorial(len(part)) * factorial(count - len(part) - 1) / factorial(count)
                total += weight * (worth[joined] - value)
        shares[member] = total
    return shares
