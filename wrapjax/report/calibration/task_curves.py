"""Report sections on joint moments: over the gait cycle, and of other tasks over time, with their errors."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from wrapjax.evaluation.metrics import LeftOutTask
from wrapjax.report import markup
from wrapjax.report.calibration.calibration_curves import moments_section
from wrapjax.report.cycle_panels import MomentCurves, TrialCurves
from wrapjax.report.formatting import decimals
from wrapjax.report.style import (
    BLACK,
    BLUE,
    PAGE_WIDTH,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    panel_grid,
)
from wrapjax.subject.trials import GAIT

#: Most panels of one figure.
_MOST_PANELS = 24


def moment_sections(curves: MomentCurves, summary: dict[str, Any]) -> list[str]:
    """Write the report sections on joint moments: gait cycles, and other tasks, as far as there are any."""
    gait = np.array([task == GAIT for task in curves.tasks])
    sections = []
    if gait.any():
        walking = curves if gait.all() else TrialCurves.of(curves, gait)
        sections.append(moments_section(walking, summary))
    if not gait.all():
        sections.append(tasks_section(curves, summary))
    return sections


def tasks_section(curves: MomentCurves, summary: dict[str, Any]) -> str:
    """Write the report section on tasks: errors by task and coordinate, and moments over time."""
    rows = [
        (
            task,
            name,
            use,
            decimals(entry["mae_Nm"]),
            decimals(entry["rmse_Nm"]),
            decimals(entry["r2"]),
            decimals(entry["seconds"], 1),
        )
        for task, by_coordinate in summary["tasks"].items()
        for name, by_use in by_coordinate.items()
        for use, entry in by_use.items()
    ]
    table = markup.table(
        ("task", "coordinate", "use", "MAE", "RMSE", "R\N{SUPERSCRIPT TWO}", "measured (s)"),
        rows,
        caption="Errors of joint moments in N m by task. R\N{SUPERSCRIPT TWO} is the share of the measured "
        "moment's variance about its mean that the model explains, negative where the mean explains more.",
    )
    panels = _panels(curves)
    omitted = max(len(panels) - _MOST_PANELS, 0)
    note = f" {omitted} further panels are omitted; all curves are in moments/." if omitted else ""
    picture = markup.picture(
        task_figure(curves, panels[:_MOST_PANELS]),
        alternative=f"Measured and modelled joint moments over time in {len(panels)} panels.",
        caption="Net joint moments in N m of tasks other than gait, over time in the recording: measured "
        f"(black) and modelled from EMG (blue).{note}",
    )
    return markup.section("Tasks", table, picture)


def _panels(curves: MomentCurves) -> list[tuple[str, int]]:
    """List recordings of other tasks with the coordinates that were measured in each."""
    names = np.array(curves.recordings)
    others = np.array([task != GAIT for task in curves.tasks])
    return [
        (name, row)
        for name in dict.fromkeys(names[others].tolist())
        for row in range(len(curves.coordinates))
        if np.isfinite(curves.measured[names == name, row]).any()
    ]


@in_style
def task_figure(curves: MomentCurves, shown: list[tuple[str, int]]) -> Figure:
    """Draw the moments of other tasks over time, one panel a recording and coordinate."""
    columns = min(3, len(shown))
    width = PAGE_WIDTH if columns > 1 else PAGE_WIDTH / 2
    figure, panels = panel_grid(len(shown), columns, width=width, panel_height=1.6)
    names = np.array(curves.recordings)
    for panel, (name, row) in zip(panels, shown, strict=True):
        own = names == name
        known = np.isfinite(curves.measured[own, row])
        order = np.argsort(curves.time[own][known])
        time, measured, modelled = (
            values[known][order]
            for values in (curves.time[own], curves.measured[own, row], curves.modelled[own, row])
        )
        # A gap between intervals is a gap in the line.
        gaps = np.flatnonzero(np.diff(time) > 0.05) + 1
        time, measured, modelled = (np.insert(part, gaps, np.nan) for part in (time, measured, modelled))
        draw_zero_line(panel)
        panel.plot(time, measured, color=BLACK, label="measured")
        panel.plot(time, modelled, color=BLUE, label="modelled")
        panel.set_title(f"{name}: {curves.coordinates[row]}", loc="left", parse_math=False)
        panel.set_xlabel("time (s)")
    for panel in panels[::columns]:
        panel.set_ylabel("moment (N m)")
    legend_above(figure, panels[0])
    return figure


_COLUMNS = ("task", "coordinate", "seconds", "model", "mae_Nm", "rmse_Nm", "r2", "converged")


def left_out_csv(rows: Sequence[LeftOutTask]) -> str:
    """Tabulate errors by task and coordinate, N m, of models calibrated without the task and on all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        for model, errors in (("without the task", row.without), ("all tasks", row.with_all)):
            numbers = (errors.mae, errors.rmse, errors.r2)
            converged = row.converged if model != "all tasks" else ""
            writer.writerow((errors.task, errors.coordinate, errors.seconds, model, *numbers, converged))
    return text.getvalue()


def left_out_section(rows: Sequence[LeftOutTask]) -> str:
    """Write the report section on tasks that were left out in turn."""
    cells = [
        (
            row.without.task + ("" if row.converged else " (not converged)"),
            row.without.coordinate,
            *(
                decimals(value)
                for own in (row.without, row.with_all)
                for value in (own.mae, own.rmse, own.r2)
            ),
        )
        for row in rows
    ]
    return markup.section(
        "Tasks left out in turn",
        markup.table(
            (
                "task",
                "coordinate",
                "without: MAE",
                "RMSE",
                "R\N{SUPERSCRIPT TWO}",
                "all: MAE",
                "RMSE",
                "R\N{SUPERSCRIPT TWO}",
            ),
            cells,
            caption="Errors in N m in the trials of each task. 'Without': of the model calibrated on the "
            "other tasks, which has not seen this one; 'all': of the model calibrated on all tasks.",
        ),
    )
