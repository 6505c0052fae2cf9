"""One number that a benchmark measured, and a table of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal


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
    """

    name: str
    value: float
    unit: str
    better: Literal["lower", "higher"]
    note: str = ""


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
