"""What a number must reach whatever earlier runs were like: floors, ceilings and recorded values."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.metric import Metric

#: What the gate holds.
FLOORS_FILE = Path(__file__).with_name("floors.toml")
#: Table of what holds for every subject; the others have the names of subjects' folders.
ANY = "any"


@dataclass(frozen=True)
class Floor:
    """What a number must be.

    Parameters
    ----------
    at_least, at_most
        Bounds, in the number's unit.
    recorded, within
        A value that was recorded, and how far from it the number may be in parts of it. Better ones count,
        too: a cost that falls is another problem or another minimum, and is recorded anew when it is meant.
    """

    at_least: float = -math.inf
    at_most: float = math.inf
    recorded: float | None = None
    within: float = 0.0

    def objection(self, metric: Metric) -> str | None:
        """Say what is wrong with a number; None where nothing is."""
        value = f"{metric.name}: {metric.value:.6g} {metric.unit}"
        # Written so that a number that could not be measured fails.
        if not metric.value >= self.at_least:
            return f"{value}, at least {self.at_least:g} is asked for"
        if not metric.value <= self.at_most:
            return f"{value}, at most {self.at_most:g} is asked for"
        if self.recorded is not None:
            change = abs(metric.value - self.recorded) / abs(self.recorded)
            if not change <= self.within:
                return (
                    f"{value}, {self.recorded:g} was recorded: {100.0 * change:.2g} % off, "
                    f"{100.0 * self.within:g} % are allowed"
                )
        return None


def read_floors(subject: str, file: Path = FLOORS_FILE) -> dict[str, Floor]:
    """Read what holds for a subject: what holds for any, and what is its own.

    Parameters
    ----------
    subject
        Name of its folder.
    file
        TOML: a table ``[any]`` and one a subject, of entries such as
        ``"kernels/jacobian_speedup" = { at_least = 20.0 }``.
    """
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    return {name: Floor(**entry) for table in (ANY, subject) for name, entry in tables.get(table, {}).items()}


def shortfalls(metrics: Sequence[Metric], floors: Mapping[str, Floor]) -> list[str]:
    """Say which numbers are not what they must be, a sentence each."""
    by_name = {metric.name: metric for metric in metrics}
    found = []
    for name, floor in floors.items():
        if name not in by_name:
            found.append(f"{name}: not measured")
        elif objection := floor.objection(by_name[name]):
            found.append(objection)
    return found
