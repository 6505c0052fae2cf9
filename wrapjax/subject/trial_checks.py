"""Checks of the moments and the EMG of trials: units, signs, and rest in passive trials."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import GAIT, MOVEMENT, Trials

#: Limits of the peak moment per body mass by task, N m/kg. Walking peaks near 2 and running near 4, the
#: strongest knee extensors hold 5, and relaxed tissue resists with less than 1. Larger values mean another
#: unit (N cm, N mm) or failed inverse dynamics.
MAX_MOMENT_PER_MASS = {GAIT: 10.0, "passive": 2.0, "isometric": 6.0, "isokinetic": 6.0, MOVEMENT: 10.0}
#: Smaller peaks of gait and movements mean moments that were divided by body mass.
MIN_MOMENT_PER_MASS = 0.05
#: A passive moment that rises with the angle, where both change by more than this (rad, N m) and correlate
#: more closely, has the sign of the angle or of the moment reversed.
MIN_RESTORING_RANGE = (np.radians(10.0), 3.0)
MAX_RESTORING_CORRELATION = 0.7
#: Largest envelope above the channel's floor of a relaxed muscle; its 95th percentile counts.
MAX_RELAXED_ENVELOPE = 0.05


def check_moments(
    moments: Float[np.ndarray, "moment_coordinate sample"],
    names: tuple[str, ...],
    mass_kg: float,
    trial: TrialSettings,
    problems: list[Problem],
) -> None:
    """Report moments that are zero throughout or in another unit; those that are NaN were not measured."""
    path, limit = trial.moments, MAX_MOMENT_PER_MASS[trial.task]
    peaks = np.abs(moments).max(axis=1)
    for name, peak in zip(names, peaks, strict=True):
        if peak == 0.0:
            problems.append(
                Problem(str(path), "expected joint moments, found zero throughout", f"column {name}_moment")
            )
        elif peak > limit * mass_kg:
            kind = "" if trial.task == GAIT else f" in a trial of task '{trial.task}'"
            message = f"expected N m, found {peak:.4g}, more than {limit:g} N m per kg of body mass{kind}"
            hint = "are the moments in N mm?" if trial.task == GAIT else "are the moments in N cm or N mm?"
            problems.append(Problem(str(path), message, f"column {name}_moment", hint))
    known = peaks[np.isfinite(peaks)]
    moving = trial.task in (GAIT, MOVEMENT)
    if moving and known.size and 0.0 < known.max() < MIN_MOMENT_PER_MASS * mass_kg:
        message = f"expected N m, found no moment above {known.max():.3g}"
        problems.append(Problem(str(path), message, hint="are the moments divided by body mass?"))


def check_restoring_moments(
    file: Path | None,
    names: tuple[str, ...],
    samples: Mapping[str, tuple[np.ndarray, np.ndarray]],
    problems: list[Problem],
) -> None:
    """Report passive moments that rise with the angle: relaxed tissue resists stretch, and so they must fall.

    Parameters
    ----------
    file
        File of the moments of a passive trial, for the message.
    names
        Coordinates of the subject.
    samples
        Angle (rad) and moment (N m, OpenSim's signs) about each measured coordinate.
    problems
        List to which problems are added.
    """
    for name in names:
        if name not in samples:
            continue
        angle, moment = samples[name]
        if angle.size < 3 or any(
            np.ptp(values) <= least
            for values, least in zip((angle, moment), MIN_RESTORING_RANGE, strict=True)
        ):
            continue
        correlation = float(np.corrcoef(angle, moment)[0, 1])
        if correlation > MAX_RESTORING_CORRELATION:
            message = (
                f"expected a passive moment that falls as the angle rises, as tissue resists stretch; found "
                f"one that rises with it (correlation {correlation:.2f})"
            )
            hint = "is a sign opposite to OpenSim's, or was the limb's weight not subtracted?"
            problems.append(Problem(str(file), message, f"column {name}_moment", hint))


def activity_notes(trials: Trials, floor: Float[np.ndarray, " channel"]) -> list[str]:
    """Note passive trials in which muscles were active, with the channel and its level.

    Parameters
    ----------
    trials
        All trials of the subject.
    floor
        Envelope of each channel at rest.
    """
    notes = []
    chosen = np.array([task == "passive" for task in trials.tasks], dtype=bool)
    for recording in dict.fromkeys(np.array(trials.recordings)[chosen].tolist()):
        own = chosen & (np.array(trials.recordings) == recording)
        emg = np.moveaxis(trials.emg[own][:, :, trials.inside], 1, 0)[:, trials.counted[own]]
        levels = np.percentile(emg, 95.0, axis=1) - floor
        active = [
            f"{channel} ({level:.2f} above its floor of {low:.2f})"
            for channel, level, low in zip(trials.channels, levels, floor, strict=True)
            if level > MAX_RELAXED_ENVELOPE
        ]
        if active:
            notes.append(
                f"trial '{recording}' is passive, but muscles were active: {', '.join(active)}; relaxed ones "
                f"stay within {MAX_RELAXED_ENVELOPE:g} of the floor"
            )
    return notes
