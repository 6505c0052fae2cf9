"""A project's own muscle geometry (``MAData``): what OpenSim's muscle analysis wrote of each trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.subject import Storage, read_storage
from wrapjax.subject.schema import collecting

#: Folder of a project's data, with a folder a trial.
FOLDER = "MAData"
_LENGTH, _ARM, _SUFFIX = "_Length", "_MomentArm_", ".sto"


@dataclass(frozen=True)
class MuscleAnalysis:
    """Lengths and moment arms of muscles in one trial, as a project keeps them.

    Parameters
    ----------
    trial
        Its name.
    length
        Muscle-tendon lengths in m, a column a muscle; None where there is no such table.
    moment_arm
        By coordinate, moment arms in m, of the sign of -d(length)/d(coordinate), a column a muscle.
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
        Of the project.
    trials
        By name, the file of angles, which a trial's folder may be called after, too.
    coordinates
        Whose moment arms are read.

    Returns
    -------
    tuple of MuscleAnalysis
        Of the trials that have such a folder.

    Raises
    ------
    InputError
        With everything wrong in these files.
    """
    problems: list[Problem] = []
    found = []
    for trial, angles in trials.items():
        folder = next(
            (place for name in (trial, angles.stem) if (place := data_directory / FOLDER / name).is_dir()),
            None,
        )
        if folder is None:
            continue
        there = sorted(file for file in folder.iterdir() if file.is_file())
        tables = {}
        for ending in (_LENGTH, *(f"{_ARM}{coordinate}" for coordinate in coordinates)):
            # As the analysis names them, with something before: the trial, or the trial and its own name.
            files = [file for file in there if file.name.endswith(ending + _SUFFIX)]
            with collecting(problems):
                if files:
                    tables[ending] = read_storage(files[0])
        arms = {name: tables[_ARM + name] for name in coordinates if _ARM + name in tables}
        found.append(MuscleAnalysis(trial, tables.get(_LENGTH), arms))
    if problems:
        raise InputError(problems)
    return tuple(found)
