"""A subject folder, read whole: every problem in it is found before anything is calculated."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.subject.body_mass import mass_notes
from wrapjax.subject.cut import cut_trials
from wrapjax.subject.emg import sampling_rate
from wrapjax.subject.groups import activation_groups, fiber_length_groups
from wrapjax.subject.model_file import ModelFile, MuscleParameters, read_model_file
from wrapjax.subject.muscles import check_channels, check_muscle_parameters, of_side, read_muscle_parameters
from wrapjax.subject.passive import PassiveTrial, read_passive
from wrapjax.subject.recordings import read_signals
from wrapjax.subject.schema import collecting
from wrapjax.subject.settings import SETTINGS_FILE, Settings, TrialSettings, read_settings
from wrapjax.subject.storage import read_storage
from wrapjax.subject.synergies import Synergies
from wrapjax.subject.trials import Trials


@dataclass(frozen=True)
class Subject:
    """One leg of a person: model, muscles and recorded gait cycles.

    Parameters
    ----------
    name, mass_kg
        The person.
    side
        ``l`` or ``r``.
    paretic
        Whether the leg is, None if unknown.
    folder, model_file
        Where the subject was read from.
    other_leg
        Folder of the other leg's subject, None if there is none.
    muscles
        Muscles that an EMG channel drives: channel by channel, in the order of each list. Then those that
        synergies drive.
    muscle_channels
        Position in ``trials.channels`` of the channel that drives each muscle that one drives.
    activation_groups, fiber_length_groups
        Groups of two or more driven muscles.
    undriven_muscles
        Muscles of this leg's model that nothing drives.
    trials
        The gait cycles.
    recordings
        The trials as the settings give them, with their files.
    emg_rates
        Rate of each recording's EMG in Hz.
    notes
        What was repaired, or is worth knowing.
    undriven_parameters
        Of `undriven_muscles`: from the table of muscle parameters where that has them, else the model's.
    extrapolated
        Muscles without a channel that the settings give an excitation in common, by its name; None where
        they say nothing of that.
    synergies
        What drives muscles without a channel; None where nothing does.
    passive
        Recordings of the leg at rest.
    """

    name: str
    mass_kg: float
    side: str
    paretic: bool | None
    folder: Path
    model_file: Path
    other_leg: Path | None
    muscles: MuscleParameters
    muscle_channels: tuple[int, ...]
    activation_groups: tuple[tuple[str, ...], ...]
    fiber_length_groups: tuple[tuple[str, ...], ...]
    undriven_muscles: tuple[str, ...]
    trials: Trials
    recordings: tuple[TrialSettings, ...]
    emg_rates: tuple[float, ...]
    notes: tuple[str, ...]
    undriven_parameters: MuscleParameters | None = None
    extrapolated: dict[str, tuple[str, ...]] | None = None
    synergies: Synergies | None = None
    passive: tuple[PassiveTrial, ...] = ()

    @property
    def channel_of(self) -> dict[str, str]:
        """By muscle, the EMG channel that drives it; without those that none drives."""
        channels = [self.trials.channels[place] for place in self.muscle_channels]
        return dict(zip(self.muscles.names, channels, strict=False))


def read_subject(path: str | Path) -> Subject:
    """Read a subject folder (or its ``subject.toml``).

    Returns
    -------
    Subject
        In SI units and radians.

    Raises
    ------
    InputError
        With everything wrong in the folder, each problem naming file, place, what was expected and found.
    """
    path = Path(path)
    folder = path.parent if path.name == SETTINGS_FILE else path
    if not folder.is_dir():
        found = "is a file, where a folder was expected" if folder.exists() else "does not exist"
        raise InputError(
            Problem(str(folder), found, hint=f"a subject is a folder that holds a {SETTINGS_FILE}")
        )
    problems: list[Problem] = []
    notes: list[str] = []
    settings = read_settings(folder, problems)
    model = _read_model(settings, folder, problems)
    muscles, others = (None, None) if model is None else _read_muscles(settings, model, folder, problems)

    read = functools.cache(read_storage)
    infos = () if model is None else model.coordinates
    signals = [read_signals(trial, settings, infos, read, problems, notes) for trial in settings.trials]
    read_all = [entry for entry in signals if entry is not None]
    at_rest = [read_passive(trial, settings, infos, read, problems) for trial in settings.passive]
    if not problems:
        trials = cut_trials(settings, read_all, problems, notes)
    if problems:
        # Trials that share a file report the same problem each.
        raise InputError(dict.fromkeys(problems))
    assert model is not None and muscles is not None and settings.model_file is not None
    notes.extend(f"{folder / SETTINGS_FILE}: {note}" for note in mass_notes(settings.mass_kg, model.mass_kg))
    channel_of = {name: index for index, names in enumerate(settings.channels.values()) for name in names}
    return Subject(
        name=settings.name,
        mass_kg=settings.mass_kg,
        side=settings.side,
        paretic=settings.paretic,
        folder=folder,
        model_file=settings.model_file,
        other_leg=settings.other_leg,
        muscles=muscles,
        muscle_channels=tuple(channel_of[name] for name in muscles.names),
        activation_groups=activation_groups(model.groups, muscles.names, settings.side),
        fiber_length_groups=fiber_length_groups(model.groups, muscles.names, settings.side),
        undriven_muscles=() if others is None else others.names,
        trials=trials,
        recordings=settings.trials,
        emg_rates=tuple(sampling_rate(entry.emg_time) for entry in read_all),
        notes=tuple(dict.fromkeys(notes)),
        undriven_parameters=others,
        extrapolated=settings.extrapolated,
        passive=tuple(trial for trial in at_rest if trial is not None),
    )


def _read_model(settings: Settings, folder: Path, problems: list[Problem]) -> ModelFile | None:
    """Read the model and check the coordinates wanted from it."""
    model = None
    with collecting(problems):
        if settings.model_file is not None:
            model = read_model_file(settings.model_file)
    if model is None:
        return None
    infos = {info.name: info for info in model.coordinates}
    for name in settings.coordinates:
        file, place = str(folder / SETTINGS_FILE), "[model] coordinates"
        if name not in infos:
            message = f"coordinate '{name}' is not in the model"
            problems.append(Problem(file, message, place, nearest_name(name, tuple(infos))))
        elif not of_side(name, settings.side):
            problems.append(
                Problem(file, f"expected coordinates of side '{settings.side}', found '{name}'", place)
            )
        elif infos[name].motion_type == "translational":
            message = f"expected rotational coordinates, found '{name}', which is translational"
            problems.append(Problem(file, message, place))
    return model


def _read_muscles(
    settings: Settings, model: ModelFile, folder: Path, problems: list[Problem]
) -> tuple[MuscleParameters | None, MuscleParameters]:
    """Read the parameters of driven muscles and of the leg's others.

    They are from the table where there is one, else from the model; those of others from the model too
    where the table lacks them.
    """
    file = folder / SETTINGS_FILE
    driven = check_channels(settings.channels, model.muscles, settings.side, file, problems)
    if settings.extrapolated:
        named = settings.extrapolated
        check_channels(named, model.muscles, settings.side, file, problems, "[emg.extrapolated]")
    others = model.muscles.select(
        tuple(name for name in model.muscles.names if name not in driven and of_side(name, settings.side))
    )
    if settings.muscle_parameters is None:
        assert settings.model_file is not None
        return check_muscle_parameters(model.muscles, driven, settings.model_file, problems), others
    with collecting(problems):
        table = read_muscle_parameters(settings.muscle_parameters)
        for name in table.names:
            if name not in model.muscles.names:
                message = f"muscle '{name}' is not in the model"
                hint = nearest_name(name, model.muscles.names)
                problems.append(Problem(str(settings.muscle_parameters), message, hint=hint))
        # Of muscles that no channel drives only those that the table has: others are as in the model.
        listed = tuple(name for name in table.names if name in others.names)
        checked = check_muscle_parameters(table, (*driven, *listed), settings.muscle_parameters, problems)
        if checked is not None:
            return checked.select(driven), checked.followed_by(others).select(others.names)
    return None, others
