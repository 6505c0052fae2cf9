"""A comparison of methods for a terminal."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from wrapjax.api.comparing.comparison import Comparison

if TYPE_CHECKING:
    from wrapjax.evaluate.statistics import Spread


def comparison_table(comparison: Comparison) -> str:
    """Show mean and standard deviation of moment errors by speed, method and coordinate, and the unit."""
    from wrapjax.report.comparison.numbers import note

    errors = [row for row in comparison.rows if row.quantity == "moment_error"]
    items = list(dict.fromkeys(row.item for row in errors))
    groups = list(dict.fromkeys((row.use, row.speed) for row in errors))
    cells = {(row.use, row.speed, row.item): row for row in errors}
    width = max(len(f"{use}, {speed}") for use, speed in groups) + 2
    reach = max(len(method) for method in comparison.methods) + 2
    lines = [
        "Mean absolute error of the joint moments, N m: mean ± standard deviation",
        " " * (width + reach) + "".join(f"{item:>16s}" for item in items),
    ]
    for use, speed in groups:
        for number, method in enumerate(comparison.methods):
            own = [cells.get((use, speed, item)) for item in items]
            name = "" if number else f"{use}, {speed}"
            texts = ["" if row is None else mean_and_deviation(row.spreads[method]) for row in own]
            lines.append(f"{name:{width}s}{method:{reach}s}" + "".join(f"{text:>16s}" for text in texts))
    failed = [
        f"{leg.label} by {method}: {result.solution.status.value}"
        for leg in comparison.legs
        for method, result in leg.results.items()
        if not result.solution.status.converged
    ]
    return "\n".join([*lines, "", textwrap.fill(note(comparison.legs), 100), *failed])


def mean_and_deviation(spread: Spread, digits: int = 2) -> str:
    """Write ``mean ± standard deviation``, or the mean alone where there is no deviation."""
    return f"{spread.mean:.{digits}f}" + ("" if math.isnan(spread.sd) else f" ± {spread.sd:.{digits}f}")
