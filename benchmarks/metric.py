"""Metrics measured by benchmarks, with units and tolerances, and their text table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

#: Relative worsening that is tolerated, by unit. The machine is shared, so only a factor of two in times and
#: rates is significant; computed numbers change by rounding only.
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

#: Tolerance of metrics that are informative only, such as those of other tools.
INFORMATION = math.inf

#: Units whose metrics depend on the machine.
MACHINE_UNITS = ("s", "ms", "us", "core s", "GFLOP/s", "GB/s")


@dataclass(frozen=True)
class Metric:
    """Measured number.

    Parameters
    ----------
    name
        Group and quantity, such as ``kernels/linearization``.
    value
        Value in ``unit``; NaN if it could not be measured, with the reason in ``note``.
    unit
        Unit as printed; ``x`` for ratios.
    better
        Whether ``lower`` or ``higher`` is better.
    note
        What the value is compared with, or the conditions of the measurement.
    tolerance
        Relative worsening beyond which a later run is a regression; by default that of the unit
        (`TOLERANCES`).
    negligible
        Change in ``unit`` that is ignored: rounding, or times too short to be measured.
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
        """Tolerance that applies: its own, or that of the unit."""
        return TOLERANCES[self.unit] if self.tolerance is None else self.tolerance

    def as_json(self) -> dict[str, Any]:
        """Return all fields for JSON, with the tolerance that applies."""
        return vars(self) | {"tolerance": self.allowed}


def text_table(metrics: Sequence[Metric]) -> str:
    """Format metrics as a table, one per line."""
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
    """Format with four digits, without an exponent where a plain number is as short."""
    if value != value:
        return "-"
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    return f"{value:.1e}"
