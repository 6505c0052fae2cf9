"""All recordings of a subject, cut into cycles on one common grid."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem
from wrapjax.subject.cycles import (
    PADDING_SECONDS,
    TIME_TOLERANCE,
    cycle_times,
    padding_frames,
    resample,
)
from wrapjax.subject.emg import envelopes_of_raw, even_samples, normalise
from wrapjax.subject.recordings import Signals
from wrapjax.subject.settings import Settings
from wrapjax.subject.trials import Trials


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
