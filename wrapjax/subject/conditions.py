"""Two conditions of one person in one subject: two folders, or two values of ``condition`` in one folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import content_hash
from wrapjax.subject.settings import SETTINGS_FILE, Settings, read_settings
from wrapjax.subject.subject import Subject, load_from_settings, settings_folder


def load_conditions(folder: str | Path, against: str | Path) -> tuple[Subject, tuple[str, str]]:
    """Read the trials of two conditions of one person as one subject.

    EMG is normalised by the same maxima, over both conditions. Everything else of the person is that of the
    first folder.

    Parameters
    ----------
    folder
        Subject folder of the first condition, or of both.
    against
        Subject folder of the second condition, with the same model, coordinates, channels and kind of EMG; or
        the condition, of two in the first folder, with which the other one is compared.

    Returns
    -------
    subject, names
        Subject whose trials have a condition each, and the names of the conditions: first the one that is
        compared, then the one that it is compared with.

    Raises
    ------
    InputError
        If a folder cannot be read, or the folders are not of one person, or have not two conditions.
    """
    place = settings_folder(folder)
    problems: list[Problem] = []
    settings = read_settings(place, problems)
    if problems:
        raise InputError(problems)
    if not _is_folder(against):
        return _of_one_folder(settings, place, str(against))
    other_place = settings_folder(against)
    other = read_settings(other_place, problems)
    if problems:
        raise InputError(problems)
    _check_same_person(settings, other)
    names = (place.resolve().name, other_place.resolve().name)
    if names[0] == names[1]:
        names = (f"{names[0]} (1)", f"{names[1]} (2)")
    trials = [replace(trial, condition=names[0]) for trial in settings.trials]
    taken = {trial.name.lower() for trial in trials}
    for trial in other.trials:
        name = trial.name if trial.name.lower() not in taken else f"{trial.name}-{names[1]}"
        trials.append(replace(trial, name=name.replace(" ", "_"), condition=names[1]))
    return load_from_settings(replace(settings, trials=tuple(trials)), place), names


def _is_folder(against: str | Path) -> bool:
    try:
        return Path(against).exists()
    except OSError:
        return False


def _of_one_folder(settings: Settings, folder: Path, against: str) -> tuple[Subject, tuple[str, str]]:
    file = str(folder / SETTINGS_FILE)
    known = tuple(dict.fromkeys(trial.condition for trial in settings.trials))
    if against not in known:
        message = f"expected a subject folder, or one of the conditions of this one, found '{against}'"
        hint = nearest_name(against, tuple(name for name in known if name))
        raise InputError(Problem(file, message, "--against", hint))
    if len(known) != 2:
        shown = ", ".join(f"'{name}'" for name in known)
        raise InputError(
            Problem(file, f"expected trials of two conditions, found {shown}", "[[trial]] condition")
        )
    first = next(name for name in known if name != against)
    subject = load_from_settings(settings, folder)
    names = (first or "no condition", against or "no condition")
    conditions = tuple(name or "no condition" for name in subject.trials.conditions)
    return replace(subject, trials=replace(subject.trials, conditions=conditions)), names


def _check_same_person(first: Settings, second: Settings) -> None:
    """Report what the settings of two conditions of one person must share and do not."""
    problems = []

    def compare(place: str, one: object, other: object) -> None:
        if one != other:
            message = f"expected {one}, as in {first.file}, found {other}"
            problems.append(Problem(str(second.file), message, place))

    compare("[subject] side", first.side, second.side)
    compare("[model] coordinates", first.coordinates, second.coordinates)
    compare("[emg] kind", first.emg_kind, second.emg_kind)
    compare("[emg.channels]", first.channels, second.channels)
    if not np.isclose(first.mass_kg, second.mass_kg, rtol=0.02):
        compare("[subject] mass_kg", first.mass_kg, second.mass_kg)
    models = [settings.model_file for settings in (first, second)]
    assert models[0] is not None and models[1] is not None
    if content_hash(models[0]) != content_hash(models[1]):
        message = f"expected the model {models[0]}, found another one: conditions share the person's model"
        problems.append(Problem(str(second.file), message, "[model] file"))
    if problems:
        raise InputError(problems)
