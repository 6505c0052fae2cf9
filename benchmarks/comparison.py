"""What got worse since an earlier run, beyond each number's own tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from benchmarks.metric import MACHINE_UNITS, Metric


def worsening(before: float, now: Metric) -> float:
    """By how much of itself a number got worse; 0 where it did not, infinite where it is none any more."""
    if math.isnan(now.value):
        return 0.0 if math.isnan(before) else math.inf
    if math.isnan(before):
        return 0.0
    better, worse = (before, now.value) if now.better == "lower" else (now.value, before)
    if worse - better <= now.negligible:
        return 0.0
    return worse / better - 1.0 if better > 0.0 else math.inf


def regressions(
    before: Mapping[str, Metric], now: Sequence[Metric], *, same_machine: bool, same_set: bool
) -> list[str]:
    """Say what got worse, a sentence each.

    Parameters
    ----------
    before
        The earlier run's numbers by their names.
    now
        This run's; their tolerances hold.
    same_machine
        Whether both ran on one kind of processor; times of different ones are not compared.
    same_set
        Whether both were asked for the same things: then what is missing now is worse.
    """
    worse = []
    for metric in now:
        if metric.name not in before or (metric.unit in MACHINE_UNITS and not same_machine):
            continue
        earlier = before[metric.name].value
        change = worsening(earlier, metric)
        if change > metric.allowed:
            by = "" if math.isinf(change) else f", {100.0 * change:.0f} % worse"
            worse.append(
                f"{metric.name}: {earlier:.6g} before, {metric.value:.6g} {metric.unit} now"
                f"{by} ({100.0 * metric.allowed:g} % are allowed)"
            )
    if same_set:
        present = {metric.name for metric in now}
        worse += [f"{name}: not measured any more" for name in before if name not in present]
    return worse
