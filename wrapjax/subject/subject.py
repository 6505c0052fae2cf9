"""Reading of a complete subject folder, with all faults reported at once, and of both legs of a person."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.model_file import ModelFile, MuscleParameters, read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.io.toml import collect_problems
from wrapjax.subject.cycles import cut_cycles, noise_floor
from wrapjax.subject.emg_envelopes import sampling_rate
from wrapjax.subject.joint_spread import JointSpread, read_joint_spread
from wrapjax.subject.maximal_contractions import read_maxima
from wrapjax.subject.muscle_groups import activation_groups, fiber_length_groups
from wrapjax.subject.muscle_parameters import (
    check_channels,
    check_muscle_parameters,
    is_on_side,
    read_muscle_parameters,
)
from wrapjax.subject.passive_trials import PassiveTrial, as_passive_trial, read_passive_trial
from wrapjax.subject.recordings import read_signals
from wrapjax.subject.settings import SETTINGS_FILE, Settings, read_settings
from wrapjax.subject.synergies import Synergies
from wrapjax.subject.trial_checks import activity_notes
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import Trials

#: Largest accepted difference between the person's mass and that of the scaled model, as a share of the
#: latter.
MAX_MASS_DIFFERENCE = 0.10
#: Pounds in a kilogram.
POUNDS_PER_KG = 2.2046


@dataclass(frozen=True)
class Subject:
    """One leg of a person: model, muscles, recorded gait cycles and windows of other tasks.

    Parameters
    ----------
    name
        Name of the person.
    mass_kg
        Body mass, kg.
    side
        Side of the leg, ``l`` or ``r``.
    paretic
        Whether the leg is paretic, None if unknown.
    folder
        Subject folder.
    model_file
        OpenSim model (``.osim``).
    other_leg
        Subject folder of the other leg, None if there is none.
    muscles
        Parameters of the driven muscles: those with an EMG channel, channel by channel in the order of each
        list, then those driven by synergies.
    muscle_channels
        Position in ``trials.channels`` of the EMG channel of each muscle that has one.
    activation_groups
        Groups of two or more driven muscles whose delays and EMG scales are expected to be similar.
    fiber_length_groups
        Groups of two or more driven muscles of similar normalised fiber length.
    undriven_muscles
        Muscles of this leg that neither a channel nor a synergy drives.
    trials
        Gait cycles.
    recordings
        Settings of the recordings that the cycles were cut from, with their files.
    emg_rates
        Sampling rate of the EMG of each recording, Hz; NaN where none was recorded.
    notes
        Repairs and remarks for the user.
    undriven_parameters
        Parameters of `undriven_muscles`: from the table of muscle parameters where it has them, else from the
        model.
    extrapolated
        Groups of muscles without a channel that share an excitation by the settings, by name of the group;
        None if the settings give none.
    synergies
        Synergies that drive muscles without a channel; None if there are none.
    passive
        Passive trials for initial lengths: of tables ``[[passive]]``, and of task ``passive`` for
        calibration.
    joint_spread
        Standard deviations of the places of this leg's joints that were personalised from markers, by name
        of each coordinate of such a joint.
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
    joint_spread: Mapping[str, JointSpread] = field(default_factory=dict)

    @property
    def channel_of(self) -> dict[str, str]:
        """EMG channel of each muscle that has one, by the muscle's name."""
        channels = [self.trials.channels[index] for index in self.muscle_channels]
        return dict(zip(self.muscles.names, channels, strict=False))


def load_subject(path: str | Path) -> Subject:
    """Read and check a subject folder.

    Angles, moments and EMG of all trials are read, checked, and cut into gait cycles of 101 frames, or into
    windows of 1 s for other tasks. Raw EMG is filtered to envelopes and normalised to the maximum of each
    channel over all of them, or in maximal contractions where these are given.

    Parameters
    ----------
    path
        Subject folder, or the ``subject.toml`` in it.

    Returns
    -------
    Subject
        Subject in SI units and radians, with OpenSim's signs.

    Raises
    ------
    InputError
        With all faults of the folder; each states the file, the place, and what was expected and found.

    Examples
    --------
    >>> subject = wrapjax.load_subject("P07_left")  # doctest: +SKIP
    """
    folder = settings_folder(path)
    problems: list[Problem] = []
    settings = read_settings(folder, problems)
    return load_from_settings(settings, folder, problems)


def settings_folder(path: str | Path) -> Path:
    """Return the folder of a subject, given it or the ``subject.toml`` in it; an error if there is none."""
    path = Path(path)
    folder = path.parent if path.name == SETTINGS_FILE else path
    if not folder.is_dir():
        found = "is a file, where a folder was expected" if folder.exists() else "does not exist"
        raise InputError(
            Problem(str(folder), found, hint=f"a subject is a folder that holds a {SETTINGS_FILE}")
        )
    return folder


def load_from_settings(settings: Settings, folder: Path, known: Sequence[Problem] = ()) -> Subject:
    """Read and check the files that settings name; see `load_subject`.

    Parameters
    ----------
    settings
        Settings of a subject folder.
    folder
        Subject folder.
    known
        Problems of the settings, which are raised together with those of the files.
    """
    problems = list(known)
    notes: list[str] = []
    model = _read_model(settings, folder, problems)
    muscles, others = (None, None) if model is None else _read_muscles(settings, model, folder, problems)

    spread: dict[str, JointSpread] = {}
    if settings.joints is not None and model is not None:
        with collect_problems(problems):
            joints = read_joint_spread(settings.joints, [info.name for info in model.coordinates])
            spread = {name: entry for name, entry in joints.items() if is_on_side(name, settings.side)}
    read = functools.cache(read_storage)
    infos = () if model is None else model.coordinates
    signals = [read_signals(trial, settings, infos, read, problems, notes) for trial in settings.trials]
    read_all = [entry for entry in signals if entry is not None]
    passive = [read_passive_trial(trial, settings, infos, read, problems) for trial in settings.passive]
    maxima = read_maxima(tuple(settings.channels), settings.maximal_contractions, read, problems)
    if not problems:
        trials = cut_cycles(settings, read_all, problems, notes, maxima)
    if problems:
        # Each trial that uses a faulty file reports the same problem.
        raise InputError(dict.fromkeys(problems))
    assert model is not None and muscles is not None and settings.model_file is not None
    if "passive" in trials.tasks:
        notes += activity_notes(trials, noise_floor(trials.emg))
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
        emg_rates=tuple(
            math.nan if entry.emg_time is None else sampling_rate(entry.emg_time) for entry in read_all
        ),
        notes=tuple(dict.fromkeys(notes)),
        undriven_parameters=others,
        extrapolated=settings.extrapolated,
        joint_spread=spread,
        passive=(
            *(trial for trial in passive if trial is not None),
            *(
                as_passive_trial(entry, settings.coordinates)
                for entry in read_all
                if entry.trial.task == "passive" and entry.trial.use == "calibration"
            ),
        ),
    )


def _read_model(settings: Settings, folder: Path, problems: list[Problem]) -> ModelFile | None:
    """Read the model and check that it has the coordinates of the settings."""
    model = None
    with collect_problems(problems):
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
        elif not is_on_side(name, settings.side):
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
    """Read the parameters of the driven muscles, and of the other muscles of the leg.

    Parameters come from the table of muscle parameters if there is one, else from the model. Those of
    undriven muscles that the table lacks come from the model.
    """
    file = folder / SETTINGS_FILE
    driven = check_channels(settings.channels, model.muscles, settings.side, file, problems)
    if settings.extrapolated:
        check_channels(
            settings.extrapolated, model.muscles, settings.side, file, problems, "[emg.extrapolated]"
        )
    others = model.muscles.select(
        tuple(name for name in model.muscles.names if name not in driven and is_on_side(name, settings.side))
    )
    if settings.muscle_parameters is None:
        assert settings.model_file is not None
        return check_muscle_parameters(model.muscles, driven, settings.model_file, problems), others
    with collect_problems(problems):
        table = read_muscle_parameters(settings.muscle_parameters)
        for name in table.names:
            if name not in model.muscles.names:
                message = f"muscle '{name}' is not in the model"
                hint = nearest_name(name, model.muscles.names)
                problems.append(Problem(str(settings.muscle_parameters), message, hint=hint))
        # Undriven muscles that the table lacks keep the parameters of the model.
        listed = tuple(name for name in table.names if name in others.names)
        checked = check_muscle_parameters(table, (*driven, *listed), settings.muscle_parameters, problems)
        if checked is not None:
            return checked.select(driven), checked.extended_by(others).select(others.names)
    return None, others


_PLACE = "[subject] other_leg"


def name_without_side(name: str) -> str:
    """Remove the suffix of the side from a muscle's name: ``soleus_l`` and ``soleus_r`` become ``soleus``."""
    return re.sub(r"_[lr]$", "", name)


def read_legs(subject: Subject) -> tuple[Subject, ...]:
    """Return the legs that are calibrated together: the subject and, if its settings name one, its other leg.

    Parameters
    ----------
    subject
        Subject whose ``other_leg`` is read.

    Returns
    -------
    tuple of Subject
        One or two legs. The ``other_leg`` of the second is set to the first, even if its settings name none.

    Raises
    ------
    InputError
        With all faults of the other leg's folder, or if the two legs do not belong together.
    """
    if subject.other_leg is None:
        return (subject,)
    other = load_subject(subject.other_leg)
    file, other_file = (str(leg.folder / SETTINGS_FILE) for leg in (subject, other))
    problems = []
    if other.side == subject.side:
        message = f"expected the other leg, found one of the same side '{other.side}' in {other.folder}"
        problems.append(Problem(file, message, _PLACE))
    elif not _names_without_side(subject) & _names_without_side(other):
        message = f"no driven muscle of {other.folder} is driven here, so that the legs share no parameter"
        hint = "names of corresponding muscles differ in '_l' and '_r' only"
        problems.append(Problem(file, message, _PLACE, hint))
    if other.other_leg is not None and other.other_leg.resolve() != subject.folder.resolve():
        message = f"expected {subject.folder}, which names this folder, or no key; found {other.other_leg}"
        problems.append(Problem(other_file, message, _PLACE))
    if problems:
        raise InputError(problems)
    return subject, replace(other, other_leg=subject.folder)


def _names_without_side(subject: Subject) -> set[str]:
    return set(map(name_without_side, subject.muscles.names))


def mass_agrees_with_model(mass_kg: float, model_kg: float) -> bool:
    """Return whether the person's and the model's mass (kg) agree; true if the model's is NaN."""
    return not abs(mass_kg / model_kg - 1.0) > MAX_MASS_DIFFERENCE if model_kg > 0.0 else True


def mass_looks_like_pounds(mass_kg: float, model_kg: float) -> bool:
    """Return whether the person's mass, given as kg, is the model's mass in pounds."""
    return model_kg > 0.0 and abs(mass_kg / model_kg / POUNDS_PER_KG - 1.0) <= MAX_MASS_DIFFERENCE


def describe_masses(mass_kg: float, model_kg: float) -> str:
    """Describe both masses (kg) and their ratio in a clause."""
    ratio = mass_kg / model_kg
    return f"mass_kg is {mass_kg:.4g}, {ratio:.3g} times the {model_kg:.4g} kg of all bodies of the model"


def mass_notes(mass_kg: float, model_kg: float) -> tuple[str, ...]:
    """Note a person's mass that is implausible for the model.

    A model that is lighter than the person is accepted, as it may have a leg only, unless the ratio suggests
    pounds.

    Parameters
    ----------
    mass_kg
        Mass of the person, kg.
    model_kg
        Mass of all bodies of the model, kg; NaN if unknown.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    pounds = mass_looks_like_pounds(mass_kg, model_kg)
    if mass_agrees_with_model(mass_kg, model_kg) or (mass_kg > model_kg and not pounds):
        return ()
    question = "is it in lb?" if pounds else "is the model scaled to the person?"
    masses = describe_masses(mass_kg, model_kg)
    return (f"{masses}: {question} Forces in bodyweights are divided by mass_kg",)
