"""Cutting of recordings into gait cycles on a common time grid, with EMG filtered, padded and normalised."""

from __future__ import annotations

import itertools
import math

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import Problem
from wrapjax.subject.emg_envelopes import compute_envelopes, normalise, resample_evenly
from wrapjax.subject.recordings import Signals
from wrapjax.subject.settings import Settings
from wrapjax.subject.trials import FRAMES, TIME_TOLERANCE, Trials

#: EMG kept before and after each cycle, s, so that it can be shifted by the electromechanical delay.
PADDING_SECONDS = 0.2
#: The number of padding frames is a multiple of this, so that subjects of different walking speeds use the
#: same compiled code.
PADDING_STEP = 10


def cut_cycles(
    settings: Settings, signals: list[Signals], problems: list[Problem], notes: list[str]
) -> Trials:
    """Cut all recordings into cycles and normalise raw EMG over all of them.

    Parameters
    ----------
    settings
        Settings of the subject.
    signals
        Checked signals of all recordings.
    problems
        List to which a problem is added for each raw EMG channel without a signal.
    notes
        List to which held edge values, clipped samples, channels without a signal and overlapping cycles are
        added.

    Returns
    -------
    Trials
        All gait cycles, in the order of the settings.
    """
    cycles = [cycle for entry in signals for cycle in entry.trial.cycles]
    padding = padding_frames(cycles)
    shared = tuple(
        name for name in signals[0].coordinates if all(name in entry.coordinates for entry in signals)
    )
    angles, velocities, moments, emg = [], [], [], []
    for entry in signals:
        times = cycle_times(list(entry.trial.cycles))
        rows = [entry.coordinates.index(name) for name in shared]
        cycle_angles, cycle_velocities = resample(entry.angle_time, entry.angles[rows], times)
        angles.append(cycle_angles)
        velocities.append(cycle_velocities)
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
        angular_velocities=np.concatenate(velocities),
        moments=np.concatenate(moments),
        emg_time=cycle_times(cycles, padding),
        emg=_normalise_raw(np.concatenate(emg), settings, problems, notes),
    )


def _cycle_names(entry: Signals) -> list[str]:
    """Name the cycles of a recording: ``walk`` for a single one, else ``walk/01``, ``walk/02``, ..."""
    count = len(entry.trial.cycles)
    if count == 1:
        return [entry.trial.name]
    digits = max(2, len(str(count)))
    return [f"{entry.trial.name}/{order:0{digits}d}" for order in range(1, count + 1)]


def _cut_emg(
    entry: Signals, settings: Settings, padding: int, notes: list[str]
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Cut the EMG of one recording into non-negative envelopes; those of raw EMG are not normalised yet."""
    cycles = list(entry.trial.cycles)
    time, emg = entry.emg_time, entry.emg
    if settings.emg_kind == "raw":
        time, emg = resample_evenly(time, emg)
        gait_period = float(np.median([end - start for start, end in cycles]))
        emg = compute_envelopes(emg, (time.size - 1) / (time[-1] - time[0]), gait_period)
    elif emg.min() < 0.0:
        low = [channel for channel, signal in zip(settings.channels, emg, strict=True) if signal.min() < 0.0]
        clipped = f"negative values, down to {emg.min():.3g}, were set to 0 in {', '.join(low)}"
        notes.append(f"{entry.trial.emg}: {clipped}")
    times = cycle_times(cycles, padding)
    limits = np.array(cycles)
    missing = PADDING_SECONDS + np.maximum(time[0] - limits[:, 0], limits[:, 1] - time[-1])
    if missing.max() > TIME_TOLERANCE:
        count = int((missing > TIME_TOLERANCE).sum())
        notes.append(
            f"trial '{entry.trial.name}': less than {PADDING_SECONDS:g} s of EMG before or after {count} of "
            f"{len(cycles)} cycles (up to {missing.max():.3g} s missing); the edge value is held"
        )
    # Sets negative samples, and the spline's undershoot between samples, to zero.
    return np.maximum(resample(time, emg, times)[0], 0.0)


def _normalise_raw(
    emg: Float[np.ndarray, "trial channel padded_frame"],
    settings: Settings,
    problems: list[Problem],
    notes: list[str],
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Normalise envelopes of raw EMG; return given envelopes unchanged."""
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
    """Note validation cycles that overlap with calibration cycles of the same recording."""
    for trial, other in itertools.combinations([entry.trial for entry in signals], 2):
        if trial.angles != other.angles or trial.use == other.use:
            continue
        shared = sum(
            min(first[1], second[1]) - max(first[0], second[0]) > TIME_TOLERANCE
            for first in trial.cycles
            for second in other.cycles
        )
        if shared:
            notes.append(
                f"trials '{trial.name}' and '{other.name}', one for calibration and one for validation, "
                f"overlap in {shared} pairs of cycles"
            )


def padding_frames(cycles: list[tuple[float, float]]) -> int:
    """Compute the number of padding frames on each side of a cycle.

    They span at least `PADDING_SECONDS` in the shortest cycle.
    """
    shortest = min(end - start for start, end in cycles)
    # Rounding must not add frames: a cycle from 0.07 to 0.57 s lasts 0.49999999999999994 s.
    frames = math.ceil(PADDING_SECONDS / (shortest / (FRAMES - 1)) - 1e-9)
    return PADDING_STEP * math.ceil(frames / PADDING_STEP)


def cycle_times(cycles: list[tuple[float, float]], padding: int = 0) -> Float[np.ndarray, "trial frame"]:
    """Compute evenly spaced times of the frames of each cycle, and of padding frames before and after it.

    Parameters
    ----------
    cycles
        Start and end of each cycle in s.
    padding
        Number of frames added before and after each cycle, at the same step.

    Returns
    -------
    Float[np.ndarray, "trial frame"]
        Time in s.
    """
    limits = np.array(cycles, dtype=float).reshape(-1, 2)
    phase = np.arange(-padding, FRAMES + padding) / (FRAMES - 1)
    times = limits[:, :1] * (1.0 - phase) + limits[:, 1:] * phase
    return times


def resample(
    time: Float[np.ndarray, " sample"],
    values: Float[np.ndarray, "coordinate sample"],
    at: Float[np.ndarray, "trial frame"],
) -> tuple[Float[np.ndarray, "trial coordinate frame"], Float[np.ndarray, "trial coordinate frame"]]:
    """Interpolate a recording by the cubic spline through all its samples (not-a-knot ends).

    Parameters
    ----------
    time
        Times of the samples in s, strictly increasing, not necessarily even.
    values
        Samples of each signal.
    at
        Times of the result in s. Before the first and after the last sample the edge value is held.

    Returns
    -------
    values, rates
        Interpolated values, and the time derivative of the spline, per s.
    """
    spline = CubicSpline(time, values, axis=1, bc_type="not-a-knot")
    inside = np.clip(at, time[0], time[-1])
    return np.moveaxis(spline(inside), 1, 0), np.moveaxis(spline(inside, 1), 1, 0)
