"""One-sided 95 % bounds of figures with cases clustered by person, and verdicts against targets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

MET, FAILED, UNCLEAR = "met", "failed", "not distinguishable"
LEVEL = 0.95
_DRAWS = 500
#: Correlation within persons that is assumed if all cases agree, where it cannot be estimated.
_ASSUMED_CORRELATION = 0.05


@dataclass(frozen=True)
class Figure:
    """Value with one-sided 95 % bounds and the number of cases; None without cases."""

    value: float | None
    lower: float | None = None
    upper: float | None = None
    n: int = 0


@dataclass(frozen=True)
class Target:
    """Lower bound, upper bound, or both, of a figure."""

    least: float | None = None
    most: float | None = None

    def __str__(self) -> str:
        if self.least is not None and self.most is not None:
            return f"{self.least:g} to {self.most:g}"
        return f"at least {self.least:g}" if self.least is not None else f"at most {self.most:g}"


def verdict(figure: Figure, target: Target | None) -> str:
    """Return met or failed if the interval is entirely on one side, otherwise not distinguishable."""
    if target is None or figure.value is None or figure.lower is None or figure.upper is None:
        return ""
    least = -np.inf if target.least is None else target.least
    most = np.inf if target.most is None else target.most
    if figure.upper < least or figure.lower > most:
        return FAILED
    return MET if figure.lower >= least and figure.upper <= most else UNCLEAR


def share(hits: np.ndarray, people: np.ndarray) -> Figure:
    """Compute a share of cases, with a Clopper-Pearson interval for the effective number of cases."""
    hits = np.asarray(hits, float)
    n = hits.size
    if n == 0:
        return Figure(None)
    mean = float(hits.mean())
    effective = n / _design_effect(hits, np.asarray(people), mean)
    k = mean * effective
    lower = float(beta.ppf(1 - LEVEL, k, effective - k + 1)) if k > 0 else 0.0
    upper = float(beta.ppf(LEVEL, k + 1, effective - k)) if k < effective else 1.0
    return Figure(mean, lower, upper, n)


def _design_effect(hits: np.ndarray, people: np.ndarray, mean: float) -> float:
    names, group = np.unique(people, return_inverse=True)
    count = names.size
    if count < 2:
        return 1.0
    assumed = 1.0 + _ASSUMED_CORRELATION * (hits.size / count - 1.0)
    if mean in (0.0, 1.0):
        return max(1.0, assumed)
    sums = np.bincount(group, hits - mean)
    variance = count / (count - 1) * float((sums**2).sum()) / hits.size**2
    return max(1.0, variance / (mean * (1.0 - mean) / hits.size))


def statistic(
    values: np.ndarray, people: np.ndarray, of: Callable[[np.ndarray], float], seed: int = 1
) -> Figure:
    """Compute a statistic of rows, with bounds by a bootstrap over persons."""
    values, people = np.asarray(values), np.asarray(people)
    if values.shape[0] == 0:
        return Figure(None)
    rng = np.random.default_rng(seed)
    rows = [np.flatnonzero(people == name) for name in np.unique(people)]
    draws = [
        of(values[np.concatenate([rows[i] for i in rng.integers(len(rows), size=len(rows))])])
        for _ in range(_DRAWS)
    ]
    value = float(of(values))
    known = np.array(draws)[np.isfinite(draws)]
    if not known.size or not np.isfinite(value):
        return Figure(value if np.isfinite(value) else None, n=values.shape[0])
    lower, upper = np.quantile(known, [1 - LEVEL, LEVEL], method="inverted_cdf")
    return Figure(value, float(lower), float(upper), values.shape[0])
