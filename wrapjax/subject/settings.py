"""Settings of a subject folder, ``subject.toml``: its allowed keys, their checks, and the values read.

A new key is read in the function of its table (`read_settings`, `read_trial`, `read_channels`,
`read_extrapolated`, `read_passive_settings`); a key that no function reads is reported as unknown.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.toml import TableReader, describe_value, read_toml
from wrapjax.subject.trial_settings import TrialSettings, read_trial

#: Name of the settings file in a subject folder.
SETTINGS_FILE = "subject.toml"


@dataclass(frozen=True)
class PassiveSettings:
    """Passive trial (table ``[[passive]]``).

    Parameters
    ----------
    name
        Name, unique among the passive trials.
    angles, moments
        Files (``.sto`` or ``.mot``) of joint angles and of the external moments that held or moved the
        joints.
    """

    name: str
    angles: Path
    moments: Path


@dataclass(frozen=True)
class Settings:
    """Content of ``subject.toml``. A field is empty if its key is invalid; a problem has been reported then.

    Parameters
    ----------
    name
        Name of the person.
    mass_kg
        Body mass, kg; NaN if missing or invalid.
    side
        Side of the leg, ``l`` or ``r``.
    paretic
        Whether the leg is paretic, None if unknown.
    other_leg
        Subject folder of the other leg, None if not given.
    model_file
        OpenSim model (``.osim``).
    coordinates
        Coordinates whose moments are predicted.
    muscle_parameters
        CSV file of muscle parameters, None if those of the model are used.
    joints
        Folder of ``wrapjax joints`` that the model came from, None if not given.
    emg_kind
        ``envelope`` or ``raw``.
    channels
        Muscles that each EMG channel drives, by channel.
    extrapolated
        Muscles without a channel that share an excitation, by name of the group; None if not given.
    maximal_contractions
        Raw EMG of maximal voluntary contractions, which normalises that of the trials; empty if not given.
    trials
        Trials, in the order of the file.
    passive
        Passive trials, in the order of the file.
    file
        The settings file.
    """

    name: str
    mass_kg: float
    side: str
    paretic: bool | None
    other_leg: Path | None
    model_file: Path | None
    coordinates: tuple[str, ...]
    muscle_parameters: Path | None
    joints: Path | None
    emg_kind: str
    channels: dict[str, tuple[str, ...]]
    extrapolated: dict[str, tuple[str, ...]] | None
    trials: tuple[TrialSettings, ...]
    passive: tuple[PassiveSettings, ...] = ()
    maximal_contractions: tuple[Path, ...] = ()
    file: Path = Path(SETTINGS_FILE)


def read_settings(folder: Path, problems: list[Problem]) -> Settings:
    """Read ``subject.toml`` of a folder and add all its faults to ``problems``.

    Raises
    ------
    InputError
        If the file does not exist or is not TOML.
    """
    file = folder / SETTINGS_FILE
    if not file.exists():
        hint = f"a subject folder holds a file {SETTINGS_FILE}"
        raise InputError(Problem(str(file), "does not exist", hint=hint))
    top = TableReader(read_toml(file), file, "", problems)

    subject = TableReader(top.table("subject"), file, "[subject]", problems)
    name = subject.text("name") or ""
    mass = subject.number("mass_kg", lowest=5.0, highest=400.0, unit="kg")
    side = subject.text("side", choices=("l", "r")) or ""
    paretic = subject.boolean("paretic")
    other_leg = _read_other_leg(subject, folder)
    subject.report_unknown_keys()

    model = TableReader(top.table("model"), file, "[model]", problems)
    model_file = model.path("file", folder)
    coordinates = model.names("coordinates") or ()
    muscle_parameters = model.path("muscle_parameters", folder, required=False)
    joints = model.path("joints", folder, required=False)
    model.report_unknown_keys()

    emg = TableReader(top.table("emg"), file, "[emg]", problems)
    emg_kind = emg.text("kind", choices=("envelope", "raw")) or ""
    channels = read_channels(emg.table("channels"), file, problems)
    extrapolated = read_extrapolated(emg.raw("extrapolated"), channels, file, problems)
    contractions = emg.paths("maximal_contractions", folder)
    if contractions and emg_kind == "envelope":
        emg.add_problem("maximal_contractions", "expected none of envelopes, which are normalised already")
    emg.report_unknown_keys()

    tables = top.tables("trial")
    trials = [
        read_trial(table, number, file, folder, problems) for number, table in enumerate(tables, start=1)
    ]
    _check_trials(trials, file, problems)
    passive = read_passive_settings(top.raw("passive"), file, folder, problems)
    top.report_unknown_keys()
    return Settings(
        name=name,
        mass_kg=math.nan if mass is None else mass,
        side=side,
        paretic=paretic,
        other_leg=other_leg,
        model_file=model_file,
        coordinates=coordinates,
        muscle_parameters=muscle_parameters,
        joints=joints,
        emg_kind=emg_kind,
        channels=channels,
        extrapolated=extrapolated,
        trials=tuple(trial for trial in trials if trial is not None),
        passive=passive,
        maximal_contractions=contractions,
        file=file,
    )


def _read_other_leg(subject: TableReader, folder: Path) -> Path | None:
    """Read the folder of the other leg, the only path that may lie outside the subject folder."""
    value = subject.text("other_leg", required=False)
    if value is None:
        return None
    path = folder / value
    settings = path if path.name == SETTINGS_FILE else path / SETTINGS_FILE
    try:
        exists = settings.is_file()
    except OSError:  # an impossible file name, such as one that is too long
        exists = False
    if not exists:
        subject.add_problem("other_leg", f"expected the folder of a subject, found no {settings}")
        return None
    return settings.parent


def _check_trials(trials: list[TrialSettings | None], file: Path, problems: list[Problem]) -> None:
    """Report duplicate names."""
    names = Counter(trial.name.lower() for trial in trials if trial is not None)
    for name, count in names.items():
        if count > 1:
            message = f"expected every trial to have a unique name, found {count} of this name"
            problems.append(Problem(str(file), message, f"[[trial]] '{name}'"))


def read_channels(table: object, file: Path, problems: list[Problem]) -> dict[str, tuple[str, ...]]:
    """Read ``[emg.channels]``: the muscles of each channel. A muscle can have one channel only."""
    reader = TableReader(table, file, "[emg.channels]", problems)
    channels = {}
    channel_of: dict[str, str] = {}
    for channel in table if isinstance(table, dict) else ():
        muscles = reader.names(channel)
        if muscles is None:
            continue
        channels[channel] = muscles
        for muscle in muscles:
            if muscle in channel_of:
                message = (
                    f"expected one channel for each muscle, found '{muscle}' driven by "
                    f"'{channel_of[muscle]}' already"
                )
                reader.add_problem(channel, message)
            channel_of.setdefault(muscle, channel)
    if not table and not reader.silent:
        reader.add_problem("", 'expected at least one channel, such as soleus = ["soleus_l"]')
    return channels


def read_extrapolated(
    table: object, channels: dict[str, tuple[str, ...]], file: Path, problems: list[Problem]
) -> dict[str, tuple[str, ...]] | None:
    """Read ``[emg.extrapolated]``: groups of muscles without a channel that share an excitation.

    A muscle can be in one group only, and not also have a channel. None if the table is missing.
    """
    if table is None:
        return None
    reader = TableReader(table, file, "[emg.extrapolated]", problems)
    groups = {}
    assigned = {muscle: f"channel '{channel}'" for channel, members in channels.items() for muscle in members}
    for name in table if isinstance(table, dict) else ():
        muscles = reader.names(name)
        if muscles is None:
            continue
        groups[name] = muscles
        for muscle in muscles:
            if muscle in assigned:
                reader.add_problem(
                    name,
                    f"expected muscles without excitation, found '{muscle}', which has {assigned[muscle]}",
                )
            assigned.setdefault(muscle, f"'{name}'")
    return groups


def read_passive_settings(
    tables: Any, file: Path, folder: Path, problems: list[Problem]
) -> tuple[PassiveSettings, ...]:
    """Read all tables ``[[passive]]``; invalid ones are reported and omitted."""
    if tables is None:
        return ()
    if not isinstance(tables, list):
        message = f"expected tables [[passive]], found {describe_value(tables)}"
        problems.append(Problem(str(file), message, "passive"))
        return ()
    trials = []
    for number, table in enumerate(tables, start=1):
        label = table.get("name") if isinstance(table, dict) else None
        place = (
            f"[[passive]] '{label}'" if isinstance(label, str) and label else f"[[passive]] number {number}"
        )
        reader = TableReader(table, file, place, problems)
        name = reader.text("name")
        angles, moments = (reader.path(key, folder) for key in ("angles", "moments"))
        reader.report_unknown_keys()
        if name is not None and angles is not None and moments is not None:
            trials.append(PassiveSettings(name, angles, moments))
    for name, count in Counter(trial.name for trial in trials).items():
        if count > 1:
            message = f"expected every trial to have a unique name, found {count} of this name"
            problems.append(Problem(str(file), message, f"[[passive]] '{name}'"))
    return tuple(trials)
