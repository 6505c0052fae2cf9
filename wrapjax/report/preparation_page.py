"""Figures of a recording: forces over time, and every gait cycle for itself, so that one amiss is seen.

The page of a prepared subject, as one HTML file that opens anywhere, offline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.report import markup
from wrapjax.report.moment_curves import groups_by_speed, mark_gait_cycle
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GROUP_COLORS,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    in_style,
    panel_grid,
)
from wrapjax.subject.description import Table
from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import Trials

#: Gait cycles of a recording that fit into one panel and can still be looked at.
_MOST_CYCLES = 6
#: Shown before the first cycle, s.
_BEFORE = 0.3
_FOOT_COLORS = {"left": BLUE, "right": VERMILION}


@dataclass(frozen=True)
class ForceTrace:
    """Vertical ground forces of a recording, and what motion asks of them.

    Parameters
    ----------
    trial
        Its name.
    cycles
        Start and end of each gait cycle in s.
    time, vertical
        s; upward force on each foot by its name (``left``, ``right``), N, filtered as motion was.
    needed_time, needed
        s; upward force that bears and accelerates all bodies of the model, N.
    """

    trial: str
    cycles: tuple[tuple[float, float], ...]
    time: Float[np.ndarray, " sample"]
    vertical: dict[str, Float[np.ndarray, " sample"]]
    needed_time: Float[np.ndarray, " frame"]
    needed: Float[np.ndarray, " frame"]


@in_style
def force_figure(traces: Sequence[ForceTrace]) -> Figure:
    """Draw the forces on both feet, their sum, and what motion needs, one panel a recording."""
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
            label="needed by the motion",
        )
        left = len(trace.cycles) - len(shown)
        rest = f" (the first {len(shown)} of {len(trace.cycles)} cycles)" if left else ""
        panel.set_title(f"{trace.trial}{rest}", loc="left", parse_math=False)
        panel.set_xlim(first, last)
        panel.set_ylim(bottom=min(0.0, panel.get_ylim()[0]))
        panel.set_ylabel("vertical force (N)")
    panels[-1].set_xlabel("time (s)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


@in_style
def cycles_figure(
    values: Float[np.ndarray, "cycle signal frame"],
    names: Sequence[str],
    speeds: Float[np.ndarray, " cycle"],
    quantity: str,
) -> Figure:
    """Draw every gait cycle of every signal as a line of its own, one panel a signal.

    Parameters
    ----------
    values
        In the unit that ``quantity`` names.
    names
        Of the signals.
    speeds
        Of walking, m/s, NaN where unknown: each has a color.
    quantity
        What is drawn, with its unit.
    """
    groups = groups_by_speed(speeds, most=len(GROUP_COLORS))
    columns = 3 if len(names) <= 6 else 4
    figure, panels = panel_grid(
        len(names), min(columns, len(names)), width=PAGE_WIDTH, panel_height=1.6, sharex=True
    )
    percent = np.linspace(0.0, 100.0, values.shape[-1])
    for row, (panel, name) in enumerate(zip(panels, names, strict=True)):
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        for group, color in zip(groups, GROUP_COLORS, strict=False):
            lines = panel.plot(percent, values[group.keep, row].T, color=color, linewidth=0.8, alpha=0.75)
            lines[0].set_label(group.label)
        panel.set_title(name, loc="left", parse_math=False)
        if row % columns == 0:
            panel.set_ylabel(quantity)
        if row >= len(names) - columns:
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    if len(groups) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=len(groups))
    return figure


_DASH = "\N{EN DASH}"


def render_preparation(
    subject: Subject, tables: Sequence[Table], forces: Sequence[ForceTrace], came_from: str
) -> str:
    """Write what was made of a laboratory's files as a page with nothing outside it.

    Parameters
    ----------
    subject
        As it is read back from what was written.
    tables
        What is said of the files: recordings, checks, notes.
    forces
        Of each recording; empty where they were not looked at.
    came_from
        What files these are, to go on "from ...".
    """
    trials = subject.trials
    title = f"{subject.name}: what was recorded"
    side = {"l": "left", "r": "right"}[subject.side]
    cycles = counted(len(trials), "gait cycle")
    under = f"{side.capitalize()} leg, {subject.mass_kg:g} kg, {cycles}, from {came_from}."
    parts = [
        markup.header(title, under),
        _verdict(subject, tables),
        _tables_section(tables),
    ]
    if forces:
        parts.append(_forces_section(forces))
    parts += [_cycles_section(trials), _notes(subject)]
    return markup.page(title, parts)


def _verdict(subject: Subject, tables: Sequence[Table]) -> str:
    checks = sum(len(table.rows) for table in tables if table.title == "Checks")
    notes = sum(len(table.rows) for table in tables if table.title == "Notes")
    first = f"{counted(len(subject.trials), 'gait cycle')} can be calibrated with."
    said = []
    if checks:
        said.append(f"{counted(checks, 'check')} of whether motion, forces and EMG belong together passed.")
    if notes:
        said.append(f"{counted(notes, 'note')} on what was repaired, or not looked at, below.")
    said.append("Numbers do not see everything: look at each cycle for one that goes its own way.")
    return markup.verdict([first, *said], fine=True)


def _tables_section(tables: Sequence[Table]) -> str:
    shown = [
        markup.table(
            table.header,
            [tuple(_cell(cell) for cell in row) for row in table.rows],
            caption=table.title,
        )
        for table in tables
        if table.rows
    ]
    return markup.section("What was found", *shown)


def _cell(cell: str | float | int | None) -> str:
    if cell is None:
        return _DASH
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _forces_section(forces: Sequence[ForceTrace]) -> str:
    return markup.section(
        "Forces and motion",
        markup.picture(
            force_figure(forces),
            alternative="Vertical ground force under each foot over time, beside what the motion needs.",
            caption=f"Vertical ground force in N; gait cycles in gray, numbered. {_newton(forces)}",
        ),
    )


def _newton(forces: Sequence[ForceTrace]) -> str:
    """Say what the dotted line is for."""
    said = "By Newton's law both feet together bear and accelerate all bodies (dotted line, by motion and "
    if all(len(trace.vertical) > 1 for trace in forces):
        return (
            f"{said}masses alone): where the black line runs ahead of the dotted one, or behind it, forces "
            "and motion are not in time."
        )
    return f"{said}masses alone); where one foot's force was recorded alone, the two cannot be compared."


def _cycles_section(trials: Trials) -> str:
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    inside = slice(trials.padding, trials.emg.shape[-1] - trials.padding)
    pictures = (
        (np.rad2deg(trials.angles[:, columns]), trials.moment_coordinates, "angle (deg)", "Joint angles"),
        (trials.moments, trials.moment_coordinates, "moment (N m)", "Joint moments by inverse dynamics"),
        (
            trials.emg[..., inside],
            trials.channels,
            "EMG",
            "EMG over its largest value",
        ),
    )
    return markup.section(
        "Every gait cycle",
        *(
            markup.picture(
                cycles_figure(values, names, trials.speeds, quantity),
                alternative=f"{what}, every gait cycle a line.",
                caption=f"{what}: every gait cycle a line of its own, one color a walking speed.",
            )
            for values, names, quantity, what in pictures
        ),
    )


def _notes(subject: Subject) -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                *subject.notes,
                "preparation.json beside this page holds every figure; subject.toml is what commands read.",
                f"{versions_in_words()}.",
            ]
        ),
    )
