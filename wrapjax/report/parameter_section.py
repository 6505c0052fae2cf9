"""Muscle parameters in the report: where they lie between their bounds, and which ended there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wrapjax.calibrate import CalibrationResult
from wrapjax.model import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.parameter_figures import bounds_figure


def parameters_section(result: CalibrationResult) -> str:
    """Write the part of the report on muscle parameters."""
    if not result.freedom.parameters:
        return markup.section("Muscle parameters", markup.paragraph("No parameter was free."))
    meanings = [
        f"{parameter.name}: {QUANTITIES[parameter.name].meaning}" for parameter in result.freedom.parameters
    ]
    rows = list(_stuck_rows(result))
    stuck = (
        markup.table(
            ("parameter", "bound", "number", "muscles"),
            rows,
            caption="Parameters that ended on a bound. Where many do, look at the data (EMG scale, "
            "electrode, model) before trusting the values.",
        )
        if rows
        else markup.paragraph("No parameter ended on a bound.")
    )
    return markup.section(
        "Muscle parameters",
        markup.picture(
            bounds_figure(result),
            alternative=f"Position of {len(result.freedom.parameters)} parameters of {len(result.muscles)} "
            f"muscles between their bounds; {len(result.at_bounds)} lie at a bound (see the table).",
            caption="Each free parameter between its lower bound (left) and upper bound (right): calibrated "
            "(dot), before calibration (gray stroke), at a bound (diamond). Bounds in % are shares of the "
            "model's own value.",
        ),
        markup.bullets(meanings),
        stuck,
    )


def _stuck_rows(result: CalibrationResult) -> Iterable[tuple[str, str, str, str]]:
    """One row a parameter and bound, with the muscles that ended there."""
    for parameter in result.freedom.parameters:
        values = np.asarray(getattr(result.parameters, parameter.name))
        nearer_lower = values - parameter.lower <= parameter.upper - values
        for bound, side in (("lower", nearer_lower), ("upper", ~nearer_lower)):
            names = [
                muscle
                for muscle, here in zip(result.muscles, side, strict=True)
                if here and f"{muscle}.{parameter.name}" in result.at_bounds
            ]
            if names:
                yield parameter.name, bound, str(len(names)), ", ".join(names)
