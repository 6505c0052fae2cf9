"""Reading of the CSV table of muscle parameters, and checks of driven muscles and of their parameters."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content
from wrapjax.io.model_file import MuscleParameters

#: Columns of the table of muscle parameters and the upper limit of their values, which reveals other units.
CSV_COLUMNS = {
    "max_isometric_force_N": 50_000.0,
    "optimal_fiber_length_m": 1.0,
    "tendon_slack_length_m": 1.0,
    "pennation_rad": float(np.pi / 2),
}
_FIELDS = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length", "pennation_angle")


def read_muscle_parameters(path: Path) -> MuscleParameters:
    """Read muscle parameters from the columns ``muscle`` and `CSV_COLUMNS` of a CSV file.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    content = read_content(path, "a table of muscle parameters")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        message = "is not text in UTF-8, where a table of muscle parameters was expected"
        raise InputError(Problem(str(path), message)) from None
    try:
        lines = list(csv.reader(text.splitlines()))
    except csv.Error as error:
        raise InputError(Problem(str(path), f"is not a comma-separated table ({error})")) from None
    labels = [label.strip() for label in lines[0]] if lines else []
    missing = [label for label in ("muscle", *CSV_COLUMNS) if label not in labels]
    if missing:
        raise InputError(
            Problem(
                str(path), f"expected a column {label}, found none", "line 1", nearest_name(label, labels)
            )
            for label in missing
        )
    problems: list[Problem] = []
    table: dict[str, list[float]] = {}
    for number, cells in enumerate(lines[1:], start=2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(labels):
            message = f"expected {len(labels)} cells, found {len(cells)}"
            problems.append(Problem(str(path), message, f"line {number}"))
            continue
        row = dict(zip(labels, (cell.strip() for cell in cells), strict=True))
        muscle = row["muscle"]
        if not muscle or muscle in table:
            found = f"'{muscle}' a second time" if muscle else "no name"
            problems.append(
                Problem(str(path), f"expected the name of a muscle, found {found}", f"line {number}")
            )
            continue
        table[muscle] = []
        for label in CSV_COLUMNS:
            try:
                table[muscle].append(float(row[label]))
            except ValueError:
                table[muscle].append(np.nan)
                place = f"line {number}, column {label}, muscle {muscle}"
                problems.append(Problem(str(path), f"expected a number, found '{row[label][:40]}'", place))
    if not table and not problems:
        problems.append(Problem(str(path), "expected a row for each muscle, found none"))
    if problems:
        raise InputError(problems)
    columns = np.array(list(table.values()), dtype=float)
    return MuscleParameters(tuple(table), columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3])


def check_channels(
    channels: dict[str, tuple[str, ...]],
    model: MuscleParameters,
    side: str,
    file: Path,
    problems: list[Problem],
    table: str = "[emg.channels]",
) -> tuple[str, ...]:
    """Report muscles that the model lacks or that belong to the other leg, and return the valid ones.

    Parameters
    ----------
    channels
        Names of the muscles of each channel.
    model
        Muscles of the model.
    side
        Side of the leg, ``l`` or ``r``.
    file
        Settings file, for error messages.
    problems
        List to which problems are added.
    table
        Name of the table of settings, for error messages.

    Returns
    -------
    tuple of str
        Valid muscles: channel by channel, in the order of each list.
    """
    driven = []
    for channel, muscles in channels.items():
        for muscle in muscles:
            place = f"{table} {channel}"
            if muscle not in model.names:
                message = f"muscle '{muscle}' is not in the model"
                problems.append(Problem(str(file), message, place, nearest_name(muscle, model.names)))
            elif not is_on_side(muscle, side):
                message = f"expected muscles of side '{side}', found '{muscle}'"
                problems.append(Problem(str(file), message, place))
            else:
                driven.append(muscle)
    return tuple(dict.fromkeys(driven))


def is_on_side(name: str, side: str) -> bool:
    """Return whether a muscle or coordinate can belong to a leg: its name lacks the other side's suffix."""
    return not name.endswith({"l": "_r", "r": "_l"}.get(side, "\0"))


def check_muscle_parameters(
    parameters: MuscleParameters, driven: tuple[str, ...], file: Path, problems: list[Problem]
) -> MuscleParameters | None:
    """Report driven muscles without parameters or with impossible ones, and return the parameters of all.

    Returns
    -------
    MuscleParameters or None
        Parameters in the order of ``driven``; None if there is a problem.
    """
    before = len(problems)
    for muscle in driven:
        if muscle not in parameters.names:
            message = f"expected a row for muscle '{muscle}', which an EMG channel drives, found none"
            problems.append(Problem(str(file), message, hint=nearest_name(muscle, parameters.names)))
            continue
        row = parameters.names.index(muscle)
        for field, (label, highest) in zip(_FIELDS, CSV_COLUMNS.items(), strict=True):
            value = float(getattr(parameters, field)[row])
            above_lowest = value >= 0.0 if field == "pennation_angle" else value > 0.0
            if not (above_lowest and value < highest):
                bound = "from 0" if field == "pennation_angle" else "above 0"
                unit = label.rsplit("_", 1)[1]
                message = f"expected {field} {bound} and below {highest:.6g} {unit}, found {value:g}"
                problems.append(Problem(str(file), message, f"muscle {muscle}"))
    return parameters.select(driven) if len(problems) == before else None
