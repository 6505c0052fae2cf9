"""Statistical tests of differences between methods, on samples of the same units: legs, cycles or muscles.

Differences are those of a method less the reference method. The result of a test is None with fewer than
three units; its statistics are NaN where they are undefined because nothing varies.
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

#: Smallest number of units of a test.
MINIMUM_UNITS = 3
#: Coverage of confidence intervals.
COVERAGE = 0.95
# Largest ratio of a standard deviation to the values that counts as rounding error.
_ROUNDING = 1e-12

Samples = Float[np.ndarray, " unit"]
# Groups of possibly different sizes.
Groups = Sequence[Float[np.ndarray, " _"]]
Key = TypeVar("Key")


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation (n - 1) of a sample; NaN where there are too few values."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Anova:
    """One-way analysis of variance of independent groups: F statistic, degrees of freedom and p value."""

    f: float
    between_df: int
    within_df: int
    p: float


@dataclass(frozen=True)
class RepeatedAnova:
    """One-way analysis of variance with repeated measures: every unit by every method.

    ``p_corrected`` has the correction of Greenhouse and Geisser (1959, doi:10.1007/BF02289823): both degrees
    of freedom are multiplied by ``epsilon``, which is 1 if the differences between all pairs of methods have
    the same variance (sphericity), and smaller otherwise.
    """

    f: float
    effect_df: int
    error_df: int
    p: float
    epsilon: float
    p_corrected: float


@dataclass(frozen=True)
class TukeyKramer:
    """Comparison of a pair of groups: difference, confidence limits and p value, corrected for all pairs."""

    difference: float
    low: float
    high: float
    p: float


@dataclass(frozen=True)
class PairedTest:
    """Two-sided Student's t-test of paired differences, with confidence limits ``low`` and ``high``.

    ``d_z`` is the mean difference divided by the standard deviation of the differences (Cohen 1988).
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
    """Compute mean and standard deviation of a sample."""
    mean = float(values.mean()) if len(values) else math.nan
    return Spread(mean, float(values.std(ddof=1)) if len(values) > 1 else math.nan)


def anova(groups: Groups) -> Anova | None:
    """Compare the means of independent groups; None if a group has fewer than three units.

    Values of one unit by several methods are not independent; use `repeated_anova` for these.
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
    """Compare all pairs of independent groups, possibly of different sizes, at one family-wise error rate.

    Returns
    -------
    dict
        Comparisons by pair of indices ``(first, second)``, first < second; differences are second less first.
        None if a group has fewer than three units.
    """
    if len(groups) < 2 or min(map(len, groups)) < MINIMUM_UNITS:
        return None
    df = sum(map(len, groups)) - len(groups)
    within = _mean_square_within(groups)
    defined = _varies(math.sqrt(within), np.concatenate(groups))
    comparisons = {}
    for first, second in combinations(range(len(groups)), 2):
        values, others = groups[second], groups[first]
        difference = float(values.mean() - others.mean())
        error = math.sqrt(within / 2.0 * (1.0 / len(values) + 1.0 / len(others))) if defined else math.nan
        half_width = _tukey_quantile(len(groups), df) * error
        p = float(stats.studentized_range.sf(abs(difference) / error, len(groups), df)) if defined else error
        comparisons[first, second] = TukeyKramer(
            difference, difference - half_width, difference + half_width, p
        )
    return comparisons


def repeated_anova(groups: Sequence[Samples]) -> RepeatedAnova | None:
    """Compare the means of groups with the same units in the same order; None with fewer than three units."""
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
    # Box's measure of sphericity, from the doubly centered covariance between methods.
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
    """Test paired differences, values less others, of the same units; None with fewer than three units."""
    n = len(values)
    if n < MINIMUM_UNITS:
        return None
    difference = values - others
    mean, deviation = float(difference.mean()), float(difference.std(ddof=1))
    if not _varies(deviation, np.concatenate([values, others])):
        return PairedTest(n, mean, math.nan, math.nan, math.nan, n - 1, math.nan, math.nan)
    error = deviation / math.sqrt(n)
    t = mean / error
    half_width = float(stats.t.ppf(0.5 + COVERAGE / 2.0, n - 1)) * error
    return PairedTest(
        n,
        mean,
        mean - half_width,
        mean + half_width,
        t,
        n - 1,
        float(2.0 * stats.t.sf(abs(t), n - 1)),
        mean / deviation,
    )


def holm(p: Mapping[Key, float]) -> dict[Key, float]:
    """Adjust the p values of a family of tests for multiple testing (Holm 1979); NaNs are not counted."""
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
    """Whether a standard deviation is finite and above rounding error."""
    return bool(deviation > _ROUNDING * np.abs(values).max()) and math.isfinite(deviation)


@lru_cache
def _tukey_quantile(groups: int, df: int) -> float:
    return float(stats.studentized_range.ppf(COVERAGE, groups, df))
