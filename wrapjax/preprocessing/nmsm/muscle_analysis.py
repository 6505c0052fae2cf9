"""Muscle geometry of a project of the NMSM Pipeline (``MAData``), and its comparison with that of the model.

``MAData`` are tables of OpenSim's muscle analysis. They are not used, as lengths and moment arms are computed
from the model; differences mean that they were made with another model or other angles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import Storage, find_columns, read_storage
from wrapjax.io.toml import collect_problems
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import PathGeometry, analyse_muscles
from wrapjax.preprocessing.nmsm.project import Project, ProjectTrial
from wrapjax.subject.recordings import select_angles

#: Difference of lengths and moment arms above which a warning is given, m. Filters, and OpenSim's wrapping
#: algorithm, cause some tenths of a millimeter.
TOLERANCE = 1e-3
#: Largest number of muscles that are named in one sentence.
_MAX_NAMED = 6
#: Folder of a project's data that holds a folder for each trial.
FOLDER = "MAData"
_LENGTH, _ARM, _SUFFIX = "_Length", "_MomentArm_", ".sto"


@dataclass(frozen=True)
class MuscleAnalysis:
    """Lengths and moment arms of muscles in one trial of a project.

    Parameters
    ----------
    trial
        Name of the trial.
    length
        Muscle-tendon lengths in m, one column for each muscle; None if there is no such table.
    moment_arm
        Moment arms, -d(length)/d(coordinate), in m, by coordinate, one column for each muscle.
    """

    trial: str
    length: Storage | None
    moment_arm: Mapping[str, Storage]


def read_muscle_analyses(
    data_directory: Path, trials: Mapping[str, Path], coordinates: tuple[str, ...]
) -> tuple[MuscleAnalysis, ...]:
    """Read ``MAData/<trial>/*_Length.sto`` and ``*_MomentArm_<coordinate>.sto``.

    Parameters
    ----------
    data_directory
        Data folder of the project.
    trials
        File of angles of each trial, by name; the folder of a trial may have the name of this file.
    coordinates
        Coordinates whose moment arms are read.

    Returns
    -------
    tuple of MuscleAnalysis
        Tables of the trials that have such a folder.

    Raises
    ------
    InputError
        With all faults of these files.
    """
    problems: list[Problem] = []
    analyses = []
    for trial, angles in trials.items():
        folder = next(
            (place for name in (trial, angles.stem) if (place := data_directory / FOLDER / name).is_dir()),
            None,
        )
        if folder is None:
            continue
        files = sorted(file for file in folder.iterdir() if file.is_file())
        tables = {}
        for ending in (_LENGTH, *(f"{_ARM}{coordinate}" for coordinate in coordinates)):
            # OpenSim puts the name of the trial, or that and the name of the analysis, before the ending.
            matches = [file for file in files if file.name.endswith(ending + _SUFFIX)]
            with collect_problems(problems):
                if matches:
                    tables[ending] = read_storage(matches[0])
        arms = {name: tables[_ARM + name] for name in coordinates if _ARM + name in tables}
        analyses.append(MuscleAnalysis(trial, tables.get(_LENGTH), arms))
    if problems:
        raise InputError(problems)
    return tuple(analyses)


@dataclass(frozen=True)
class Difference:
    """Largest difference of a muscle's length or moment arm between project and model.

    Parameters
    ----------
    muscle
        Name of the muscle.
    coordinate
        Coordinate of the moment arm; empty for a length.
    trial
        Trial with the largest difference.
    size
        Largest absolute difference over the frames of the gait cycle, m. It can be large because of a single
        frame in which a path jumps onto or off a wrap.
    root_mean_square
        Root mean square of the difference over the frames, m.
    """

    muscle: str
    coordinate: str
    trial: str
    size: float
    root_mean_square: float

    def __str__(self) -> str:
        about = f" about {self.coordinate}" if self.coordinate else ""
        size, mean = 1e3 * self.size, 1e3 * self.root_mean_square
        return f"{self.muscle}{about} {size:.2f} mm (rms {mean:.2f}) in {self.trial}"


def compare_muscle_analyses(
    project: Project, log: Callable[[str], None] = lambda line: None
) -> tuple[str, ...]:
    """Compare the ``MAData`` of a project with the muscle paths of its model in its gait cycles.

    Parameters
    ----------
    project
        Project from `read_project`.
    log
        Function called with each line of progress.

    Returns
    -------
    tuple of str
        Sentences: the largest differences, a warning about those above a millimeter, and trials that could
        not be compared. Empty without ``MAData``.

    Raises
    ------
    InputError
        With all faults of the files of ``MAData``.
    """
    settings = project.settings
    files = {trial.name: trial.files["angles"] for trial in project.trials}
    analyses = read_muscle_analyses(settings.data_directory, files, settings.coordinates)
    if not analyses:
        return ()
    log("comparing MAData with the muscle paths of the model")
    try:
        found = find_differences(project, analyses)
    except InputError as error:
        return (f"MAData is not compared with the model's muscle paths: {error.problems[0]}",)
    notes = [*_describe_largest(found), *_warning(found)]
    missing = [name for name in files if name not in {analysis.trial for analysis in analyses}]
    if missing:
        notes.append(f"MAData lacks the trials {', '.join(missing)}")
    return tuple(notes)


def find_differences(project: Project, analyses: Sequence[MuscleAnalysis]) -> tuple[Difference, ...]:
    """Find the largest difference of each muscle's length, and of its moment arm about each coordinate.

    Parameters
    ----------
    project
        Project whose muscles with a channel or in an extrapolated group are compared.
    analyses
        ``MAData`` of its trials.

    Raises
    ------
    InputError
        If OpenSim cannot analyse the model at these angles.
    """
    muscles = tuple(
        name for members in (*project.channels.values(), *project.extrapolated.values()) for name in members
    )
    recorded = {trial.name: trial for trial in project.trials}
    model = describe_model(project.settings.model_file)
    # OpenSim computes coupled coordinates, and locked ones have constant values.
    free = {entry.name for entry in model.coordinates if not entry.coupled_to and not entry.locked}
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)} & free
    cycles = [_read_poses(project, recorded[analysis.trial], spanned) for analysis in analyses]
    coordinates = tuple(name for name in cycles[0][1] if all(name in names for _, names, _ in cycles))
    rows = [angles[[names.index(name) for name in coordinates]] for _, names, angles in cycles]
    geometry = analyse_muscles(
        project.settings.model_file, muscles, coordinates, np.concatenate(rows, axis=1).T, quiet=True
    )
    largest: dict[tuple[str, str], Difference] = {}
    first = 0
    for analysis, (time, _, _) in zip(analyses, cycles, strict=True):
        frames = slice(first, first := first + len(time))
        for difference in _trial_differences(analysis, time, geometry, frames):
            key = (difference.muscle, difference.coordinate)
            if key not in largest or largest[key].size < difference.size:
                largest[key] = difference
    return tuple(largest.values())


def _read_poses(
    project: Project, trial: ProjectTrial, needed: set[str]
) -> tuple[Float[np.ndarray, " frame"], tuple[str, ...], Float[np.ndarray, "coordinate frame"]]:
    """Read times of the frames of a gait cycle, and names and values (rad or m) of the needed coordinates."""
    table = read_storage(trial.files["angles"])
    infos = read_model_file(project.settings.model_file).coordinates
    names, angles = select_angles(table, tuple(info for info in infos if info.name in needed))
    inside = (table.time >= trial.cycle[0]) & (table.time <= trial.cycle[1])
    return table.time[inside], names, angles[:, inside]


def _trial_differences(
    analysis: MuscleAnalysis, time: Float[np.ndarray, " frame"], geometry: PathGeometry, frames: slice
) -> Iterator[Difference]:
    for row, muscle in enumerate(geometry.muscles):
        given = _column(analysis.length, muscle, time)
        yield from _difference(muscle, "", analysis.trial, given, geometry.length[frames, row])
        for place, coordinate in enumerate(geometry.coordinates):
            given = _column(analysis.moment_arm.get(coordinate), muscle, time)
            computed = geometry.moment_arm[frames, place, row]
            yield from _difference(muscle, coordinate, analysis.trial, given, computed)


def _column(
    table: Storage | None, muscle: str, time: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, " frame"]:
    """Interpolate a muscle's column at these times; NaN without a column and outside the table."""
    places = [] if table is None else find_columns(table.columns, muscle)
    if table is None or len(places) != 1:
        return np.full(len(time), np.nan)
    # Times are rounded differently in different files.
    tolerance = 0.5 * float(np.diff(time).min())
    values = np.interp(time, table.time, table.values[:, places[0]])
    inside = (time >= table.time[0] - tolerance) & (time <= table.time[-1] + tolerance)
    return np.where(inside, values, np.nan)


def _difference(
    muscle: str,
    coordinate: str,
    trial: str,
    given: Float[np.ndarray, " frame"],
    computed: Float[np.ndarray, " frame"],
) -> Iterator[Difference]:
    known = np.isfinite(given)
    if known.any():
        error = np.abs(given - computed)[known]
        yield Difference(muscle, coordinate, trial, float(error.max()), float(np.sqrt(np.mean(error**2))))


def _describe_largest(found: Sequence[Difference]) -> list[str]:
    if not found:
        return ["MAData holds no lengths and moment arms of this leg's muscles in these cycles: not compared"]
    largest = {
        kind: max(differences, key=lambda difference: difference.size)
        for kind, differences in (("lengths", _lengths(found)), ("moment arms", _moment_arms(found)))
        if differences
    }
    listed = "; of ".join(f"{kind} {difference}" for kind, difference in largest.items())
    return [f"MAData compared with the muscle paths of the model: the largest difference of {listed}"]


def _warning(found: Sequence[Difference]) -> list[str]:
    parts = []
    for kind, differences in (("lengths", _lengths(found)), ("moment arms", _moment_arms(found))):
        large = sorted(
            (difference for difference in differences if difference.size > TOLERANCE),
            key=lambda difference: -difference.size,
        )
        if large:
            parts.append(f"{kind} of {_list_differences(large)}")
    if not parts:
        return []
    return [
        f"warning: MAData differs from the muscle paths of the model by more than {1e3 * TOLERANCE:g} mm: "
        f"{'; '.join(parts)}. It is not used, as lengths and moment arms are computed from the model; check "
        "whether it was made with this model and these angles"
    ]


def _lengths(found: Sequence[Difference]) -> list[Difference]:
    return [difference for difference in found if not difference.coordinate]


def _moment_arms(found: Sequence[Difference]) -> list[Difference]:
    return [difference for difference in found if difference.coordinate]


def _list_differences(large: Sequence[Difference]) -> str:
    listed = ", ".join(map(str, large[:_MAX_NAMED]))
    return listed if len(large) <= _MAX_NAMED else f"{listed} and {len(large) - _MAX_NAMED} more"
