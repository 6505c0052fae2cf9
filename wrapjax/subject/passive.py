"""Passive trials: joints moved by somebody else, muscles at rest, and the moments that this took."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import find_column
from wrapjax.io.toml import collecting
from wrapjax.subject.recordings import MOST_MOMENT_PER_MASS, Reader, all_angles, check_angle_unit
from wrapjax.subject.settings import PassiveSettings, Settings


@dataclass(frozen=True)
class PassiveTrial:
    """One recording of a leg at rest.

    Parameters
    ----------
    name
        Of the trial.
    coordinates, angles
        Of the model, those in the file; rad or m. The others are at the model's defaults.
    moment_coordinates, moments
        Those that moments were recorded about; N m, OpenSim's signs.
    """

    name: str
    coordinates: tuple[str, ...]
    angles: Float[np.ndarray, "coordinate sample"]
    moment_coordinates: tuple[str, ...]
    moments: Float[np.ndarray, "moment_coordinate sample"]


def read_passive(
    trial: PassiveSettings,
    settings: Settings,
    model_coordinates: tuple[CoordinateInfo, ...],
    read: Reader,
    problems: list[Problem],
) -> PassiveTrial | None:
    """Read and check a passive trial, adding everything wrong to ``problems``.

    A column of moments that is zero throughout says that nothing was recorded about that coordinate.

    Returns
    -------
    PassiveTrial or None
        None where anything is missing.
    """
    tables = {}
    for kind, path in (("angles", trial.angles), ("moments", trial.moments)):
        with collecting(problems):
            tables[kind] = read(path)
    if len(tables) < 2:
        return None
    angles, moments = tables["angles"], tables["moments"]
    wanted = [info for info in model_coordinates if info.name in settings.coordinates]
    check_angle_unit(angles, wanted, trial.angles, problems)
    inside = (angles.time >= moments.time[0]) & (angles.time <= moments.time[-1])
    if not inside.any():
        message = (
            f"expected times of the angles, {angles.time[0]:g} to {angles.time[-1]:g} s, found "
            f"{moments.time[0]:g} to {moments.time[-1]:g} s"
        )
        problems.append(Problem(str(trial.moments), message))
        return None
    coordinates, values = all_angles(angles, model_coordinates)
    found: dict[str, Float[np.ndarray, " sample"]] = {}
    for name in settings.coordinates:
        columns = [moments.values[:, place] for place in _places(moments.columns, name)]
        if len(columns) > 1:
            problems.append(Problem(str(trial.moments), "expected one column, found several", f"of {name}"))
        elif columns and columns[0].any():
            peak = float(np.abs(columns[0]).max())
            if peak > MOST_MOMENT_PER_MASS * settings.mass_kg:
                limit = f"{MOST_MOMENT_PER_MASS:g} N m per kg of body mass"
                message = f"expected N m, found {peak:.4g}, more than {limit}"
                hint = "are the moments in N mm?"
                problems.append(Problem(str(trial.moments), message, f"column {name}_moment", hint))
            found[name] = np.interp(angles.time[inside], moments.time, columns[0])
    missing = [name for name in found if name not in coordinates]
    for name in missing:
        problems.append(
            Problem(str(trial.angles), "is not in the file, and moments about it are", f"column {name}")
        )
    if not found:
        message = "expected a moment that is not zero about one of the subject's coordinates, found none"
        problems.append(Problem(str(trial.moments), message))
    if missing or not found:
        return None
    return PassiveTrial(
        name=trial.name,
        coordinates=coordinates,
        angles=values[:, inside],
        moment_coordinates=tuple(found),
        moments=np.array(list(found.values())),
    )


def _places(columns: tuple[str, ...], name: str) -> list[int]:
    return list(find_column(columns, name, ("_moment", "_force", "")))
