"""Report of a prepared subject as a self-contained HTML page: ground forces and every gait cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.report import markup
from wrapjax.report.cycle_panels import groups_by_speed, label_gait_cycles
from wrapjax.report.formatting import DASH, counted, leg_name
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GROUP_COLORS,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    draw_zero_line,
    in_style,
    legend_above,
    panel_grid,
)
from wrapjax.subject.description import Table
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: Largest number of gait cycles of a recording that one panel shows.
_MOST_CYCLES = 6
#: Time shown before the first cycle, s.
_BEFORE = 0.3
_FOOT_COLORS = {"left": BLUE, "right": VERMILION}


@dataclass(frozen=True)
class ForceTrace:
    """Vertical ground forces of a recording, and the force that the motion requires.

    Parameters
    ----------
    trial
        Name of the recording.
    cycles
        Start and end of each gait cycle, s.
    time, vertical
        Time, s; upward force on each foot (``left``, ``right``), N, filtered like the motion.
    needed_time, needed
        Time, s; upward force that supports and accelerates all bodies of the model, N.
    """

    trial: str
    cycles: tuple[tuple[float, float], ...]
    time: Float[np.ndarray, " sample"]
    vertical: dict[str, Float[np.ndarray, " sample"]]
    needed_time: Float[np.ndarray, " frame"]
    needed: Float[np.ndarray, " frame"]


@in_style
def force_figure(traces: Sequence[ForceTrace]) -> Figure:
    """Draw the forces on both feet, their sum and the force required by the motion, one panel a recording."""
    figure, panels = panel_grid(len(traces), 1, width=PAGE_WIDTH, panel_height=1.7)
    for panel, trace in zip(panels, traces, strict=True):
        shown = trace.cycles[:_MOST_CYCLES]
        first, last = shown[0][0] - _BEFORE, shown[-1][1]
        for number, (start, end) in enumerate(shown):
            panel.axvspan(start, end, color=LIGHT_GRAY if number % 2 else "#F4F4F4", zorder=0, linewidth=0)
            panel.annotate(
                f"{number + 1}",
                (start, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(3, -9),
                textcoords="offset points",
                fontsize=7,
                color="#555555",
            )
        inside = (trace.time >= first) & (trace.time <= last)
        for side, force in trace.vertical.items():
            panel.plot(trace.time[inside], force[inside], color=_FOOT_COLORS[side], label=f"{side} foot")
        if len(trace.vertical) > 1:
            total = np.sum(list(trace.vertical.values()), axis=0)
            panel.plot(trace.time[inside], total[inside], color=BLACK, linewidth=0.9, label="both feet")
        inside = (trace.needed_time >= first) & (trace.needed_time <= last)
        panel.plot(
            trace.needed_time[inside],
            trace.needed[inside],
            color=BLACK,
            linestyle=":",
            linewidth=1.4,
            label="required by the motion",
        )
        omitted = len(trace.cycles) - len(shown)
        note = f" (the first {len(shown)} of {len(trace.cycles)} cycles)" if omitted else ""
        panel.set_title(f"{trace.trial}{note}", loc="left", parse_math=False)
        panel.set_xlim(first, last)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
        panel.set_ylabel("vertical force (N)")
    panels[-1].set_xlabel("time (s)")
    legend_above(figure, panels[0])
    return figure


@in_style
def cycles_figure(
    values: Float[np.ndarray, "cycle signal frame"],
    names: Sequence[str],
    speeds: Float[np.ndarray, " cycle"],
    quantity: str,
) -> Figure:
    """Draw every gait cycle of every signal as a separate line, one panel a signal, one color a speed.

    Parameters
    ----------
    values
        Signals, in the unit that ``quantity`` states.
    names
        Names of the signals.
    speeds
        Walking speeds, m/s, NaN where unknown.
    quantity
        Axis label with the unit.
    """
    groups = groups_by_speed(speeds, most=len(GROUP_COLORS))
    columns = 3 if len(names) <= 6 else 4
    figure, panels = panel_grid(
        len(names), min(columns, len(names)), width=PAGE_WIDTH, panel_height=1.6, sharex=True
    )
    percent = np.linspace(0.0, 100.0, values.shape[-1])
    for row, (panel, name) in enumerate(zip(panels, names, strict=True)):
        draw_zero_line(panel)
        for group, color in zip(groups, GROUP_COLORS, strict=False):
            lines = panel.plot(percent, values[group.keep, row].T, color=color, linewidth=0.8, alpha=0.75)
            lines[0].set_label(group.label)
        panel.set_title(name, loc="left", parse_math=False)
    label_gait_cycles(panels, columns, y=quantity)
    if len(groups) > 1:
        legend_above(figure, panels[0])
    return figure


def render_preparation(
    subject: Subject, tables: Sequence[Table], forces: Sequence[ForceTrace], came_from: str
) -> str:
    """Write the report of a prepared subject as a self-contained HTML page.

    Parameters
    ----------
    subject
        Subject, as read from the written folder.
    tables
        Tables of recordings, checks and notes.
    forces
        Ground forces of each recording; empty if they were not checked.
    came_from
        Description of the source files, to follow "from".
    """
    trials = subject.trials
    title = f"{subject.name}: prepared recordings"
    cycles = counted(len(trials), "gait cycle")
    under = f"{leg_name(subject.side)}, {subject.mass_kg:g} kg, {cycles}, from {came_from}."
    parts = [
        markup.header(title, under),
        _verdict_section(subject, tables),
        tables_section(tables),
    ]
    if forces:
        parts.append(_forces_section(forces))
    gait = trials.only_gait()
    parts += [*([cycles_section(gait)] if len(gait) else []), _notes_section(subject)]
    return markup.page(title, parts)


def _verdict_section(subject: Subject, tables: Sequence[Table]) -> str:
    checks = sum(len(table.rows) for table in tables if table.title == "Checks")
    notes = sum(len(table.rows) for table in tables if table.title == "Notes")
    first = f"{counted(len(subject.trials), 'gait cycle')} can be used for calibration."
    findings = []
    if checks:
        findings.append(f"{counted(checks, 'check')} of the consistency of motion, forces and EMG passed.")
    if notes:
        findings.append(f"See below for {counted(notes, 'note')} on repaired data and omitted checks.")
    findings.append("These checks cannot detect every error: inspect the cycles below for outliers.")
    return markup.verdict([first, *findings], fine=True)


def tables_section(tables: Sequence[Table], title: str = "Recordings and checks") -> str:
    """Write tables, but empty ones, under a heading."""
    shown = [
        markup.table(
            table.header,
            [tuple(_cell(cell) for cell in row) for row in table.rows],
            caption=table.title,
        )
        for table in tables
        if table.rows
    ]
    return markup.section(title, *shown)


def _cell(cell: str | float | int | None) -> str:
    if cell is None:
        return DASH
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _forces_section(forces: Sequence[ForceTrace]) -> str:
    return markup.section(
        "Forces and motion",
        markup.picture(
            force_figure(forces),
            alternative="Vertical ground force under each foot over time, and the force required by the "
            "motion.",
            caption=f"Vertical ground force in N; gait cycles in gray, numbered. {_required_force(forces)}",
        ),
    )


def _required_force(forces: Sequence[ForceTrace]) -> str:
    """Write how to interpret the line of the force that the motion requires."""
    law = (
        "By Newton's second law, the total force on both feet supports and accelerates all bodies (dotted "
        "line, computed from motion and masses alone)"
    )
    if all(len(trace.vertical) > 1 for trace in forces):
        return (
            f"{law}. If the black line leads or lags the dotted line, forces and motion are not synchronized."
        )
    return f"{law}. Where the force under only one foot was recorded, the two cannot be compared."


def cycles_section(trials: Trials) -> str:
    """Write the section that shows angles, moments and EMG of all gait cycles."""
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    inside = trials.inside
    pictures = (
        (np.rad2deg(trials.angles[:, columns]), trials.moment_coordinates, "angle (deg)", "Joint angles"),
        (trials.moments, trials.moment_coordinates, "moment (N m)", "Joint moments by inverse dynamics"),
        (
            trials.emg[..., inside],
            trials.channels,
            "EMG",
            "EMG (raw EMG normalized to its largest value; envelopes as they were given)",
        ),
    )
    return markup.section(
        "All gait cycles",
        *(
            markup.picture(
                cycles_figure(values, names, trials.speeds, quantity),
                alternative=f"{subject_matter}, one line per gait cycle.",
                caption=f"{subject_matter}: one line per gait cycle, one color per walking speed.",
            )
            for values, names, quantity, subject_matter in pictures
        ),
    )


def _notes_section(subject: Subject) -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                *subject.notes,
                "preparation.json in the same folder contains all numbers; commands read subject.toml.",
                f"{versions_in_words()}.",
            ]
        ),
    )
