"""How far the error shrinks on cycles that a fit has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from wrapjax.diagnosis.result import Estimate

#: Resamples of cycles.
RESAMPLES = 500
# Of the variance between cycles: some of it is always noise.
_MOST_DRIVEN = 0.8
Errors = Float[np.ndarray, " cycle"]


@dataclass(frozen=True)
class Floor:
    """Mean squared error of each cycle that would be left of a model right on average, (N m)^2.

    Parameters
    ----------
    each
        By cycle; not finite where every cycle is alone at its speed.
    most
        The same if nothing that differs between cycles could be explained: how much can is an estimate.
    doubt
        Relative standard deviation of all of them together.
    """

    each: Errors
    most: Errors
    doubt: float

    @property
    def known(self) -> bool:
        """Whether some speed has more than one cycle."""
        return bool(np.isfinite(self.each).all())

    def of(self, cycles: Bool[np.ndarray, " cycle"]) -> Floor:
        """Keep some cycles."""
        return Floor(self.each[cycles], self.most[cycles], self.doubt)


def cycle_errors(residuals: Float[np.ndarray, "cycle coordinate frame"]) -> Errors:
    """Mean squared error of each cycle, (N m)^2."""
    return np.mean(residuals**2, axis=(1, 2))


def cycle_floor(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    independent: float,
    driven: Float[np.ndarray, " speed"] | None = None,
) -> Floor:
    """Estimate what a right model would leave, from how far cycles are from the mean one of their speed.

    That mean is a little too near. A cycle alone at its speed takes the mean of the others.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Counted from 0.
    independent
        Number of independent values of noise in a cycle, over all coordinates.
    driven
        Variance between cycles that follows what was recorded of them, by speed: no noise.
    """
    each, most, freedom = np.full(len(residuals), np.nan), np.full(len(residuals), np.nan), []
    for speed in np.unique(speeds):
        own = speeds == speed
        count = int(own.sum())
        if count > 1:
            apart = residuals[own] - residuals[own].mean(axis=0)
            most[own] = cycle_errors(apart) * count / (count - 1.0)
            share = 0.0 if driven is None else driven[speed] / np.mean(most[own])
            each[own] = most[own] * (1.0 - np.clip(share, 0.0, _MOST_DRIVEN))
            freedom.append(count - 1.0)
    if freedom:
        each, most = (np.where(np.isnan(one), np.nanmean(one), one) for one in (each, most))
    # Deviations hold the noise that there was, but for what the mean of few cycles took of it.
    doubt = np.sqrt(2.0 / independent * np.sum(1.0 / np.square(freedom))) / max(len(freedom), 1)
    return Floor(each, most, float(doubt))


def explainable_share(
    before: Errors, floor: Floor, speeds: Int[np.ndarray, " cycle"], seed: int = 0
) -> Estimate:
    """Part of the whole error that a better model could take away; see `shrinkage`."""
    if not floor.known:
        return Estimate.unknown(_ALONE)
    whole, left = _drawn(before, speeds, seed), _drawn_floor(floor, speeds, seed)
    return _ratio(whole - left, whole, speeds)


def shrinkage(
    before: Errors, after: Errors, floor: Floor, speeds: Int[np.ndarray, " cycle"], seed: int = 0
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
    narrow. The floor is drawn as well: with all or less of what may be driven in it, and within its doubt.
    """
    if not floor.known:
        return Estimate.unknown(_ALONE)
    whole, left = _drawn(before, speeds, seed), _drawn_floor(floor, speeds, seed)
    return _ratio(_drawn(before - after, speeds, seed), whole - left, speeds)


_ALONE = "one cycle a speed cannot show how much of the error is noise"


# A mean over cycles, and the same over cycles that were drawn again.
Means = Float[np.ndarray, " draw"]


def _drawn(values: Errors, speeds: Int[np.ndarray, " cycle"], seed: int) -> Means:
    """Take the mean over cycles, first of all of them, then of as many that are drawn within each speed."""
    generator = np.random.default_rng(seed)
    groups = [np.flatnonzero(speeds == speed) for speed in np.unique(speeds)]
    drawn = np.concatenate([generator.choice(own, (RESAMPLES, len(own))) for own in groups], axis=1)
    return np.append(np.mean(values), np.mean(values[drawn], axis=1))


def _drawn_floor(floor: Floor, speeds: Int[np.ndarray, " cycle"], seed: int) -> Means:
    """Draw the floor of the same cycles, first as it is."""
    generator = np.random.default_rng([seed, 1])
    each, most = (_drawn(one, speeds, seed) for one in (floor.each, floor.most))
    undriven = np.append(0.0, generator.uniform(size=RESAMPLES))
    off = np.append(0.0, generator.normal(size=RESAMPLES))
    return (each + undriven * (most - each)) * (1.0 + floor.doubt * off)


def _ratio(of: Means, to: Means, speeds: Int[np.ndarray, " cycle"]) -> Estimate:
    """Give the ratio of two means over cycles."""
    freedom = max(len(speeds) - len(np.unique(speeds)), 1)
    wider = stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975) * np.sqrt(len(speeds) / freedom)
    if to[0] - wider * (to[0] - np.quantile(to[1:], 0.025)) <= 0.0:
        return Estimate.unknown("the error cannot be told from noise on these cycles")
    value = float(of[0] / to[0])
    low, high = (value + wider * (np.quantile(of[1:] / to[1:], at) - value) for at in (0.025, 0.975))
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
