"""Cutting of recordings into gait cycles and windows, with EMG filtered, padded and normalised."""

from __future__ import annotations

import itertools
import math

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import Problem
from wrapjax.subject.emg_envelopes import (
    LOW_PASS_HZ,
    compute_envelopes,
    envelopes_below,
    normalise,
    resample_evenly,
)
from wrapjax.subject.maximal_contractions import notes_on_maxima
from wrapjax.subject.recordings import Signals
from wrapjax.subject.settings import Settings
from wrapjax.subject.trials import FRAMES, GAIT, TIME_TOLERANCE, Trials
from wrapjax.subject.windows import SETTLING_SECONDS, WINDOW_STEP, counted_frames, window_limits

#: EMG kept before and after each cycle, s, so that it can be shifted by the electromechanical delay.
PADDING_SECONDS = 0.2
#: The number of padding frames is a multiple of this, so that subjects of different walking speeds use the
#: same compiled code.
PADDING_STEP = 10


def cut_cycles(
    settings: Settings,
    signals: list[Signals],
    problems: list[Problem],
    notes: list[str],
    maxima: Float[np.ndarray, " channel"] | None = None,
) -> Trials:
    """Cut all recordings into cycles or windows, and normalise raw EMG over all of them.

    Parameters
    ----------
    settings
        Settings of the subject.
    signals
        Checked signals of all recordings.
    problems
        List to which a problem is added for each raw EMG channel without a signal.
    notes
        List to which held edge values, clipped samples, channels without a signal, overlapping cycles and
        assumed coordinates are added.
    maxima
        Envelope of each channel in a maximal contraction, which becomes 1; if not given, the largest one
        over all recordings does.

    Returns
    -------
    Trials
        All gait cycles and windows, in the order of the settings.
    """
    spans = [_spans(entry) for entry in signals]
    gait = [cycle for entry in signals if entry.trial.task == GAIT for cycle in entry.trial.cycles]
    padding = padding_frames(gait) if gait else 2 * PADDING_STEP
    only_gait = all(entry.trial.task == GAIT for entry in signals)
    leading = padding if only_gait else max(math.ceil(SETTLING_SECONDS / WINDOW_STEP), padding)
    shared = _shared_coordinates(signals)
    angles, velocities, moments, emg, emg_time = [], [], [], [], []
    for entry, limits in zip(signals, spans, strict=True):
        times = cycle_times(limits)
        given = _with_assumed(entry, shared, notes)
        cycle_angles, cycle_velocities = resample(entry.angle_time, given, times)
        if entry.trial.task != GAIT:
            held = (times < entry.angle_time[0]) | (times > entry.angle_time[-1])
            cycle_velocities = np.where(held[:, None], 0.0, cycle_velocities)
        angles.append(cycle_angles)
        velocities.append(cycle_velocities)
        moments.append(_cut_moments(entry, times))
        emg.append(_cut_emg(entry, settings, limits, (leading, padding), notes))
        emg_time.append(_emg_times(limits, leading, padding))
    _note_overlaps(signals, notes)
    each = [entry.trial for entry, limits in zip(signals, spans, strict=True) for _ in limits]
    samples = np.array([trial.effective_samples for trial in each])
    starts = np.array([leading - padding if trial.task == GAIT else 0 for trial in each])
    return Trials(
        names=tuple(
            name for entry, limits in zip(signals, spans, strict=True) for name in _names(entry, limits)
        ),
        recordings=tuple(trial.name for trial in each),
        uses=tuple(trial.use for trial in each),
        speeds=np.array([trial.speed for trial in each]),
        coordinates=shared,
        moment_coordinates=settings.coordinates,
        channels=tuple(settings.channels),
        time=np.concatenate([cycle_times(limits) for limits in spans]),
        angles=np.concatenate(angles),
        angular_velocities=np.concatenate(velocities),
        moments=np.concatenate(moments),
        emg_time=np.concatenate(emg_time),
        emg=_normalise_raw(np.concatenate(emg), settings, maxima, problems, notes),
        tasks=tuple(trial.task for trial in each),
        conditions=tuple(trial.condition for trial in each),
        given_samples=None if np.isnan(samples).all() else samples,
        leading=None if only_gait else leading,
        emg_starts=None if only_gait else starts,
    )


def _spans(entry: Signals) -> list[tuple[float, float]]:
    """Compute start and end of every cycle, or of every window, of a recording."""
    if entry.trial.task == GAIT:
        return list(entry.trial.cycles)
    return [limits for interval in entry.trial.cycles for limits in window_limits(interval)]


def _names(entry: Signals, spans: list[tuple[float, float]]) -> list[str]:
    """Name the cycles of a recording: ``walk`` for a single one, else ``walk/01``, ``walk/02``, ..."""
    if len(spans) == 1:
        return [entry.trial.name]
    digits = max(2, len(str(len(spans))))
    return [f"{entry.trial.name}/{order:0{digits}d}" for order in range(1, len(spans) + 1)]


def _shared_coordinates(signals: list[Signals]) -> tuple[str, ...]:
    """Name the coordinates of all gait recordings; without gait, those of any recording, in its order.

    Paths over gait cycles are therefore the same whether other tasks were recorded or not.
    """
    gait = [entry for entry in signals if entry.trial.task == GAIT]
    if not gait:
        return tuple(dict.fromkeys(name for entry in signals for name in entry.coordinates))
    return tuple(name for name in gait[0].coordinates if all(name in entry.coordinates for entry in gait))


def _with_assumed(
    entry: Signals, shared: tuple[str, ...], notes: list[str]
) -> Float[np.ndarray, "coordinate angle_sample"]:
    """Complete the angles of a recording by the model's default values of coordinates that it lacks."""
    missing = [name for name in shared if name not in entry.coordinates]
    if missing:
        values = ", ".join(f"{name} {entry.defaults[name]:.3g} rad (m)" for name in missing)
        notes.append(
            f"trial '{entry.trial.name}' lacks {_first_names(missing)}: the model's default "
            f"is taken ({values}); posture = {{...}} in subject.toml states another"
        )
    samples = entry.angle_time.size
    return np.array(
        [
            entry.angles[entry.coordinates.index(name)]
            if name in entry.coordinates
            else np.full(samples, entry.defaults[name])
            for name in shared
        ]
    ).reshape(len(shared), samples)


def _first_names(names: list[str]) -> str:
    """List up to three names, and how many more there are."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


def _cut_moments(
    entry: Signals, times: Float[np.ndarray, "trial frame"]
) -> Float[np.ndarray, "trial moment_coordinate frame"]:
    """Cut the moments of a recording; NaN about coordinates and in frames without a measured moment."""
    known = np.isfinite(entry.moments).all(axis=1)
    values = np.where(known[:, None], entry.moments, 0.0)
    cut, _ = resample(entry.moment_time, values, times)
    if entry.trial.task == GAIT:
        return cut
    counted = np.concatenate([counted_frames(interval) for interval in entry.trial.cycles])
    return np.where(known[None, :, None] & counted[:, None], cut, np.nan)


def _emg_times(
    spans: list[tuple[float, float]], leading: int, padding: int
) -> Float[np.ndarray, "trial padded_frame"]:
    """Compute the times of the frames of EMG: as `cycle_times`, with other numbers before and after."""
    return cycle_times(spans, leading)[:, : leading + FRAMES + padding]


def _cut_emg(
    entry: Signals,
    settings: Settings,
    spans: list[tuple[float, float]],
    frames: tuple[int, int],
    notes: list[str],
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Cut the EMG of one recording into non-negative envelopes; those of raw EMG are not normalised yet.

    ``frames`` are the numbers of frames before and after each cycle. Before the padding of a gait cycle its
    first value is held. A recording without EMG is NaN.
    """
    leading, padding = frames
    times = _emg_times(spans, leading, padding)
    if entry.emg is None or entry.emg_time is None:
        return np.full((len(spans), len(settings.channels), times.shape[1]), np.nan)
    gait = entry.trial.task == GAIT
    time, emg = entry.emg_time, entry.emg
    cycles = list(entry.trial.cycles)
    if settings.emg_kind == "raw":
        time, emg = resample_evenly(time, emg)
        rate = (time.size - 1) / (time[-1] - time[0])
        if gait and math.isnan(entry.trial.emg_low_pass):
            gait_period = float(np.median([end - start for start, end in cycles]))
            emg = compute_envelopes(emg, rate, gait_period)
        else:
            cutoff = entry.trial.emg_low_pass
            emg = envelopes_below(emg, rate, LOW_PASS_HZ if math.isnan(cutoff) else cutoff)
    elif emg.min() < 0.0:
        low = [channel for channel, signal in zip(settings.channels, emg, strict=True) if signal.min() < 0.0]
        clipped = f"negative values, down to {emg.min():.3g}, were set to 0 in {', '.join(low)}"
        notes.append(f"{entry.trial.emg}: {clipped}")
    limits = np.array(cycles)
    missing = PADDING_SECONDS + np.maximum(time[0] - limits[:, 0], limits[:, 1] - time[-1] if gait else -1.0)
    if missing.max() > TIME_TOLERANCE:
        count = int((missing > TIME_TOLERANCE).sum())
        where, kind = ("before or after", "cycles") if gait else ("before", "intervals")
        notes.append(
            f"trial '{entry.trial.name}': less than {PADDING_SECONDS:g} s of EMG {where} {count} of "
            f"{len(cycles)} {kind} (up to {missing.max():.3g} s missing); the edge value is held"
        )
    if gait:
        times = cycle_times(spans, padding)
    # Sets negative samples, and the spline's undershoot between samples, to zero.
    cut = np.maximum(resample(time, emg, times)[0], 0.0)
    held = np.repeat(cut[..., :1], leading - padding if gait else 0, axis=-1)
    return np.concatenate([held, cut], axis=-1)


def _normalise_raw(
    emg: Float[np.ndarray, "trial channel padded_frame"],
    settings: Settings,
    maxima: Float[np.ndarray, " channel"] | None,
    problems: list[Problem],
    notes: list[str],
) -> Float[np.ndarray, "trial channel padded_frame"]:
    """Normalise envelopes of raw EMG; return given envelopes unchanged. Rest is at each channel's floor."""
    at_rest = np.isnan(emg).any(axis=(1, 2))
    if at_rest.all():
        return np.zeros_like(emg)
    recorded = emg[~at_rest] if at_rest.any() else emg
    peaks = recorded.max(axis=(0, 2))
    silent = [channel for channel, peak in zip(settings.channels, peaks, strict=True) if peak <= 0.0]
    if settings.emg_kind == "envelope":
        notes.extend(f"channel '{channel}' is zero in every cycle" for channel in silent)
    else:
        for channel in silent:
            files = ", ".join(dict.fromkeys(str(trial.emg) for trial in settings.trials if trial.emg))
            problems.append(Problem(files, "expected EMG, found none in any cycle", f"column {channel}"))
        if maxima is not None and not silent:
            notes.extend(notes_on_maxima(tuple(settings.channels), peaks, maxima))
        recorded = recorded if silent else normalise(recorded, maxima)
    if not at_rest.any():
        return recorded
    complete = np.empty_like(emg)
    complete[~at_rest] = recorded
    complete[at_rest] = noise_floor(recorded)[:, None]
    return complete


def noise_floor(emg: Float[np.ndarray, "trial channel frame"]) -> Float[np.ndarray, " channel"]:
    """Compute the level of each channel's envelope at rest: its first percentile over all trials."""
    return np.asarray(np.percentile(emg, 1.0, axis=(0, 2)))


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
