"""Summary of a subject folder as tables, which `wrapjax check` prints or writes as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wrapjax.subject.subject import Subject
from wrapjax.subject.trials import GAIT, Trials

Cell = str | float | int | None


@dataclass(frozen=True)
class Table:
    """Table for a terminal or a report.

    Parameters
    ----------
    title
        Title.
    header
        Names of the columns with their units.
    rows
        Cells of each row; a missing value is None.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def describe_subject(subject: Subject) -> tuple[Table, ...]:
    """Summarise a subject: overview, EMG channels, trials, joint angles and moments, notes.

    Returns
    -------
    tuple of Table
        Tables with angles in degrees and all other quantities in SI units.
    """
    return (
        _overview(subject),
        _channels(subject),
        _trials(subject),
        _coordinates(subject),
        Table("Notes", ("note",), tuple((note,) for note in subject.notes)),
    )


def tables_content(tables: Iterable[Table]) -> dict[str, list[dict[str, Cell]]]:
    """Return the rows of tables by their titles, each row by column, as JSON files have them."""
    return {
        table.title: [dict(zip(table.header, row, strict=True)) for row in table.rows] for table in tables
    }


def render_tables(tables: tuple[Table, ...]) -> str:
    """Format tables as text with aligned columns, numbers to the right; tables without rows are omitted."""
    return "\n\n".join(_render(table) for table in tables if table.rows) + "\n"


def _overview(subject: Subject) -> Table:
    trials = subject.trials
    rows: tuple[tuple[str, Cell], ...] = (
        ("folder", str(subject.folder)),
        ("mass (kg)", subject.mass_kg),
        ("side", {"l": "left", "r": "right"}[subject.side]),
        ("paretic", {True: "yes", False: "no", None: None}[subject.paretic]),
        ("other leg", None if subject.other_leg is None else str(subject.other_leg)),
        ("model", str(subject.model_file)),
        ("coordinates", ", ".join(trials.moment_coordinates)),
        ("coordinates recorded", len(trials.coordinates)),
        ("driven muscles", len(subject.muscles.names)),
        ("undriven muscles", ", ".join(subject.undriven_muscles) or None),
        ("activation groups", len(subject.activation_groups)),
        ("fiber length groups", len(subject.fiber_length_groups)),
        *(
            (f"{use} {kind}", count)
            for kind, group in (("cycles", trials.is_gait), ("windows of other tasks", ~trials.is_gait))
            for use, count in _counts(trials.select(group)).items()
            if kind == "cycles" or group.any()
        ),
        ("frames a cycle", trials.time.shape[1]),
        ("EMG frames before" if trials.leading else "EMG frames before and after", trials.padding),
    )
    return Table(f"Subject {subject.name}", ("what", "value"), rows)


def _counts(trials: Trials) -> dict[str, int]:
    return {use: len(trials.used_for(use)) for use in ("calibration", "validation")}


def _channels(subject: Subject) -> Table:
    """Tabulate the peak, the mean (all cycles with padding) and the muscles of each EMG channel."""
    rows = []
    for index, channel in enumerate(subject.trials.channels):
        muscles = ", ".join(name for name, driver in subject.channel_of.items() if driver == channel)
        emg = subject.trials.emg[:, index]
        rows.append((channel, float(emg.max()), float(emg.mean()), muscles))
    return Table("EMG channels", ("channel", "peak", "mean", "muscles"), tuple(rows))


def _trials(subject: Subject) -> Table:
    rows = []
    gait_only = all(entry.task == GAIT and not entry.condition for entry in subject.recordings)
    for recording, rate in zip(subject.recordings, subject.emg_rates, strict=True):
        durations = [end - start for start, end in recording.cycles]
        others = () if gait_only else (recording.task, recording.condition or None)
        rows.append(
            (
                recording.name,
                recording.use,
                *others,
                None if math.isnan(recording.speed) else recording.speed,
                len(durations),
                min(durations),
                max(durations),
                None if math.isnan(rate) else rate,
                "yes" if recording.ground_forces else "no",
            )
        )
    header = (
        "trial",
        "use",
        *(() if gait_only else ("task", "condition")),
        "speed (m/s)",
        "cycles" if gait_only else "cycles or intervals",
        "shortest (s)",
        "longest (s)",
        "EMG (Hz)",
        "ground forces",
    )
    return Table("Trials", header, tuple(rows))


def _coordinates(subject: Subject) -> Table:
    trials = subject.trials
    rows = []
    for index, name in enumerate(trials.moment_coordinates):
        angles = np.rad2deg(trials.angles[:, trials.coordinates.index(name)])
        known = trials.moments[:, index][np.isfinite(trials.moments[:, index])]
        ends = (float(known.min()), float(known.max())) if known.size else (None, None)
        rows.append((name, float(angles.min()), float(angles.max()), *ends))
    header = ("coordinate", "angle min (deg)", "max (deg)", "moment min (N m)", "max (N m)")
    return Table("Joint angles and moments over all cycles", header, tuple(rows))


def _render(table: Table) -> str:
    cells = [[_format_cell(cell) for cell in row] for row in table.rows]
    numeric = [
        all(isinstance(row[place], (int, float)) or row[place] is None for row in table.rows)
        for place in range(len(table.header))
    ]
    widths = [max(len(row[place]) for row in [table.header, *cells]) for place in range(len(table.header))]

    def line(row: list[str] | tuple[str, ...]) -> str:
        padded = (
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric, strict=True)
        )
        return "  ".join(padded).rstrip()

    rule = "  ".join("-" * width for width in widths)
    return "\n".join([table.title, line(table.header), rule, *map(line, cells)])


def _format_cell(cell: Cell) -> str:
    if cell is None:
        return "-"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
