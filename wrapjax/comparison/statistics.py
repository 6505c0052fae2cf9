"""Tests of whether methods differ, on samples of the same units: legs, or cycles, or muscles.

Differences are those of a method less the one it is compared with. A test of fewer than three units is
None; one that is not defined (nothing varies) has NaN where a statistic would be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from scipy import stats

#: Fewer units than these are not tested.
MINIMUM_UNITS = 3
#: Coverage of every interval.
COVERAGE = 0.95
# A standard deviation this small beside the values is rounding.
_ROUNDING = 1e-12

Samples = Float[np.ndarray, " unit"]
# Groups that may differ in size.
Groups = Sequence[Float[np.ndarray, " _"]]
Key = TypeVar("Key")


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation (n - 1) of a sample; NaN where there are too few."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Anova:
    """One-way analysis of variance of independent groups."""

    f: float
    between_df: int
    within_df: int
    p: float


@dataclass(frozen=True)
class RepeatedAnova:
    """One-way analysis of variance of repeated measures, every unit by every method.

    ``p_corrected`` is Greenhouse and Geisser's: both degrees of freedom are multiplied by ``epsilon``, which
    is 1 where differences between all pairs of methods vary alike and less where they do not.
    """

    f: float
    effect_df: int
    error_df: int
    p: float
    epsilon: float
    p_corrected: float


@dataclass(frozen=True)
class TukeyKramer:
    """One pair of groups of an `Anova`, with all pairs taken into account."""

    difference: float
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class PairedTest:
    """Student's t-test of paired differences, two-sided.

    ``d_z`` is the mean difference over the standard deviation of the differences (Cohen 1988).
    """

    n: int
    difference: float
    low: float
    high: float
    t: float
    df: int
    p: float
    d_z: float


def spread(values: Samples) -> Spread:
    """Summarize a sample."""
    mean = float(values.mean()) if len(values) else math.nan
    return Spread(mean, float(values.std(ddof=1)) if len(values) > 1 else math.nan)


def anova(groups: Groups) -> Anova | None:
    """Compare the means of independent groups; None where one has fewer than three units.

    Values of one unit by several methods are not independent: `repeated_anova` knows that.
    """
    if len(groups) < 2 or min(map(len, groups)) < MINIMUM_UNITS:
        return None
    between_df, within_df = len(groups) - 1, sum(map(len, groups)) - len(groups)
    within = _mean_square_within(groups)
    everything = np.concatenate(groups)
    between = sum(len(group) * (group.mean() - everything.mean()) ** 2 for group in groups) / between_df
    f = float(between / within) if _varies(math.sqrt(within), everything) else math.nan
    return Anova(f, between_df, within_df, float(stats.f.sf(f, between_df, within_df)))


def tukey_kramer(groups: Groups) -> dict[tuple[int, int], TukeyKramer] | None:
    """Compare all pairs of independent groups, which may differ in size, at one error rate.

    Returns
    -------
    dict
        By pair ``(first, second)``, first before second: second less first. None as in `anova`.
    """
    if len(groups) < 2 or min(map(len, groups)) < MINIMUM_UNITS:
        return None
    df = sum(map(len, groups)) - len(groups)
    within = _mean_square_within(groups)
    defined = _varies(math.sqrt(within), np.concatenate(groups))
    found = {}
    for first, second in combinations(range(len(groups)), 2):
        ours, theirs = groups[second], groups[first]
        difference = float(ours.mean() - theirs.mean())
        error = math.sqrt(within / 2.0 * (1.0 / len(ours) + 1.0 / len(theirs))) if defined else math.nan
        reach = _tukey_quantile(len(groups), df) * error
        p = float(stats.studentized_range.sf(abs(difference) / error, len(groups), df)) if defined else error
        found[first, second] = TukeyKramer(difference, difference - reach, difference + reach, p)
    return found


def repeated_anova(groups: Sequence[Samples]) -> RepeatedAnova | None:
    """Compare the means of groups that hold the same units in the same order; None below three units."""
    if len(groups) < 2 or min(map(len, groups)) < MINIMUM_UNITS:
        return None
    table = np.stack(groups, axis=1)
    units, methods = table.shape
    effect_df, error_df = methods - 1, (units - 1) * (methods - 1)
    residual = table - table.mean(axis=0) - table.mean(axis=1, keepdims=True) + table.mean()
    effect = units * ((table.mean(axis=0) - table.mean()) ** 2).sum() / effect_df
    error = (residual**2).sum() / error_df
    if not _varies(math.sqrt(error), table):
        return RepeatedAnova(math.nan, effect_df, error_df, math.nan, math.nan, math.nan)
    f = float(effect / error)
    # Box's measure of sphericity, of the doubly centered covariance between methods.
    covariance = residual.T @ residual
    epsilon = float(np.trace(covariance) ** 2 / (effect_df * (covariance**2).sum()))
    return RepeatedAnova(
        f,
        effect_df,
        error_df,
        float(stats.f.sf(f, effect_df, error_df)),
        epsilon,
        float(stats.f.sf(f, epsilon * effect_df, epsilon * error_df)),
    )


def paired_test(values: Samples, others: Samples) -> PairedTest | None:
    """Test whether values differ from others of the same units in the same order; None below three units."""
    n = len(values)
    if n < MINIMUM_UNITS:
        return None
    difference = values - others
    mean, deviation = float(difference.mean()), float(difference.std(ddof=1))
    if not _varies(deviation, np.concatenate([values, others])):
        return PairedTest(n, mean, math.nan, math.nan, math.nan, n - 1, math.nan, math.nan)
    error = deviation / math.sqrt(n)
    t = mean / error
    reach = float(stats.t.ppf(0.5 + COVERAGE / 2.0, n - 1)) * error
    return PairedTest(
        n,
        mean,
        mean - reach,
        mean + reach,
        t,
        n - 1,
        float(2.0 * stats.t.sf(abs(t), n - 1)),
        mean / deviation,
    )


def holm(p: Mapping[Key, float]) -> dict[Key, float]:
    """Adjust p values of one family of tests for their number (Holm 1979); NaNs do not count."""
    counted = sorted((key for key in p if not math.isnan(p[key])), key=lambda key: p[key])
    adjusted, highest = dict(p), 0.0
    for rank, key in enumerate(counted):
        highest = max(highest, min(1.0, (len(counted) - rank) * p[key]))
        adjusted[key] = highest
    return adjusted


def _mean_square_within(groups: Groups) -> float:
    squares = sum(((group - group.mean()) ** 2).sum() for group in groups)
    return float(squares / (sum(map(len, groups)) - len(groups)))


def _varies(deviation: float, values: np.ndarray) -> bool:
    """Tell a standard deviation from rounding; what is not finite does not count as varying."""
    return bool(deviation > _ROUNDING * np.abs(values).max()) and math.isfinite(deviation)


@lru_cache
def _tukey_quantile(groups: int, df: int) -> float:
    return float(stats.studentized_range.ppf(COVERAGE, groups, df))
