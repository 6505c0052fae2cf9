"""Conversion of a project of the NMSM Pipeline into a subject folder."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text
from wrapjax.io.model_file import ModelFile, MuscleParameters, read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.io.toml import toml_list, toml_string
from wrapjax.io.xml import read_xml
from wrapjax.preprocessing.nmsm.files import OsimxMuscle, ToolSettings, read_osimx, read_tool_settings
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.trials import FRAMES

#: Folders of a project's data, by kind of signal.
FOLDERS = {"angles": "IKData", "moments": "IDData", "emg": "EMGData"}
_SUFFIXES = (".sto", ".mot")
_LENGTHS = ("max_isometric_force", "optimal_fiber_length", "tendon_slack_length")


@dataclass(frozen=True)
class ProjectTrial:
    """Trial of a project: one gait cycle.

    Parameters
    ----------
    name
        Name of the trial.
    files
        Files of ``angles``, ``moments`` and ``emg``.
    cycle
        Start and end of the gait cycle in s, without the additional frames before and after it.
    """

    name: str
    files: dict[str, Path]
    cycle: tuple[float, float]


@dataclass(frozen=True)
class Project:
    """Content of a project for one leg.

    Parameters
    ----------
    settings
        Settings of muscle-tendon personalisation.
    side
        Side of the leg, ``l`` or ``r``.
    mass_kg
        Mass of all bodies of the model, kg.
    channels
        Muscles of this leg that each EMG channel drives.
    extrapolated
        Muscles of this leg in each group without an EMG channel, which share an excitation.
    trials
        Gait cycles.
    muscles
        Muscle parameters if the project has an ``.osimx`` file; None if those of the model are used.
    notes
        Parts of the project that are not converted, and remarks.
    """

    settings: ToolSettings
    side: str
    mass_kg: float
    channels: dict[str, tuple[str, ...]]
    extrapolated: dict[str, tuple[str, ...]]
    trials: tuple[ProjectTrial, ...]
    muscles: MuscleParameters | None
    notes: tuple[str, ...]


def read_project(path: str | Path) -> Project:
    """Read a project from its settings of muscle-tendon personalisation (``.xml``).

    Raises
    ------
    InputError
        With all faults of the project.
    """
    settings = read_tool_settings(path)
    model = read_model_file(settings.model_file)
    problems: list[Problem] = []
    side = _find_side(settings, problems)
    channels = _read_channels(settings, model, side, problems)
    trials = _find_trials(settings, problems)
    notes: list[str] = []
    extrapolated = _read_extrapolated(settings, model, side, channels, problems, notes)
    muscles = None
    if settings.osimx_file is not None:
        earlier = read_osimx(settings.osimx_file)
        muscles = _replace_lengths(model.muscles, earlier)
        if any(set(muscle.values) - set(_LENGTHS) for muscle in earlier):
            notes.append(
                f"{settings.osimx_file.name}: lengths and forces are used; delays, time constants and EMG "
                "scales are calibrated anew"
            )
    if settings.passive:
        notes.append(
            f"passive trials ('{settings.passive}') are not converted; if their angles and moments are "
            "known, list both as [[passive]] for 'wrapjax initialise'"
        )
    mass = _mass(settings.model_file, problems)
    if problems:
        raise InputError(problems)
    return Project(settings, side, mass, channels, extrapolated, trials, muscles, tuple(notes))


def write_project_as_subject(project: Project, folder: Path, name: str) -> None:
    """Write a project as a subject of this name into an empty folder; its files are copied unchanged."""
    shutil.copyfile(project.settings.model_file, folder / "model.osim")
    if project.muscles is not None:
        write_text(folder / "muscle_parameters.csv", _parameter_table(project.muscles))
    for trial in project.trials:
        (folder / "trials" / trial.name).mkdir(parents=True)
        for kind, file in trial.files.items():
            shutil.copyfile(file, folder / _trial_file(trial, kind))
    write_text(folder / SETTINGS_FILE, _settings_text(project, name))


def _find_side(settings: ToolSettings, problems: list[Problem]) -> str:
    sides = {coordinate[-2:] for coordinate in settings.coordinates}
    if sides in ({"_l"}, {"_r"}):
        return sides.pop()[1:]
    listed = ", ".join(settings.coordinates)
    problems.append(
        Problem(
            str(settings.file),
            f"expected coordinates of one leg, which end in _l or in _r, found {listed}",
            "<coordinate_list>",
            "a subject is one leg: use separate settings for each leg",
        )
    )
    return ""


def _read_channels(
    settings: ToolSettings, model: ModelFile, side: str, problems: list[Problem]
) -> dict[str, tuple[str, ...]]:
    tag = "collected_emg_channel_muscle_groups"
    before = len(problems)
    channels = _groups_of_leg(settings.collected, tag, settings, model, side, problems)
    if settings.collected and not channels and len(problems) == before:
        message = f"expected a group with muscles that end in _{side}, found none"
        problems.append(Problem(str(settings.file), message, f"<{tag}>"))
    return channels


def _read_extrapolated(
    settings: ToolSettings,
    model: ModelFile,
    side: str,
    channels: dict[str, tuple[str, ...]],
    problems: list[Problem],
    notes: list[str],
) -> dict[str, tuple[str, ...]]:
    """Find the groups without EMG, omit muscles that have another excitation, and note how to drive them."""
    assigned = {muscle for members in channels.values() for muscle in members}
    extrapolated = {}
    tag = "missing_emg_channel_muscle_groups"
    for group, muscles in _groups_of_leg(settings.missing, tag, settings, model, side, problems).items():
        duplicates = [muscle for muscle in muscles if muscle in assigned]
        if duplicates:
            notes.append(f"group {group}: without {', '.join(duplicates)}, which another group has already")
        members = tuple(muscle for muscle in muscles if muscle not in assigned)
        if members:
            extrapolated[group] = members
            assigned.update(members)
    if extrapolated:
        notes.append(
            f"no EMG: the groups {', '.join(extrapolated)}, written as [emg.extrapolated]; with 'wrapjax "
            "calibrate --undriven synergies' each is excited by synergies of the measured EMG, and without "
            "that option they are not driven"
        )
    return extrapolated


def _groups_of_leg(
    groups: Sequence[str],
    tag: str,
    settings: ToolSettings,
    model: ModelFile,
    side: str,
    problems: list[Problem],
) -> dict[str, tuple[str, ...]]:
    """Find the muscles of this leg in each group of the model; groups without any are omitted."""
    members = {}
    for group in groups:
        if group not in model.groups:
            message = f"names the group '{group}', which {settings.model_file.name} does not have"
            hint = nearest_name(group, list(model.groups))
            problems.append(Problem(str(settings.file), message, f"<{tag}>", hint))
            continue
        muscles = tuple(
            name for name in model.groups[group] if name in model.muscles.names and name.endswith(f"_{side}")
        )
        if muscles:
            members[group] = muscles
    return members


def _find_trials(settings: ToolSettings, problems: list[Problem]) -> tuple[ProjectTrial, ...]:
    angles = settings.data_directory / FOLDERS["angles"]
    files = _list_tables(angles)
    if not files:
        problems.append(Problem(str(angles), "expected a .sto or .mot file for each trial, found none"))
    trials = []
    prefixes = settings.prefixes or tuple(file.stem.removesuffix("_ik") for file in files)
    selected = [file for file in files if file.stem.startswith(prefixes)] if prefixes else []
    if files and not selected:
        listed = ", ".join(settings.prefixes)
        problems.append(Problem(str(angles), f"expected files that begin with {listed}, found none"))
    for file in selected:
        name = file.stem.removesuffix("_ik")
        trial_files = {"angles": file}
        for kind in ("moments", "emg"):
            folder = settings.data_directory / FOLDERS[kind]
            match = [other for other in _list_tables(folder) if _same_trial(other.stem, name)]
            if not match:
                problems.append(Problem(str(folder), f"expected a file of the trial '{name}', found none"))
                continue
            trial_files[kind] = match[0]
        trials.append(ProjectTrial(name, trial_files, _find_cycle(file, problems)))
    return tuple(trials)


def _list_tables(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES)


def _same_trial(stem: str, trial: str) -> bool:
    return stem in (trial, *(f"{trial}_{kind}" for kind in ("id", "emg")))


def _find_cycle(file: Path, problems: list[Problem]) -> tuple[float, float]:
    """Find the `FRAMES` frames of the cycle, with equally many additional frames before and after it."""
    time = read_storage(file).time
    additional, odd = divmod(len(time) - FRAMES, 2)
    if additional < 0 or odd:
        message = f"expected {FRAMES} frames, and as many before as after them, found {len(time)}"
        problems.append(Problem(str(file), message))
        return (0.0, 0.0)
    return float(time[additional]), float(time[len(time) - 1 - additional])


def _replace_lengths(model: MuscleParameters, earlier: Sequence[OsimxMuscle]) -> MuscleParameters:
    """Replace parameters of the model by those of an earlier step."""
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


def _trial_file(trial: ProjectTrial, kind: str) -> str:
    return f"trials/{trial.name}/{kind}{trial.files[kind].suffix}"


def _parameter_table(muscles: MuscleParameters) -> str:
    lines = ["muscle,max_isometric_force_N,optimal_fiber_length_m,tendon_slack_length_m,pennation_rad"]
    rows = zip(*(getattr(muscles, name).tolist() for name in (*_LENGTHS, "pennation_angle")), strict=True)
    lines += [",".join((name, *map(repr, row))) for name, row in zip(muscles.names, rows, strict=True)]
    return "\n".join(lines) + "\n"


def _settings_text(project: Project, name: str) -> str:
    lines = [
        "# Converted from a project of the NMSM Pipeline. All trials are for calibration: set use to",
        "# 'validation' for some, and give their speeds (speed_m_s), to evaluate errors on held-out cycles.",
        *(f"# {note}" for note in project.notes),
        "[subject]",
        f"name = {toml_string(name)}",
        f"mass_kg = {project.mass_kg!r}",
        f'side = "{project.side}"',
        "",
        "[model]",
        'file = "model.osim"',
        *([] if project.muscles is None else ['muscle_parameters = "muscle_parameters.csv"']),
        f"coordinates = {toml_list(project.settings.coordinates)}",
        "",
        "[emg]",
        'kind = "envelope"',
        "[emg.channels]",
        *_format_lists(project.channels),
        *(["[emg.extrapolated]", *_format_lists(project.extrapolated)] if project.extrapolated else []),
    ]
    for trial in project.trials:
        lines += ["", "[[trial]]", f"name = {toml_string(trial.name)}", 'use = "calibration"']
        lines += [f"{kind} = {toml_string(_trial_file(trial, kind))}" for kind in FOLDERS]
        lines.append(f"cycle = [{trial.cycle[0]!r}, {trial.cycle[1]!r}]")
    return "\n".join(lines) + "\n"


def _format_lists(groups: dict[str, tuple[str, ...]]) -> list[str]:
    return [f"{toml_string(name)} = {toml_list(muscles)}" for name, muscles in groups.items()]
