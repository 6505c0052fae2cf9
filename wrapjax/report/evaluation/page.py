"""The page of an evaluation."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrapjax.report import markup
from wrapjax.report.curve_sections import moments_section
from wrapjax.report.evaluation.content import PredictedCycles
from wrapjax.report.summary import USES
from wrapjax.report.wording import counted, decimals


def render_evaluation(content: dict[str, Any], cycles: PredictedCycles) -> str:
    """Write the page of an evaluation, with nothing outside it.

    Parameters
    ----------
    content
        From `describe_evaluation`.
    cycles
        Curves of the same cycles.
    """
    run = content["run"]
    title = f"{content['subject']}: predicted by the {run['method']} calibration of {run['subject']}"
    counts = [f"{counted(cycles.uses.count(use), f'{use} cycle')}" for use in USES if use in cycles.uses]
    under = f"{counted(len(cycles.coordinates), 'coordinate')}, {' and '.join(counts)}; nothing was fitted."
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(content),
            _errors(content, cycles),
            moments_section(cycles, content),
            _trials(content, cycles),
            markup.section("Notes", markup.bullets([*content["notes"], _FILES])),
        ],
    )


_FILES = (
    "Errors are in evaluation.json, curves of every cycle in moments/. 'Calibration' and 'validation' are "
    "what the settings of the evaluated subject call its cycles; the run may have seen neither."
)


def _verdict(content: dict[str, Any]) -> str:
    lines = []
    for use in USES:
        own, before = content["mae_Nm"][use], content["run"]["mae_Nm"][use]
        if own is not None:
            beside = "" if before is None else f" (the run's own: {decimals(before['mean'])} N m)"
            lines.append(
                f"On {use} cycles predicted and measured joint moments differ by {decimals(own['mean'])} N m "
                f"on average{beside}."
            )
    return markup.box("\n".join(map(markup.paragraph, lines)), "verdict")


def _errors(content: dict[str, Any], cycles: PredictedCycles) -> str:
    columns: dict[str, dict[str, float]] = {}
    for use in USES:
        if content["mae_Nm"][use] is not None:
            columns |= {f"{use}: MAE": content["mae_Nm"][use], f"{use}: RMSE": content["rmse_Nm"][use]}
        if content["run"]["mae_Nm"][use] is not None:
            columns[f"run's {use}: MAE"] = content["run"]["mae_Nm"][use]
    peak = np.abs(cycles.measured).max(axis=(0, 2))
    largest = dict(zip(cycles.coordinates, peak.tolist(), strict=True))
    rows = [
        (name, decimals(largest.get(name)), *(decimals(column.get(name)) for column in columns.values()))
        for name in (*cycles.coordinates, "mean")
    ]
    caption = (
        "Errors of joint moments in N m over all frames of the cycles: mean absolute (MAE) and root mean "
        "square (RMSE). 'Run's' are those that the calibration itself ended with, on its own cycles."
    )
    return markup.section(
        "Moment errors",
        markup.table(("coordinate", "largest measured", *columns), rows, caption=caption, total=True),
    )


def _trials(content: dict[str, Any], cycles: PredictedCycles) -> str:
    rows = [
        (name, own["use"], *(decimals(own["mae_Nm"][one]) for one in (*cycles.coordinates, "mean")))
        for name, own in content["trials"].items()
    ]
    header = ("cycle", "use", *cycles.coordinates, "mean")
    return markup.section(
        "Cycle by cycle", markup.table(header, rows, caption="Mean absolute errors in N m, cycle by cycle.")
    )
