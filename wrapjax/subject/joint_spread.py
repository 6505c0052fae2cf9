"""How sure the places of a model's joints are, from a folder that ``wrapjax joints`` wrote."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.json_and_arrays import load_json

#: File of the folder that is read.
JOINTS_FILE = "joints.json"
#: Largest standard deviations that are believed, m and rad.
_LARGEST = {"translation_m": 0.2, "orientation_rad": math.pi}


@dataclass(frozen=True)
class JointSpread:
    """Standard deviations of the place of a joint in its parent body, given the person's markers.

    Parameters
    ----------
    translation
        Along the body's axes, m; None where not personalised.
    orientation
        Of rotations of the joint's frame about the body's axes, rad; None where not personalised.
    correlation
        By coordinate of each joint: correlation of translations and orientations (rows) with those of that
        joint (columns). Empty where the folder has none.
    """

    translation: tuple[float | None, ...]
    orientation: tuple[float | None, ...]
    correlation: Mapping[str, Float[np.ndarray, "6 6"]] = field(
        default_factory=dict, compare=False, repr=False
    )


def read_joint_spread(path: Path, coordinates: Collection[str]) -> dict[str, JointSpread]:
    """Read the standard deviations of personalised joints.

    Parameters
    ----------
    path
        Folder that ``wrapjax joints`` wrote, or its ``joints.json``.
    coordinates
        Names of the model's coordinates.

    Returns
    -------
    dict
        By name of each coordinate of a personalised joint.

    Raises
    ------
    InputError
        If the file does not exist, is not such a file, or names coordinates that the model lacks.
    """
    file = path / JOINTS_FILE if path.is_dir() else path
    try:
        content = load_json(file)
    except OSError:
        message = f"expected a folder with {JOINTS_FILE}, written by 'wrapjax joints', found none"
        raise InputError(Problem(str(file), message)) from None
    except ValueError as error:
        raise InputError(Problem(str(file), f"expected JSON: {error}")) from None
    joints = content.get("joints") if isinstance(content, dict) else None
    if not isinstance(joints, dict):
        raise InputError(Problem(str(file), "expected a table 'joints' of personalised joints, found none"))
    found: dict[str, JointSpread] = {}
    problems: list[Problem] = []
    names = {name: _coordinates(joint) for name, joint in joints.items()}
    for name, joint in joints.items():
        spread = _spread(joint, names)
        if spread is None:
            message = (
                "expected coordinates, and under spread three standard deviations each of translation_m and "
                "orientation_rad, positive or null, and correlations of six with six places, found something "
                "else"
            )
            problems.append(Problem(str(file), message, f"joint {name}"))
            continue
        for coordinate in joint["coordinates"]:
            if coordinate not in coordinates:
                message = f"expected a coordinate of the subject's model, found '{coordinate}'"
                hint = nearest_name(coordinate, tuple(coordinates))
                problems.append(Problem(str(file), message, f"joint {name}", hint))
            found[coordinate] = spread
    if problems:
        raise InputError(problems)
    return found


def _coordinates(joint: Any) -> list[str] | None:
    """Read the names of a joint's coordinates; None where they are not of the expected form."""
    names = joint.get("coordinates") if isinstance(joint, dict) else None
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return names if is_list else None


def _spread(joint: Any, coordinates: Mapping[str, list[str] | None]) -> JointSpread | None:
    """Read a joint's entry, given the coordinates of all; None where it is not of the expected form."""
    if _coordinates(joint) is None or not isinstance(joint.get("spread"), dict):
        return None
    parts = [joint["spread"].get(key) for key in _LARGEST]
    for values, largest in zip(parts, _LARGEST.values(), strict=True):
        if not isinstance(values, list) or len(values) != 3:
            return None
        for value in values:
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if value is not None and not (number and 0.0 < value <= largest):
                return None
    correlation = joint["spread"].get("correlation", {})
    if not isinstance(correlation, dict):
        return None
    by_coordinate: dict[str, Float[np.ndarray, "6 6"]] = {}
    for other, rows in correlation.items():
        matrix = _correlation(rows)
        if matrix is None:
            return None
        by_coordinate |= dict.fromkeys(coordinates.get(other) or (), matrix)
    return JointSpread(tuple(parts[0]), tuple(parts[1]), by_coordinate)


def _correlation(rows: Any) -> Float[np.ndarray, "6 6"] | None:
    """Read correlations of six places with six; None where they are not of the expected form."""
    try:
        matrix = np.array(rows, dtype=float)
    except (TypeError, ValueError):
        return None
    # Rounding may exceed one.
    return matrix if matrix.shape == (6, 6) and np.all(np.abs(matrix) <= 1.0 + 1e-9) else None
