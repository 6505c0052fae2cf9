"""From a project of the NMSM Pipeline to a subject folder.

A project's own muscle geometry (``MAData``): what OpenSim's muscle analysis wrote of each trial.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text
from wrapjax.io.model_file import ModelFile, MuscleParameters, read_model_file, read_xml
from wrapjax.io.storage import Storage, read_storage
from wrapjax.io.toml import collecting, quoted, quoted_list
from wrapjax.preprocessing.nmsm_osimx import OsimxMuscle, ToolSettings, read_osimx, read_tool_settings
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.trials import FRAMES

#: Folders of a project's data, by what is in them.
FOLDERS = {"angles": "IKData", "moments": "IDData", "emg": "EMGData"}
_SUFFIXES = (".sto", ".mot")
_LENGTHS = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")


@dataclass(frozen=True)
class Recorded:
    """A trial of a project: one gait cycle.

    Parameters
    ----------
    name
        Of the trial.
    files
        By kind: ``angles``, ``moments``, ``emg``.
    cycle
        Its start and end in s, without what the project keeps beside it.
    """

    name: str
    files: dict[str, Path]
    cycle: tuple[float, float]


@dataclass(frozen=True)
class Project:
    """One leg of a project, as a subject takes it.

    Parameters
    ----------
    settings
        What was read.
    side, mass_kg
        Of the leg, and of all bodies of the model.
    channels
        The muscles of this leg that each channel drives.
    extrapolated
        The muscles of this leg in each group without a channel: they have an excitation in common.
    trials
        The gait cycles.
    muscles
        Parameters where an ``.osimx`` file gives some, else None: the model's then hold.
    notes
        What of the project a subject does not have.
    """

    settings: ToolSettings
    side: str
    mass_kg: float
    channels: dict[str, tuple[str, ...]]
    extrapolated: dict[str, tuple[str, ...]]
    trials: tuple[Recorded, ...]
    muscles: MuscleParameters | None
    notes: tuple[str, ...]


def read_project(path: str | Path) -> Project:
    """Read a project by its settings of muscle-tendon personalisation.

    Raises
    ------
    InputError
        With everything wrong in it.
    """
    settings = read_tool_settings(path)
    model = read_model_file(settings.model_file)
    problems: list[Problem] = []
    side = _side(settings, problems)
    channels = _channels(settings, model, side, problems)
    trials = _trials(settings, problems)
    notes: list[str] = []
    extrapolated = _extrapolated(settings, model, side, channels, problems, notes)
    muscles = None
    if settings.osimx_file is not None:
        earlier = read_osimx(settings.osimx_file)
        muscles = _with_lengths(model.muscles, earlier)
        if any(set(muscle.values) - set(_LENGTHS) for muscle in earlier):
            notes.append(
                f"{settings.osimx_file.name}: lengths and forces are taken over; delays, time constants and "
                "EMG scales are calibrated anew"
            )
    if settings.passive:
        notes.append(
            f"passive trials ('{settings.passive}') are not taken over; where angles and moments of them are "
            "known, list both as [[passive]] for 'wrapjax initialise'"
        )
    mass = _mass(settings.model_file, problems)
    if problems:
        raise InputError(problems)
    return Project(settings, side, mass, channels, extrapolated, trials, muscles, tuple(notes))


def fill_subject_folder(project: Project, folder: Path, name: str) -> None:
    """Fill an empty folder with a project, as a subject of this name; files are copied as they are."""
    shutil.copyfile(project.settings.model_file, folder / "model.osim")
    if project.muscles is not None:
        write_text(folder / "muscle_parameters.csv", _parameter_table(project.muscles))
    for trial in project.trials:
        (folder / "trials" / trial.name).mkdir(parents=True)
        for kind, file in trial.files.items():
            shutil.copyfile(file, folder / _place(trial, kind))
    write_text(folder / SETTINGS_FILE, _settings_text(project, name))


def _side(settings: ToolSettings, problems: list[Problem]) -> str:
    sides = {coordinate[-2:] for coordinate in settings.coordinates}
    if sides in ({"_l"}, {"_r"}):
        return sides.pop()[1:]
    listed = ", ".join(settings.coordinates)
    problems.append(
        Problem(
            str(settings.file),
            f"expected coordinates of one leg, which end in _l or in _r, found {listed}",
            "<coordinate_list>",
            "a subject is one leg: give each settings of its own",
        )
    )
    return ""


def _channels(
    settings: ToolSettings, model: ModelFile, side: str, problems: list[Problem]
) -> dict[str, tuple[str, ...]]:
    tag = "collected_emg_channel_muscle_groups"
    before = len(problems)
    channels = _groups_of_leg(settings.collected, tag, settings, model, side, problems)
    if settings.collected and not channels and len(problems) == before:
        found = f"expected a group with muscles that end in _{side}, found none"
        problems.append(Problem(str(settings.file), found, f"<{tag}>"))
    return channels


def _extrapolated(
    settings: ToolSettings,
    model: ModelFile,
    side: str,
    channels: dict[str, tuple[str, ...]],
    problems: list[Problem],
    notes: list[str],
) -> dict[str, tuple[str, ...]]:
    """Keep the groups without EMG, of muscles that nothing else excites, and say what can drive them."""
    taken = {muscle for own in channels.values() for muscle in own}
    found = {}
    tag = "missing_emg_channel_muscle_groups"
    for group, muscles in _groups_of_leg(settings.missing, tag, settings, model, side, problems).items():
        twice = [muscle for muscle in muscles if muscle in taken]
        if twice:
            notes.append(f"group {group}: without {', '.join(twice)}, which another group has already")
        own = tuple(muscle for muscle in muscles if muscle not in taken)
        if own:
            found[group] = own
            taken.update(own)
    if found:
        notes.append(
            f"no EMG: the groups {', '.join(found)}, kept as [emg.extrapolated]; with 'wrapjax calibrate "
            "--undriven synergies' each has an excitation by synergies of the measured EMG, and without that "
            "option nothing drives them"
        )
    return found


def _groups_of_leg(
    groups: Sequence[str],
    tag: str,
    settings: ToolSettings,
    model: ModelFile,
    side: str,
    problems: list[Problem],
) -> dict[str, tuple[str, ...]]:
    """Look up the muscles of this leg in each group; groups of the other leg alone are left out."""
    found = {}
    for group in groups:
        if group not in model.groups:
            message = f"names the group '{group}', which {settings.model_file.name} does not have"
            hint = nearest_name(group, list(model.groups))
            problems.append(Problem(str(settings.file), message, f"<{tag}>", hint))
            continue
        own = tuple(
            name for name in model.groups[group] if name in model.muscles.names and name.endswith(f"_{side}")
        )
        if own:
            found[group] = own
    return found


def _trials(settings: ToolSettings, problems: list[Problem]) -> tuple[Recorded, ...]:
    angles = settings.data_directory / FOLDERS["angles"]
    files = _tables(angles)
    if not files:
        problems.append(Problem(str(angles), "expected a .sto or .mot file a trial, found none"))
    found = []
    prefixes = settings.prefixes or tuple(file.stem.removesuffix("_ik") for file in files)
    wanted = [file for file in files if file.stem.startswith(prefixes)] if prefixes else []
    if files and not wanted:
        listed = ", ".join(settings.prefixes)
        problems.append(Problem(str(angles), f"expected files that begin with {listed}, found none"))
    for file in wanted:
        name = file.stem.removesuffix("_ik")
        own = {"angles": file}
        for kind in ("moments", "emg"):
            folder = settings.data_directory / FOLDERS[kind]
            match = [other for other in _tables(folder) if _same_trial(other.stem, name)]
            if not match:
                problems.append(Problem(str(folder), f"expected a file of the trial '{name}', found none"))
                continue
            own[kind] = match[0]
        found.append(Recorded(name, own, _cycle(file, problems)))
    return tuple(found)


def _tables(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)


def _same_trial(stem: str, trial: str) -> bool:
    return stem in (trial, *(f"{trial}_{kind}" for kind in ("id", "emg")))


def _cycle(file: Path, problems: list[Problem]) -> tuple[float, float]:
    """Leave out the frames beside the cycle: the same number at either end, and `FRAMES` between them."""
    time = read_storage(file).time
    beside, odd = divmod(len(time) - FRAMES, 2)
    if beside < 0 or odd:
        message = f"expected {FRAMES} frames, and as many before as after them, found {len(time)}"
        problems.append(Problem(str(file), message))
        return (0.0, 0.0)
    return float(time[beside]), float(time[len(time) - 1 - beside])


def _with_lengths(model: MuscleParameters, earlier: Sequence[OsimxMuscle]) -> MuscleParameters:
    """Put what an earlier step found in the place of what the model has."""
    columns = {name: np.array(getattr(model, name)) for name in _LENGTHS}
    for muscle in earlier:
        if muscle.name in model.names:
            row = model.names.index(muscle.name)
            for name in _LENGTHS:
                columns[name][row] = muscle.values.get(name, columns[name][row])
    return MuscleParameters(names=model.names, pennation_angle=model.pennation_angle, **columns)


def _mass(model_file: Path, problems: list[Problem]) -> float:
    total = 0.0
    for body in read_xml(model_file, "OpenSimDocument").iter("Body"):
        text = (body.findtext("mass") or "0").strip()
        try:
            total += float(text)
        except ValueError:
            place = f"body {body.get('name', '')}, <mass>"
            problems.append(Problem(str(model_file), f"expected a number, found '{text[:40]}'", place))
    return total


def _place(trial: Recorded, kind: str) -> str:
    return f"trials/{trial.name}/{kind}{trial.files[kind].suffix}"


def _parameter_table(muscles: MuscleParameters) -> str:
    lines = ["muscle,max_isometric_force_N,optimal_fiber_length_m,tendon_slack_length_m,pennation_rad"]
    rows = zip(*(getattr(muscles, name).tolist() for name in (*_LENGTHS, "pennation_angle")), strict=True)
    lines += [",".join((name, *map(repr, row))) for name, row in zip(muscles.names, rows, strict=True)]
    return "\n".join(lines) + "\n"


def _settings_text(project: Project, name: str) -> str:
    lines = [
        "# Taken over from a project of the NMSM Pipeline. All trials calibrate: say 'validation' of",
        "# some, and give their speeds (speed_m_s), to see how errors are on cycles that were not seen.",
        *(f"# {note}" for note in project.notes),
        "[subject]",
        f"name = {quoted(name)}",
        f"mass_kg = {project.mass_kg!r}",
        f'side = "{project.side}"',
        "",
        "[model]",
        'file = "model.osim"',
        *([] if project.muscles is None else ['muscle_parameters = "muscle_parameters.csv"']),
        f"coordinates = {quoted_list(project.settings.coordinates)}",
        "",
        "[emg]",
        'kind = "envelope"',
        "[emg.channels]",
        *_lists(project.channels),
        *(["[emg.extrapolated]", *_lists(project.extrapolated)] if project.extrapolated else []),
    ]
    for trial in project.trials:
        lines += ["", "[[trial]]", f"name = {quoted(trial.name)}", 'use = "calibration"']
        lines += [f"{kind} = {quoted(_place(trial, kind))}" for kind in FOLDERS]
        lines.append(f"cycle = [{trial.cycle[0]!r}, {trial.cycle[1]!r}]")
    return "\n".join(lines) + "\n"


def _lists(groups: dict[str, tuple[str, ...]]) -> list[str]:
    return [f"{quoted(name)} = {quoted_list(muscles)}" for name, muscles in groups.items()]


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
