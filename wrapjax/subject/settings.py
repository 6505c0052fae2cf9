"""The settings of a subject, ``subject.toml``: what the folder holds and how to use it.

``[emg.channels]`` and ``[emg.extrapolated]`` of the settings: what excites which muscles.

``[[passive]]`` of the settings: recordings of a leg at rest.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.toml import TableReader, describe_value, read_toml


@dataclass(frozen=True)
class PassiveSettings:
    """One ``[[passive]]``: its name, unique among them, and its files."""

    name: str
    angles: Path
    moments: Path


def read_passive_settings(
    tables: Any, file: Path, folder: Path, problems: list[Problem]
) -> tuple[PassiveSettings, ...]:
    """Take all ``[[passive]]`` tables, without those that are unfit; none where there is none."""
    if tables is None:
        return ()
    if not isinstance(tables, list):
        message = f"expected tables [[passive]], found {describe_value(tables)}"
        problems.append(Problem(str(file), message, "passive"))
        return ()
    found = []
    for number, table in enumerate(tables, start=1):
        label = table.get("name") if isinstance(table, dict) else None
        place = (
            f"[[passive]] '{label}'" if isinstance(label, str) and label else f"[[passive]] number {number}"
        )
        reader = TableReader(table, file, place, problems)
        name = reader.text("name")
        angles, moments = (reader.path(key, folder) for key in ("angles", "moments"))
        reader.finish()
        if name is not None and angles is not None and moments is not None:
            found.append(PassiveSettings(name, angles, moments))
    for name, count in Counter(trial.name for trial in found).items():
        if count > 1:
            message = f"expected every trial to have a name of its own, found {count}"
            problems.append(Problem(str(file), message, f"[[passive]] '{name}'"))
    return tuple(found)


def read_channels(table: object, file: Path, problems: list[Problem]) -> dict[str, tuple[str, ...]]:
    """Take the muscles of each channel; a muscle can be driven by one channel only."""
    reader = TableReader(table, file, "[emg.channels]", problems)
    channels = {}
    drive_by_synergies: dict[str, str] = {}
    for channel in table if isinstance(table, dict) else ():
        muscles = reader.names(channel)
        if muscles is None:
            continue
        channels[channel] = muscles
        for muscle in muscles:
            if muscle in drive_by_synergies:
                message = f"expected one channel a muscle, found '{muscle}' driven by '{drive_by_synergies[muscle]}' already"
                reader.problem(channel, message)
            drive_by_synergies.setdefault(muscle, channel)
    if not table and not reader.silent:
        reader.problem("", 'expected at least one channel, such as soleus = ["soleus_l"]')
    return channels


def read_extrapolated(
    table: object, channels: dict[str, tuple[str, ...]], file: Path, problems: list[Problem]
) -> dict[str, tuple[str, ...]] | None:
    """Take the muscles of each excitation that nobody measured; a muscle has one, or a channel."""
    if table is None:
        return None
    reader = TableReader(table, file, "[emg.extrapolated]", problems)
    found = {}
    taken = {muscle: f"channel '{channel}'" for channel, own in channels.items() for muscle in own}
    for name in table if isinstance(table, dict) else ():
        muscles = reader.names(name)
        if muscles is None:
            continue
        found[name] = muscles
        for muscle in muscles:
            if muscle in taken:
                reader.problem(
                    name, f"expected muscles without excitation, found '{muscle}', which has {taken[muscle]}"
                )
            taken.setdefault(muscle, f"'{name}'")
    return found


SETTINGS_FILE = "subject.toml"
#: Trials name the files of results, so their names must be fit for that.
_TRIAL_NAME = re.compile(r"[\w.+-]+( [\w.+-]+)*")


@dataclass(frozen=True)
class TrialSettings:
    """One ``[[trial]]``: a recording and the gait cycles in it.

    Parameters
    ----------
    name
        Unique among the subject's trials.
    use
        ``calibration`` or ``validation``.
    angles, moments, emg
        Files.
    cycles
        Start and end of each gait cycle in s.
    speed
        Walking speed in m/s, NaN where not given.
    ground_forces, external_loads
        Files, None where not given.
    """

    name: str
    use: str
    angles: Path
    moments: Path
    emg: Path
    cycles: tuple[tuple[float, float], ...]
    speed: float = math.nan
    ground_forces: Path | None = None
    external_loads: Path | None = None

    @staticmethod
    def is_valid_name(name: str) -> bool:
        """Say whether a trial may be called so: its files are."""
        return bool(_TRIAL_NAME.fullmatch(name) and name.strip("."))


@dataclass(frozen=True)
class Settings:
    """All of ``subject.toml``. Where a key is unfit, its field is empty and a problem has been reported.

    Parameters
    ----------
    name, mass_kg, side, paretic, other_leg
        Of ``[subject]``; ``other_leg`` is that leg's folder.
    model_file, coordinates, muscle_parameters
        Of ``[model]``.
    emg_kind
        ``envelope`` or ``raw``.
    channels
        The muscles that each EMG channel drives.
    extrapolated
        Muscles without a channel that have an excitation in common, by a name for it; None where that is
        not said.
    trials
        In the order of the file.
    passive
        Recordings of the leg at rest, in the order of the file.
    """

    name: str
    mass_kg: float
    side: str
    paretic: bool | None
    other_leg: Path | None
    model_file: Path | None
    coordinates: tuple[str, ...]
    muscle_parameters: Path | None
    emg_kind: str
    channels: dict[str, tuple[str, ...]]
    extrapolated: dict[str, tuple[str, ...]] | None
    trials: tuple[TrialSettings, ...]
    passive: tuple[PassiveSettings, ...] = ()


def read_settings(folder: Path, problems: list[Problem]) -> Settings:
    """Read ``subject.toml`` of a folder, adding everything wrong in it to ``problems``.

    Raises
    ------
    InputError
        If there is no such file or it is not TOML, so that nothing can be read at all.
    """
    file = folder / SETTINGS_FILE
    if not file.exists():
        hint = f"a subject is a folder that holds a {SETTINGS_FILE}"
        raise InputError(Problem(str(file), "does not exist", hint=hint))
    top = TableReader(read_toml(file), file, "", problems)

    subject = TableReader(top.table("subject"), file, "[subject]", problems)
    name = subject.text("name") or ""
    mass = subject.number("mass_kg", lowest=5.0, highest=400.0, unit="kg")
    side = subject.text("side", choices=("l", "r")) or ""
    paretic = subject.boolean("paretic")
    other_leg = _other_leg(subject, folder)
    subject.finish()

    model = TableReader(top.table("model"), file, "[model]", problems)
    model_file = model.path("file", folder)
    coordinates = model.names("coordinates") or ()
    muscle_parameters = model.path("muscle_parameters", folder, required=False)
    model.finish()

    emg = TableReader(top.table("emg"), file, "[emg]", problems)
    emg_kind = emg.text("kind", choices=("envelope", "raw")) or ""
    channels = read_channels(emg.table("channels"), file, problems)
    extrapolated = read_extrapolated(emg.raw("extrapolated"), channels, file, problems)
    emg.finish()

    tables = top.tables("trial")
    trials = [_trial(table, number, file, folder, problems) for number, table in enumerate(tables, start=1)]
    _check_trials(trials, tables, file, problems)
    passive = read_passive_settings(top.raw("passive"), file, folder, problems)
    top.finish()
    return Settings(
        name=name,
        mass_kg=math.nan if mass is None else mass,
        side=side,
        paretic=paretic,
        other_leg=other_leg,
        model_file=model_file,
        coordinates=coordinates,
        muscle_parameters=muscle_parameters,
        emg_kind=emg_kind,
        channels=channels,
        extrapolated=extrapolated,
        trials=tuple(trial for trial in trials if trial is not None),
        passive=passive,
    )


def _other_leg(subject: TableReader, folder: Path) -> Path | None:
    """Take the folder of the other leg, the only path that may lie outside the subject's folder."""
    value = subject.text("other_leg", required=False)
    if value is None:
        return None
    path = folder / value
    settings = path if path.name == SETTINGS_FILE else path / SETTINGS_FILE
    try:
        there = settings.is_file()
    except OSError:  # a name that no file can have
        there = False
    if not there:
        subject.problem("other_leg", f"expected the folder of a subject, found no {settings}")
        return None
    return settings.parent


def _trial(
    table: object, number: int, file: Path, folder: Path, problems: list[Problem]
) -> TrialSettings | None:
    """Take one ``[[trial]]``, None where a part that nothing works without is unfit."""
    label = table.get("name") if isinstance(table, dict) else None
    place = f"[[trial]] '{label}'" if isinstance(label, str) and label else f"[[trial]] number {number}"
    reader = TableReader(table, file, place, problems)
    name = reader.text("name")
    if name is not None and not TrialSettings.is_valid_name(name):
        reader.problem("name", f"expected letters, digits, '_', '-', '+' and '.', found '{name}'")
        name = None
    use = reader.text("use", choices=("calibration", "validation"))
    paths = [reader.path(key, folder) for key in ("angles", "moments", "emg")]
    extra = [reader.path(key, folder, required=False) for key in ("ground_forces", "external_loads")]
    speed = reader.number("speed_m_s", lowest=0.0, highest=15.0, unit="m/s", required=False)
    cycles = read_cycles(reader)
    reader.finish()
    angles, moments, emg = paths
    if name is None or use is None or angles is None or moments is None or emg is None:
        return None
    return TrialSettings(
        name=name,
        use=use,
        angles=angles,
        moments=moments,
        emg=emg,
        cycles=cycles,
        speed=math.nan if speed is None else speed,
        ground_forces=extra[0],
        external_loads=extra[1],
    )


def read_cycles(reader: TableReader) -> tuple[tuple[float, float], ...]:
    """Take ``cycle = [t0, t1]`` or ``cycles = [[t0, t1], ...]``, without those that are unfit."""
    if reader.has("cycle") == reader.has("cycles"):
        found = "both" if reader.has("cycle") else "neither"
        reader.problem(
            "cycle", f"expected either cycle = [t0, t1] or cycles = [[t0, t1], ...], found {found}"
        )
    single, several = reader.raw("cycle"), reader.raw("cycles")
    if single is not None and several is not None:
        return ()
    key = "cycles" if several is not None else "cycle"
    listed = several if several is not None else [single]
    if not isinstance(listed, list) or not listed:
        reader.problem(key, f"expected [[t0, t1], ...], found {describe_value(listed)}")
        return ()
    cycles = []
    for order, entry in enumerate(listed, start=1):
        place = f"{key} {order}" if several is not None else key
        if entry is None:
            continue
        if not (isinstance(entry, list) and len(entry) == 2 and all(map(_is_time, entry))):
            reader.problem(place, f"expected [t0, t1] in s, found {describe_value(entry)}")
        elif entry[0] >= entry[1]:
            reader.problem(place, f"expected t0 before t1, found [{entry[0]:g}, {entry[1]:g}]")
        else:
            cycles.append((float(entry[0]), float(entry[1])))
    return tuple(cycles)


def _is_time(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # whole numbers may be of any size
        return False


def _check_trials(
    trials: list[TrialSettings | None], tables: list, file: Path, problems: list[Problem]
) -> None:
    """Report names used twice, and that nothing is there to calibrate with."""
    names = Counter(trial.name.lower() for trial in trials if trial is not None)
    for name, count in names.items():
        if count > 1:
            message = f"expected every trial to have a name of its own, found {count}"
            problems.append(Problem(str(file), message, f"[[trial]] '{name}'"))
    uses = {
        table.get("use") for table in tables if isinstance(table, dict) and isinstance(table.get("use"), str)
    }
    # An unfit use has been reported already, and may have been meant as calibration.
    if tables and uses and uses <= {"validation"}:
        message = 'expected at least one trial with use = "calibration", found none'
        problems.append(Problem(str(file), message, "[[trial]] use"))
