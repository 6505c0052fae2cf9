"""Comparison of metrics with those of an earlier run, within the tolerance of each metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from benchmarks.metric import MACHINE_UNITS, Metric


def worsening(before: float, now: Metric) -> float:
    """Compute the relative worsening of a metric: 0 if it is not worse, infinite if it is NaN now."""
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
    """Describe the metrics that got worse, one sentence each.

    Parameters
    ----------
    before
        Metrics of the earlier run by name.
    now
        Metrics of this run; their tolerances apply.
    same_machine
        Whether both runs used the same kind of processor; otherwise times are not compared.
    same_set
        Whether both runs measured the same set of metrics; then a missing metric is reported.
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
                f"{by} ({100.0 * metric.allowed:g} % allowed)"
            )
    if same_set:
        present = {metric.name for metric in now}
        worse += [f"{name}: not measured any more" for name in before if name not in present]
    return worse
