"""Reading of passive trials for initial lengths (table ``[[passive]]``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import find_columns
from wrapjax.io.toml import collect_problems
from wrapjax.subject.recordings import Reader, Signals, check_angle_unit, select_angles, within_intervals
from wrapjax.subject.settings import PassiveSettings, Settings
from wrapjax.subject.trial_checks import MAX_MOMENT_PER_MASS
from wrapjax.subject.trials import GAIT

#: Most samples of a trial of task ``passive`` that determine initial lengths.
MOST_SAMPLES = 101


@dataclass(frozen=True)
class PassiveTrial:
    """Recording of a leg with relaxed muscles.

    Parameters
    ----------
    name
        Name of the trial.
    coordinates
        Coordinates of the model in the file; the others have the model's default values.
    angles
        Values of the coordinates, rad or m.
    moment_coordinates
        Coordinates about which moments were recorded.
    moments
        Joint moments, N m, with OpenSim's signs.
    """

    name: str
    coordinates: tuple[str, ...]
    angles: Float[np.ndarray, "coordinate sample"]
    moment_coordinates: tuple[str, ...]
    moments: Float[np.ndarray, "moment_coordinate sample"]


def read_passive_trial(
    trial: PassiveSettings,
    settings: Settings,
    model_coordinates: tuple[CoordinateInfo, ...],
    read: Reader,
    problems: list[Problem],
) -> PassiveTrial | None:
    """Read and check a passive trial and add its faults to ``problems``.

    A column of moments that is zero throughout means that no moment was recorded about that coordinate.

    Returns
    -------
    PassiveTrial or None
        None if a file or a column is missing.
    """
    tables = {}
    for kind, path in (("angles", trial.angles), ("moments", trial.moments)):
        with collect_problems(problems):
            tables[kind] = read(path)
    if len(tables) < 2:
        return None
    angles, moments = tables["angles"], tables["moments"]
    predicted = [info for info in model_coordinates if info.name in settings.coordinates]
    check_angle_unit(angles, predicted, trial.angles, problems)
    inside = (angles.time >= moments.time[0]) & (angles.time <= moments.time[-1])
    if not inside.any():
        message = (
            f"expected the times of the angles, {angles.time[0]:g} to {angles.time[-1]:g} s, found "
            f"{moments.time[0]:g} to {moments.time[-1]:g} s"
        )
        problems.append(Problem(str(trial.moments), message))
        return None
    coordinates, values = select_angles(angles, model_coordinates)
    recorded: dict[str, Float[np.ndarray, " sample"]] = {}
    for name in settings.coordinates:
        columns = [
            moments.values[:, place]
            for place in find_columns(moments.columns, name, ("_moment", "_force", ""))
        ]
        if len(columns) > 1:
            problems.append(Problem(str(trial.moments), "expected one column, found several", f"of {name}"))
        elif columns and columns[0].any():
            peak = float(np.abs(columns[0]).max())
            if peak > MAX_MOMENT_PER_MASS[GAIT] * settings.mass_kg:
                limit = f"{MAX_MOMENT_PER_MASS[GAIT]:g} N m per kg of body mass"
                message = f"expected N m, found {peak:.4g}, more than {limit}"
                hint = "are the moments in N mm?"
                problems.append(Problem(str(trial.moments), message, f"column {name}_moment", hint))
            recorded[name] = np.interp(angles.time[inside], moments.time, columns[0])
    missing = [name for name in recorded if name not in coordinates]
    for name in missing:
        problems.append(
            Problem(
                str(trial.angles),
                "is not in the file, although moments about it were recorded",
                f"column {name}",
            )
        )
    if not recorded:
        message = "expected a moment that is not zero about one of the subject's coordinates, found none"
        problems.append(Problem(str(trial.moments), message))
    if missing or not recorded:
        return None
    return PassiveTrial(
        name=trial.name,
        coordinates=coordinates,
        angles=values[:, inside],
        moment_coordinates=tuple(recorded),
        moments=np.array(list(recorded.values())),
    )


def as_passive_trial(signals: Signals, names: tuple[str, ...]) -> PassiveTrial:
    """Return a trial of task ``passive`` as `initialise` uses it: samples of its angles in its intervals.

    Of many samples, `MOST_SAMPLES` at equal distances are kept.

    Parameters
    ----------
    signals
        Signals of the trial.
    names
        Coordinates of the subject's moments.
    """
    inside = np.flatnonzero(within_intervals(signals))
    if inside.size > MOST_SAMPLES:
        inside = inside[np.linspace(0, inside.size - 1, MOST_SAMPLES).astype(int)]
    measured = np.isfinite(signals.moments).all(axis=1)
    time = signals.angle_time[inside]
    return PassiveTrial(
        name=signals.trial.name,
        coordinates=signals.coordinates,
        angles=signals.angles[:, inside],
        moment_coordinates=tuple(name for name, has in zip(names, measured, strict=True) if has),
        moments=np.array(
            [np.interp(time, signals.moment_time, moment) for moment in signals.moments[measured]]
        ),
    )
