"""Weights of trials of several tasks in a calibration, by effective numbers of independent samples.

Frames of one trial are not independent: a minute of rest says little more than a second of it. Each gait
cycle and each interval counts, about each coordinate, for ``1 + reliability * (T / tau - 1)`` samples.
``T`` is the time for which its moment was measured; ``tau`` the decorrelation time of the moment about its
mean, the sum of its autocorrelation up to the first zero (Bayley & Hammersley 1946, doi:10.2307/2983560),
and at least `SHORTEST_DECORRELATION`; and the reliability is the share of the moment's variance that the
allowable error of a moment does not explain, so that noise about a constant moment is no information. All
gait cycles count alike, for their mean.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.subject.trials import Trials

#: Shortest decorrelation time of a joint moment, s: those of human movement have little power above 5 Hz.
SHORTEST_DECORRELATION = 0.1


def moment_errors_by_weight(
    trials: Trials,
) -> Float[np.ndarray, "trial coordinate frame"] | None:
    """Compute the allowable error of every moment such that each trial has the weight of its samples.

    Parameters
    ----------
    trials
        Trials that are calibrated.

    Returns
    -------
    Array or None
        Allowable errors, N m; infinite where no moment was measured. Their weighted mean square over all
        measured moments is `MOMENT_ERROR` squared. None if all moments have the same weight: all trials are
        complete gait cycles, and the settings give no numbers of samples.
    """
    if trials.is_gait_only and trials.given_samples is None:
        return None
    weight = _weights(trials)
    counted = weight > 0.0
    mean = weight.sum() / weight.size
    return np.where(counted, MOMENT_ERROR * np.sqrt(mean / np.where(counted, weight, 1.0)), np.inf)


def samples_by_recording(trials: Trials) -> dict[str, float]:
    """Compute the effective number of samples of each recording, by name: the sum over its coordinates."""
    weight = _weights(trials).sum(axis=(1, 2))
    names = np.array(trials.recordings)
    return {name: float(weight[names == name].sum()) for name in dict.fromkeys(trials.recordings)}


def _weights(trials: Trials) -> Float[np.ndarray, "trial coordinate frame"]:
    """Compute the number of samples that each moment stands for; zero where none was measured."""
    known = np.isfinite(trials.moments)
    counted, units = known.any(axis=1), _units(trials)
    step = np.diff(trials.time[:, :2], axis=1)[:, 0]
    gait = trials.is_gait
    weight = np.zeros(known.shape)
    of_gait = [
        effective_samples(moment, step[trial])
        for trial in np.flatnonzero(gait)
        for moment in trials.moments[trial]
        if np.isfinite(moment).all()
    ]
    for chosen in units:
        first = int(np.flatnonzero(chosen.any(axis=1))[0])
        given = np.nan if trials.given_samples is None else trials.given_samples[first]
        for coordinate in range(known.shape[1]):
            own = chosen & known[:, coordinate] & counted
            if not own.any():
                continue
            if np.isfinite(given):
                samples = given
            elif gait[first]:
                samples = float(np.mean(of_gait))
            else:
                samples = effective_samples(trials.moments[:, coordinate][own], step[first])
            weight[:, coordinate][own] = samples / own.sum()
    return weight


def _units(trials: Trials) -> list[Bool[np.ndarray, "trial frame"]]:
    """Mark the frames of each gait cycle, and of each interval of another task."""
    counted, gait = trials.counted, trials.is_gait
    units = []
    for trial in np.flatnonzero(gait):
        own = np.zeros_like(counted)
        own[trial] = True
        units.append(own)
    names = np.array(trials.recordings)
    for name in dict.fromkeys(names[~gait].tolist()):
        rows, frames = np.nonzero(counted & (names == name)[:, None])
        time = trials.time[rows, frames]
        step = np.diff(trials.time[rows[0], :2])[0]
        for part in np.split(np.arange(time.size), np.flatnonzero(np.diff(time) > 1.5 * step) + 1):
            own = np.zeros_like(counted)
            own[rows[part], frames[part]] = True
            units.append(own)
    return units


def effective_samples(moment: Float[np.ndarray, " frame"], step: float) -> float:
    """Compute the effective number of independent samples of one moment.

    Parameters
    ----------
    moment
        Moment in consecutive frames, N m.
    step
        Time between frames, s.

    Returns
    -------
    float
        Number of samples, at least 1 and at most one for each `SHORTEST_DECORRELATION`.
    """
    count = moment.size
    change = moment - moment.mean()
    variance = float(change @ change) / count
    if count < 2 or variance <= 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(change, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count] / (count * variance)
    ends = np.flatnonzero(correlation <= 0.0)
    positive = correlation[1 : ends[0] if ends.size else count]
    decorrelation = max(step * (1.0 + 2.0 * float(positive.sum())), SHORTEST_DECORRELATION)
    reliability = variance / (variance + MOMENT_ERROR**2)
    return 1.0 + reliability * max(count * step / decorrelation - 1.0, 0.0)
