"""Absolute limits and recorded values of metrics, read from ``gate_limits.toml``."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.metric import Metric

#: Limits that the gate checks.
LIMITS_FILE = Path(__file__).with_name("gate_limits.toml")
#: Table of the limits of all subjects; the other tables have the names of subjects' folders.
ANY = "any"


@dataclass(frozen=True)
class Limit:
    """Limits of one metric.

    Parameters
    ----------
    at_least, at_most
        Bounds, in the metric's unit.
    recorded, within
        Recorded value, and the largest relative difference from it. Improvements are differences, too: a
        lower cost is the cost of another problem or of another minimum, and has to be recorded if it is
        intended.
    """

    at_least: float = -math.inf
    at_most: float = math.inf
    recorded: float | None = None
    within: float = 0.0

    def violation(self, metric: Metric) -> str | None:
        """Describe how a metric violates the limits; None if it does not."""
        value = f"{metric.name}: {metric.value:.6g} {metric.unit}"
        # Written so that NaN, a metric that could not be measured, fails.
        if not metric.value >= self.at_least:
            return f"{value}, must be at least {self.at_least:g}"
        if not metric.value <= self.at_most:
            return f"{value}, must be at most {self.at_most:g}"
        if self.recorded is not None:
            change = abs(metric.value - self.recorded) / abs(self.recorded)
            if not change <= self.within:
                return (
                    f"{value}, recorded value {self.recorded:g}: {100.0 * change:.2g} % off, "
                    f"{100.0 * self.within:g} % allowed"
                )
        return None


def read_limits(subject: str, file: Path = LIMITS_FILE) -> dict[str, Limit]:
    """Read the limits of a subject: those of all subjects and its own.

    Parameters
    ----------
    subject
        Name of the subject's folder.
    file
        TOML file with a table ``[any]`` and one for each subject, of entries such as
        ``"kernels/jacobian_speedup" = { at_least = 20.0 }``.
    """
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    return {name: Limit(**entry) for table in (ANY, subject) for name, entry in tables.get(table, {}).items()}


def violations_of(metrics: Sequence[Metric], limits: Mapping[str, Limit]) -> list[str]:
    """Describe the metrics that violate their limits or are missing, one sentence each."""
    by_name = {metric.name: metric for metric in metrics}
    violations = []
    for name, limit in limits.items():
        if name not in by_name:
            violations.append(f"{name}: not measured")
        elif violation := limit.violation(by_name[name]):
            violations.append(violation)
    return violations
