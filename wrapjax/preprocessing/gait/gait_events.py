"""Gait events (foot strike and toe-off), gait cycles and phases from the vertical ground reaction force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

#: Vertical force above which a foot is in contact, N: above the drift and noise of force plates.
CONTACT_FORCE = 30.0
#: Shortest stance or swing, s; shorter ones are caused by ringing plates or by feet that touch the belt.
MIN_PHASE_DURATION = 0.08
#: Shortest and longest gait cycle, s. A longer interval contains a step beside the plates.
MIN_CYCLE_DURATION, MAX_CYCLE_DURATION = 0.5, 3.0
#: Largest distance (s) of a cycle's start from a recorded strike at which the cycle starts with the strike.
#: Recorded strikes are late by the force threshold, or early by about 20 ms if forces were low-pass filtered.
AT_STRIKE = 0.03


@dataclass(frozen=True)
class Contacts:
    """Foot strikes and toe-offs of one foot.

    Parameters
    ----------
    strikes
        Time in s of the first sample of each contact.
    offs
        Time in s of the first sample after each contact. A contact at the start or the end of the recording
        has only one of the two.
    """

    strikes: Float[np.ndarray, " strike"]
    offs: Float[np.ndarray, " off"]

    def cycles(
        self, start: float = -np.inf, end: float = np.inf, longest: float = MAX_CYCLE_DURATION
    ) -> tuple[tuple[float, float], ...]:
        """Return the gait cycles (strike to next strike of the same foot) between two times.

        Parameters
        ----------
        start, end
            First and last time, s.
        longest
            Longest cycle, s; longer ones contain a step that was not measured and are omitted.
        """
        pairs = zip(self.strikes[:-1].tolist(), self.strikes[1:].tolist(), strict=True)
        return tuple(
            (first, last)
            for first, last in pairs
            if MIN_CYCLE_DURATION <= last - first <= longest and first >= start and last <= end
        )


def find_contacts(
    time: Float[np.ndarray, " sample"],
    vertical_force: Float[np.ndarray, " sample"],
    threshold: float = CONTACT_FORCE,
) -> Contacts:
    """Find the strikes and toe-offs of a foot.

    Parameters
    ----------
    time
        Times, s, strictly increasing.
    vertical_force
        Upward ground reaction force on this foot, N, not filtered: a low-pass filter advances strikes.
    threshold
        Force above which the foot is in contact, N.

    Returns
    -------
    Contacts
        Events at sample times.
    """
    on = without_short_runs(time, vertical_force > threshold, MIN_PHASE_DURATION)
    change = np.flatnonzero(on[1:] != on[:-1]) + 1
    return Contacts(strikes=time[change[on[change]]], offs=time[change[~on[change]]])


def without_short_runs(
    time: Float[np.ndarray, " sample"], on: Bool[np.ndarray, " sample"], shortest: float
) -> Bool[np.ndarray, " sample"]:
    """Invert runs of equal values that are shorter than ``shortest`` (s): first runs of false, then of true.

    Runs at either end of the recording are kept, as their full duration is unknown.
    """
    cleaned = on.copy()
    for value in (False, True):
        edges = np.flatnonzero(cleaned[1:] != cleaned[:-1]) + 1
        for first, last in pairwise(edges):
            if cleaned[first] == value and time[last] - time[first] < shortest:
                cleaned[first:last] = not value
    return cleaned


def uniform_phases(frames: int) -> Float[np.ndarray, " frame"]:
    """Compute the phase of a cycle that starts and ends with a strike, %."""
    return np.linspace(0.0, 100.0, frames)


def gait_phases(
    time: Float[np.ndarray, "trial frame"], strikes: Sequence[Float[np.ndarray, " _"]]
) -> Float[np.ndarray, "trial frame"]:
    """Compute the phase of all frames from the strikes of the foot, in the same way for all cycles.

    If all cycles start and end at strikes (within `AT_STRIKE`), their limits are used, because strikes of
    filtered forces are too early. Otherwise the recorded strikes are used for all cycles.

    Parameters
    ----------
    time
        Time of each frame, s.
    strikes
        Times of foot strikes in the recording of each cycle, s, in ascending order; empty where unknown.

    Returns
    -------
    array
        Phase, %, starting below 100 and rising by 100 from strike to strike. Cycles without strikes have the
        mean phase of the others, or uniform phase if no strikes are known.
    """
    count, frames = time.shape
    known = [row for row in range(count) if strikes[row].size]
    if all(_is_from_strike_to_strike(time[row], strikes[row]) for row in known):
        return np.tile(uniform_phases(frames), (count, 1))
    counted = {row: phase_from_strikes(time[row], strikes[row]) for row in known}
    mean_phase = _mean_phase(np.array(list(counted.values())))
    return np.array([counted.get(row, mean_phase) for row in range(count)])


def phase_from_strikes(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> Float[np.ndarray, " frame"]:
    """Compute the phase of each frame of a cycle: time since the last strike, in % of the time to the next.

    Parameters
    ----------
    time
        Time of each frame, s.
    strikes
        Times of foot strikes, s, in ascending order, at least one. They are continued in both directions with
        the median stride time, or with the duration of the cycle if there is one strike only.

    Returns
    -------
    array
        Phase, %, from 0; it exceeds 100 after a strike within the cycle, so that it is monotonic.
    """
    step = (time[-1] - time[0]) / (time.size - 1)
    every = _extrapolate_strikes(time, strikes)
    passed = np.interp(time, every, 100.0 * np.arange(every.size))
    # A cycle that was cut at a strike starts with phase 0, even if its first frame is just before the strike.
    first_stride = np.floor((passed[0] + 100.0 * step / np.diff(every).mean()) / 100.0)
    return np.maximum(passed - 100.0 * first_stride, 0.0)


def _extrapolate_strikes(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> Float[np.ndarray, " extrapolated"]:
    """Continue the strikes periodically until they cover all frames with a margin."""
    stride = float(np.median(np.diff(strikes))) if strikes.size > 1 else float(time[-1] - time[0])
    before = max(int(np.ceil((strikes[0] - time[0]) / stride)), 0) + 1
    after = max(int(np.ceil((time[-1] - strikes[-1]) / stride)), 0) + 1
    return np.concatenate(
        [
            strikes[0] - stride * np.arange(before, 0, -1),
            strikes,
            strikes[-1] + stride * np.arange(1, after + 1),
        ]
    )


def _is_from_strike_to_strike(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> bool:
    """Whether a cycle starts at a strike and ends at the next one."""
    every = _extrapolate_strikes(time, strikes)
    first = int(np.abs(every - time[0]).argmin())
    return first + 1 < every.size and bool(
        (np.abs(every[first : first + 2] - time[[0, -1]]) <= AT_STRIKE).all()
    )


def _mean_phase(phases: Float[np.ndarray, "trial frame"]) -> Float[np.ndarray, " frame"]:
    """Average phases over cycles; the starts are averaged on a circle, because 99 and 1 % are close."""
    mean_start = np.exp(2j * np.pi * phases[:, 0] / 100.0).mean()
    start = np.angle(mean_start) / (2.0 * np.pi) * 100.0 % 100.0
    return start + (phases - phases[:, :1]).mean(axis=0)
