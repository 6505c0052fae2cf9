"""The page of a prepared subject, as one HTML file that opens anywhere, offline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrapjax.report import markup
from wrapjax.report.preparation.figures import ForceTrace, cycles_figure, force_figure
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.wording import counted
from wrapjax.subject import Subject, Table, Trials

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
