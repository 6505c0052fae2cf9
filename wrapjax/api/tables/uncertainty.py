"""Uncertainty as plain text for a terminal."""

from __future__ import annotations

import numpy as np

from wrapjax.api.calibrating.uncertainty import Uncertainty
from wrapjax.api.tables.calibration import calibration_table
from wrapjax.calibrate import LegSpread


def uncertainty_table(judged: Uncertainty) -> str:
    """Show each leg's calibration, and how well its recordings determine what was found."""
    legs = zip(judged.calibration.legs, judged.spreads, strict=True)
    return "\n\n".join(f"{calibration_table(leg)}\n\n{spread_table(spread)}" for leg, spread in legs)


def spread_table(spread: LegSpread) -> str:
    """Show medians by kind of parameter, and how many of each the moments determine."""
    own = spread.parameters
    kinds: dict[str, list[int]] = {}
    for row, label in enumerate(own.labels):
        name = label.rsplit(".", 1)[1]
        kinds.setdefault("path modes" if name.startswith("path_changes_") else name, []).append(row)
    failed = len(spread.draws) - spread.converged
    lines = [
        f"Uncertainty by {len(spread.draws)} draws ({spread.way}"
        + (f"; {failed} did not converge" if failed else "")
        + f"); residuals tell as much as {spread.independent_samples:.0f} independent samples",
        "Determined: moments narrow it by more than a fifth. Medians of standard deviations with the",
        "moments, and without them (priors, penalties and bounds alone)",
        f"{'parameter':26s}{'determined':>14s}{'with':>10s}{'without':>10s}  unit",
    ]
    for name, rows in kinds.items():
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(own.units[rows[0]], (1.0, own.units[rows[0]]))
        told = f"{int(own.identified[rows].sum())} of {len(rows)}"
        medians = (np.median(part[rows]) for part in (own.deviation, own.prior_deviation))
        lines.append(
            f"{name:26s}{told:>14s}" + "".join(f"{factor * one:10.3g}" for one in medians) + f"  {unit}"
        )
    return "\n".join(lines)
