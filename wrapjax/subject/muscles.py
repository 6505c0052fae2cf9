"""Which muscles are driven, and with which parameters.

Muscles that act alike: groups whose parameters a calibration keeps similar.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content
from wrapjax.io.model_file import MuscleParameters

#: Columns of a table of muscle parameters, with the greatest value that makes sense in the column's unit.
#: A fiber of a metre, 50 kN of one muscle or a right angle of pennation mean another unit.
CSV_COLUMNS = {
    "max_isometric_force_N": 50_000.0,
    "optimal_fiber_length_m": 1.0,
    "tendon_slack_length_m": 1.0,
    "pennation_rad": float(np.pi / 2),
}
_FIELDS = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length", "pennation_angle")


def read_muscle_parameters(path: Path) -> MuscleParameters:
    """Read muscle parameters from a CSV file: columns ``muscle`` and those of `CSV_COLUMNS`, others ignored.

    Raises
    ------
    InputError
        With everything wrong in the file.
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
        problems.append(Problem(str(path), "expected a row a muscle, found none"))
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
    """Report muscles that the model does not have or that are the other leg's; return the others.

    The last argument is the name of the table of settings that they are from.

    Returns
    -------
    tuple of str
        The driven muscles: channel by channel, in the order of each list.
    """
    driven = []
    for channel, muscles in channels.items():
        for muscle in muscles:
            place = f"{table} {channel}"
            if muscle not in model.names:
                message = f"muscle '{muscle}' is not in the model"
                problems.append(Problem(str(file), message, place, nearest_name(muscle, model.names)))
            elif not of_side(muscle, side):
                message = f"expected muscles of side '{side}', found '{muscle}'"
                problems.append(Problem(str(file), message, place))
            else:
                driven.append(muscle)
    return tuple(dict.fromkeys(driven))


def of_side(name: str, side: str) -> bool:
    """Say whether a muscle or coordinate may be of a leg: it does not carry the other one's suffix."""
    return not name.endswith({"l": "_r", "r": "_l"}.get(side, "\0"))


def check_muscle_parameters(
    parameters: MuscleParameters, driven: tuple[str, ...], file: Path, problems: list[Problem]
) -> MuscleParameters | None:
    """Report driven muscles that are missing or have impossible values; return the driven ones, in order.

    Returns
    -------
    MuscleParameters or None
        None where anything is wrong.
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
            lowest_fits = value >= 0.0 if field == "pennation_angle" else value > 0.0
            if not (lowest_fits and value < highest):
                bound = "from 0" if field == "pennation_angle" else "above 0"
                unit = label.rsplit("_", 1)[1]
                message = f"expected {field} {bound} and below {highest:.6g} {unit}, found {value:g}"
                problems.append(Problem(str(file), message, f"muscle {muscle}"))
    return parameters.select(driven) if len(problems) == before else None


#: Activation groups of Rajagopal-type models, without the side (Meyer et al. 2017; NMSM Pipeline).
STANDARD_ACTIVATION_GROUPS = (
    ("addbrev", "addlong", "addmagDist", "addmagIsch", "addmagMid", "addmagProx"),
    ("glmax1", "glmax2", "glmax3"),
    ("glmed1", "glmed2", "glmed3"),
    ("glmin1", "glmin2", "glmin3"),
    ("iliacus", "psoas"),
    ("semimem", "semiten"),
    ("bflh", "bfsh"),
    ("perbrev", "perlong"),
)
#: Groups of similar normalised fiber length, from the same source.
STANDARD_FIBER_LENGTH_GROUPS = (
    ("addbrev", "addlong", "addmagDist", "addmagIsch", "addmagMid", "addmagProx"),
    ("glmax1", "glmax2", "glmax3"),
    ("glmed1", "glmed2", "glmed3"),
    ("glmin1", "glmin2", "glmin3"),
    ("vasint", "vaslat", "vasmed"),
    ("semimem", "semiten", "bflh"),
    ("perbrev", "perlong"),
    ("iliacus", "psoas"),
    ("gaslat", "gasmed", "soleus"),
    ("tibant", "edl"),
    ("tibpost", "fdl"),
)


def activation_groups(
    model_groups: dict[str, tuple[str, ...]], driven: tuple[str, ...], side: str
) -> tuple[tuple[str, ...], ...]:
    """Choose the groups that share their excitation's timing and scale.

    Parameters
    ----------
    model_groups
        The model's groups of forces. Those with ``ActivationGroup`` in their name win over the standard ones.
    driven
        Muscles that an EMG channel drives; others are left out, and with them groups of fewer than two.
    side
        ``l`` or ``r``.
    """
    return _choose(model_groups, "ActivationGroup", STANDARD_ACTIVATION_GROUPS, driven, side)


def fiber_length_groups(
    model_groups: dict[str, tuple[str, ...]], driven: tuple[str, ...], side: str
) -> tuple[tuple[str, ...], ...]:
    """Choose the groups of similar normalised fiber length: ``FiberLengthGroup`` ones, else standard."""
    return _choose(model_groups, "FiberLengthGroup", STANDARD_FIBER_LENGTH_GROUPS, driven, side)


def _choose(
    model_groups: dict[str, tuple[str, ...]],
    word: str,
    standard: tuple[tuple[str, ...], ...],
    driven: tuple[str, ...],
    side: str,
) -> tuple[tuple[str, ...], ...]:
    # The muscles driven are all of one leg, so that groups of the other leg drop out with their members.
    own = _at_least_two([members for name, members in model_groups.items() if word in name], driven)
    return own or _at_least_two([tuple(f"{name}_{side}" for name in group) for group in standard], driven)


def _at_least_two(groups: list[tuple[str, ...]], driven: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    kept = (tuple(muscle for muscle in group if muscle in driven) for group in groups)
    return tuple(group for group in kept if len(group) >= 2)
