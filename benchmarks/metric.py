"""One number that a benchmark measured, and a table of many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

#: By how much of itself a number may get worse before that counts, by its unit. Others use the machine, too:
#: times and rates say something from twice on. What is calculated is the same but for its last digits.
TOLERANCES = {
    **dict.fromkeys(("s", "ms", "us", "core s", "GFLOP/s", "GB/s"), 1.0),
    "x": 0.3,
    "%": 0.3,
    "GB": 0.2,
    "slope": 0.25,
    "flop/byte": 0.1,
    **dict.fromkeys(("N m", "mm"), 0.01),
    **dict.fromkeys(("evaluations", "iterations"), 0.1),
    "programs": 0.0,
    "1": 0.001,
}

#: Tolerance of what is measured for information: a peer that gets worse is no regression of ours.
INFORMATION = math.inf

#: What only says how fast this machine was, and nothing on another.
MACHINE_UNITS = ("s", "ms", "us", "core s", "GFLOP/s", "GB/s")


@dataclass(frozen=True)
class Metric:
    """A measured number.

    Parameters
    ----------
    name
        Group and quantity, as ``kernels/linearization``.
    value
        NaN where nothing could be measured; ``note`` then says why.
    unit
        As printed; ``x`` for ratios.
    better
        Whether ``lower`` or ``higher`` is better.
    note
        What it is compared with, or under which conditions it holds.
    tolerance
        Relative change for the worse beyond which a later run is a regression; by its unit
        (`TOLERANCES`) where it is not given.
    negligible
        Change, in its unit, that never counts: rounding, or what is too short to be timed.
    """

    name: str
    value: float
    unit: str
    better: Literal["lower", "higher"]
    note: str = ""
    tolerance: float | None = None
    negligible: float = 0.0

    @property
    def allowed(self) -> float:
        """The tolerance that holds."""
        return TOLERANCES[self.unit] if self.tolerance is None else self.tolerance

    def as_json(self) -> dict[str, Any]:
        """Give all of it, with the tolerance that holds."""
        return vars(self) | {"tolerance": self.allowed}


def text_table(metrics: Sequence[Metric]) -> str:
    """Lay metrics out, one a line."""
    header = ("name", "value", "unit", "better", "compared with")
    rows = [(one.name, _number(one.value), one.unit, one.better, one.note) for one in metrics]
    widths = [max(len(row[column]) for row in [header, *rows]) for column in range(4)]

    def line(row: tuple[str, ...]) -> str:
        name, value, unit, better, note = row
        cells = (
            name.ljust(widths[0]),
            value.rjust(widths[1]),
            unit.ljust(widths[2]),
            better.ljust(widths[3]),
        )
        return "  ".join((*cells, note)).rstrip()

    return "\n".join([line(header), *map(line, rows)])


def _number(value: float) -> str:
    """Four digits, and no exponent where a plain number is as short."""
    if value != value:
        return "-"
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    return f"{value:.1e}"
