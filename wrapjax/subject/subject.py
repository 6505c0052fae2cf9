"""A subject folder, read whole: every problem in it is found before anything is calculated.

All recordings of a subject, cut into cycles on one common grid.

Does the mass that settings give agree with the model? Forces in bodyweights are divided by it.

Both legs of a person: the folders of two subjects that belong together.
"""

from __future__ import annotations

import functools
import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.model_file import ModelFile, MuscleParameters, read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.io.toml import collecting
from wrapjax.subject.emg import envelopes_of_raw, even_samples, normalise, sampling_rate
from wrapjax.subject.muscles import (
    activation_groups,
    check_channels,
    check_muscle_parameters,
    fiber_length_groups,
    of_side,
    read_muscle_parameters,
)
from wrapjax.subject.passive import PassiveTrial, read_passive
from wrapjax.subject.recordings import Signals, read_signals
from wrapjax.subject.settings import SETTINGS_FILE, Settings, TrialSettings, read_settings
from wrapjax.subject.synergies import Synergies
from wrapjax.subject.trials import (
    PADDING_SECONDS,
    TIME_TOLERANCE,
    Trials,
    cycle_times,
    padding_frames,
    resample,
)


def cut_trials(
    settings: Settings, signals: list[Signals], problems: list[Problem], notes: list[str]
) -> Trials:
    """Cut all recordings into cycles and normalise raw EMG over all of them.

    Parameters
    ----------
    settings
        The subject's settings.
    signals
        Those of every trial, checked.
    problems, notes
        Lists to add to: what was held, clipped or never active.

    Returns
    -------
    Trials
        In the order of the settings.
    """
    cycles = [cycle for entry in signals for cycle in entry.trial.cycles]
    padding = padding_frames(cycles)
    shared = tuple(
        name for name in signals[0].coordinates if all(name in entry.coordinates for entry in signals)
    )
    angles, rates, moments, emg = [], [], [], []
    for entry in signals:
        times = cycle_times(list(entry.trial.cycles))
        rows = [entry.coordinates.index(name) for name in shared]
        own_angles, own_rates = resample(entry.angle_time, entry.angles[rows], times)
        angles.append(own_angles)
        rates.append(own_rates)
        moments.append(resample(entry.moment_time, entry.moments, times)[0])
        emg.append(_cut_emg(entry, settings, padding, notes))
    _note_overlaps(signals, notes)
    return Trials(
        names=tuple(name for entry in signals for name in _cycle_names(entry)),
        recordings=tuple(entry.trial.name for entry in signals for _ in entry.trial.cycles),
        uses=tuple(entry.trial.use for entry in signals for _ in entry.trial.cycles),
        speeds=np.array([entry.trial.speed for entry in signals for _ in entry.trial.cycles]),
        coordinates=shared,
        moment_coordinates=settings.coordinates,
        channels=tuple(settings.channels),
        time=cycle_times(cycles),
        angles=np.concatenate(angles),
        angular_velocities=np.concatenate(rates),
        moments=np.concatenate(moments),
        emg_time=cycle_times(cycles, padding),
        emg=_scale(np.concatenate(emg), settings, problems, notes),
    )


def _cycle_names(entry: Signals) -> list[str]:
    """Name the cycles of a recording: ``walk``, or ``walk/01``, ``walk/02`` where there are several."""
    count = len(entry.trial.cycles)
    if count == 1:
        return [entry.trial.name]
    digits = max(2, len(str(count)))
    return [f"{entry.trial.name}/{order:0{digits}d}" for order in range(1, count + 1)]


def _cut_emg(
    entry: Signals, settings: Settings, padding: int, notes: list[str]
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Cut the EMG of one recording: envelopes, not negative, those of raw EMG not yet normalised."""
    cycles = list(entry.trial.cycles)
    time, emg = entry.emg_time, entry.emg
    if settings.emg_kind == "raw":
        time, emg = even_samples(time, emg)
        gait_period = float(np.median([end - start for start, end in cycles]))
        emg = envelopes_of_raw(emg, (time.size - 1) / (time[-1] - time[0]), gait_period)
    elif emg.min() < 0.0:
        low = [channel for channel, signal in zip(settings.channels, emg, strict=True) if signal.min() < 0.0]
        clipped = f"negative values, down to {emg.min():.3g}, were set to 0 in {', '.join(low)}"
        notes.append(f"{entry.trial.emg}: {clipped}")
    wanted = cycle_times(cycles, padding)
    limits = np.array(cycles)
    missing = PADDING_SECONDS + np.maximum(time[0] - limits[:, 0], limits[:, 1] - time[-1])
    if missing.max() > TIME_TOLERANCE:
        count = int((missing > TIME_TOLERANCE).sum())
        notes.append(
            f"trial '{entry.trial.name}': less than {PADDING_SECONDS:g} s of EMG before or after {count} of "
            f"{len(cycles)} cycles (up to {missing.max():.3g} s missing); the edge value is held"
        )
    # Negative samples, and the spline's undershoot between samples.
    return np.maximum(resample(time, emg, wanted)[0], 0.0)


def _scale(
    emg: Float[np.ndarray, "trial channel padded_frame"],
    settings: Settings,
    problems: list[Problem],
    notes: list[str],
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Normalise raw EMG; take envelopes as they are."""
    peaks = emg.max(axis=(0, 2))
    silent = [channel for channel, peak in zip(settings.channels, peaks, strict=True) if peak <= 0.0]
    if settings.emg_kind == "envelope":
        notes.extend(f"channel '{channel}' is zero in every cycle" for channel in silent)
        return emg
    for channel in silent:
        files = ", ".join(dict.fromkeys(str(trial.emg) for trial in settings.trials))
        problems.append(Problem(files, "expected EMG, found none in any cycle", f"column {channel}"))
    return emg if silent else normalise(emg)


def _note_overlaps(signals: list[Signals], notes: list[str]) -> None:
    """Note validation cycles that share samples with calibration cycles: they validate nothing."""
    for one, other in itertools.combinations([entry.trial for entry in signals], 2):
        if one.angles != other.angles or one.use == other.use:
            continue
        shared = sum(
            min(first[1], second[1]) - max(first[0], second[0]) > TIME_TOLERANCE
            for first in one.cycles
            for second in other.cycles
        )
        if shared:
            notes.append(
                f"trials '{one.name}' and '{other.name}', one for calibration and one for validation, "
                f"overlap in {shared} pairs of cycles"
            )


#: By how much the person's mass may differ from that of a model scaled to them, as a share of the latter.
MOST_MASS_ERROR = 0.10
#: Pounds in a kilogram.
POUNDS = 2.2046


def agrees_with_model(mass_kg: float, model_kg: float) -> bool:
    """Say whether a person's mass is that of a scaled model's bodies, both in kg; NaN agrees with all."""
    return not abs(mass_kg / model_kg - 1.0) > MOST_MASS_ERROR if model_kg > 0.0 else True


def looks_like_pounds(mass_kg: float, model_kg: float) -> bool:
    """Say whether what is given as kg is what the model's bodies (kg) are in pounds."""
    return model_kg > 0.0 and abs(mass_kg / model_kg / POUNDS - 1.0) <= MOST_MASS_ERROR


def mass_beside_model(mass_kg: float, model_kg: float) -> str:
    """Tell both masses, kg, and how they compare."""
    times = mass_kg / model_kg
    return f"mass_kg is {mass_kg:.4g}, {times:.3g} times the {model_kg:.4g} kg of all bodies of the model"


def mass_notes(mass_kg: float, model_kg: float) -> tuple[str, ...]:
    """Note a mass that is no person's with this model, though bodies may be left out of the model.

    Parameters
    ----------
    mass_kg
        Of the person.
    model_kg
        Of all bodies of the model, which may be a leg alone: too little of it says nothing, unless it is
        what pounds would look like. NaN where unknown.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    pounds = looks_like_pounds(mass_kg, model_kg)
    if agrees_with_model(mass_kg, model_kg) or (mass_kg > model_kg and not pounds):
        return ()
    asked = "is it in lb?" if pounds else "is the model scaled to the person?"
    beside = mass_beside_model(mass_kg, model_kg)
    return (f"{beside}: {asked} Forces in bodyweights are divided by mass_kg",)


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


def load_subject(path: str | Path) -> Subject:
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


_PLACE = "[subject] other_leg"


def name_without_side(name: str) -> str:
    """Name a muscle as both legs do: ``soleus_l`` and ``soleus_r`` are ``soleus``."""
    return re.sub(r"_[lr]$", "", name)


def read_legs(subject: Subject) -> tuple[Subject, ...]:
    """Gather the legs that are calibrated together: the subject, and its other leg if it names one.

    Returns
    -------
    tuple of Subject
        One, or two that name each other, whether or not the other leg's folder points back.

    Raises
    ------
    InputError
        With everything wrong in the other leg's folder, or between the two.
    """
    if subject.other_leg is None:
        return (subject,)
    other = load_subject(subject.other_leg)
    file, other_file = (str(leg.folder / SETTINGS_FILE) for leg in (subject, other))
    problems = []
    if other.side == subject.side:
        message = f"expected the other leg, found one of the same side '{other.side}' in {other.folder}"
        problems.append(Problem(file, message, _PLACE))
    elif not _shared(subject) & _shared(other):
        message = f"no driven muscle of {other.folder} has a namesake here: the legs would share nothing"
        problems.append(Problem(file, message, _PLACE, "namesakes differ in '_l' and '_r' only"))
    if other.other_leg is not None and other.other_leg.resolve() != subject.folder.resolve():
        message = f"expected {subject.folder}, whose other leg this is, or nothing; found {other.other_leg}"
        problems.append(Problem(other_file, message, _PLACE))
    if problems:
        raise InputError(problems)
    return subject, replace(other, other_leg=subject.folder)


def _shared(subject: Subject) -> set[str]:
    return set(map(name_without_side, subject.muscles.names))
