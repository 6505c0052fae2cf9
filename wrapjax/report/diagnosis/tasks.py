"""Report section of a diagnosis on tasks other than gait: what they add to the evidence, and their errors."""

from __future__ import annotations

import numpy as np

from wrapjax.diagnosis.evidence.other_tasks import TaskEvidence
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.report import markup
from wrapjax.report.formatting import readable
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
)

# Number of effects that are drawn, and evidence (nats) from which an effect is.
_MOST_DRAWN, _LEAST_DRAWN = 12, 0.1


def other_tasks_section(result: DiagnosisResult) -> str:
    """Write the report section on tasks other than gait; empty if none was used."""
    found = result.task_evidence
    if found is None:
        return ""
    left_out = (
        [
            markup.paragraph(
                "Not used: "
                + "; ".join(f"{name}, as {reason}" for name, reason in found.not_used.items())
                + "."
            )
        ]
        if found.not_used
        else []
    )
    picture = (
        [
            markup.picture(
                added_figure(result, found),
                alternative="Evidence of effects by gait and by other tasks, in nats.",
                caption="Evidence of each effect in nats: grey by gait alone, blue what the other tasks add. "
                "To the right they speak for the effect, to the left against it.",
            )
        ]
        if drawn_effects(result, found)
        else []
    )
    return markup.section(
        "Other tasks",
        markup.paragraph(
            "The model is calibrated to gait. Usual errors of parameters, muscle paths and muscle force are "
            "allowed here, and errors that follow the joint angle, so that these trials speak for an effect "
            "only where the plain model cannot follow both. The gates concern gait."
        ),
        *picture,
        markup.table(
            (
                "recording",
                "task",
                "coordinate",
                "windows of 1 s",
                "error (N m)",
                "worst window (N m)",
                "there",
            ),
            [
                (
                    one.recording,
                    one.task,
                    one.coordinate,
                    str(one.windows),
                    f"{one.rms:.1f}",
                    f"{one.worst_rms:.1f}",
                    f"{one.angle[0]:.0f} to {one.angle[1]:.0f} degrees, "
                    f"{one.time[0]:.1f} to {one.time[1]:.1f} s",
                )
                for one in found.errors
            ],
            caption="Root mean square of measured less predicted moments by the model fitted to gait.",
        ),
        *left_out,
    )


def drawn_effects(result: DiagnosisResult, found: TaskEvidence) -> list[str]:
    """List the effects whose evidence is drawn: the strongest, and those of which the tasks say most."""
    evidence = {one.id: one.evidence for one in result.effects}
    size = {id: max(abs(found.added[id]), evidence[id], evidence[id] - found.added[id]) for id in evidence}
    chosen = sorted((id for id in size if size[id] >= _LEAST_DRAWN), key=lambda id: -size[id])[:_MOST_DRAWN]
    return sorted(chosen, key=lambda id: -evidence[id])


@in_style
def added_figure(result: DiagnosisResult, found: TaskEvidence) -> Figure:
    """Draw the evidence (nats) of effects by gait and what other tasks add, one row an effect."""
    names = drawn_effects(result, found)
    total = {one.id: one.evidence for one in result.effects}
    rows = np.arange(len(names))
    added = np.array([found.added[id] for id in names])
    gait = np.array([total[id] for id in names]) - added
    figure = new_figure(PAGE_WIDTH, 0.34 * len(names) + 0.9)
    panel = figure.subplots()
    panel.barh(rows - 0.17, gait, color=GRAY, height=0.32, label="gait")
    panel.barh(rows + 0.17, added, color=BLUE, height=0.32, label="added by other tasks")
    panel.axvline(0.0, color=BLACK, linewidth=0.6)
    label_rows([panel], [readable(id) for id in names])
    panel.set_xlabel("evidence (nats)")
    legend_above(figure, panel)
    return figure
