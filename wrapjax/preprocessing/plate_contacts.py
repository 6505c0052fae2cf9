"""Stances on force plates, and the frames in which the plates measured all ground contact.

In overground walking a foot may step beside the plates, where its force is not measured. Contact is known
from the forces alone, in whatever unit: a foot on its plate; a foot that is certainly in the air, for some
time before and after a stance and between two stances that are no further apart than a swing; and, in the
middle half of a stance in walking, the other foot in the air.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.preprocessing.force_plates import FootForces
from wrapjax.preprocessing.gait_events import MIN_PHASE_DURATION, without_short_runs

#: A foot is on a plate above this share of the largest vertical force on any foot.
CONTACT_SHARE = 0.05
#: Longest swing, in stances of the same foot: in walking a stance takes at least 0.4 of the gait cycle. A
#: longer gap contains a step that was not measured.
MAX_SWING = 1.5
#: Time before a strike and after a toe-off in which the foot is certainly in the air, in stances.
CERTAIN_SWING = 0.25
#: Part of a stance in which, in walking, the other foot is in the air.
SINGLE_SUPPORT = (0.25, 0.75)
#: Smallest share of that part that must be within the recording: in half of it the force mainly rises or
#: mainly falls, so that a wrong amplitude and a time shift have the same effect.
MIN_RECORDED_SHARE = 0.75


@dataclass(frozen=True)
class Steps:
    """Stances of one foot on its force plates.

    Parameters
    ----------
    strikes, offs
        Start and end of each stance, s; a stance that extends beyond the recording starts or ends at its
        limit.
    complete
        Whether both the start and the end of each stance were recorded.
    """

    strikes: Float[np.ndarray, " step"]
    offs: Float[np.ndarray, " step"]
    complete: Bool[np.ndarray, " step"]

    @property
    def stance(self) -> float:
        """Median duration of a stance, s; NaN without any."""
        if self.strikes.size == 0:
            return float("nan")
        durations = self.offs - self.strikes
        return float(np.median(durations[self.complete]) if self.complete.any() else durations.max())

    def on_plate(self, time: Float[np.ndarray, " frame"], margin: float = 0.0) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is on a plate at each time, or within ``margin`` s before or after."""
        return _within(time, self.strikes - margin, self.offs + margin)

    def contact_known(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is certainly on a plate or in the air (not beside plates) at each time."""
        if self.strikes.size == 0:
            return np.zeros(time.size, bool)
        swings = self.strikes[1:] - self.offs[:-1] <= MAX_SWING * self.stance
        in_air = _within(time, self.offs[:-1][swings], self.strikes[1:][swings])
        return self.on_plate(time, CERTAIN_SWING * self.stance) | in_air

    def single_support(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Return whether the foot is certainly in single support (middle of a complete stance)."""
        first, last = (self.strikes + share * (self.offs - self.strikes) for share in SINGLE_SUPPORT)
        recorded = np.minimum(last, time[-1]) - np.maximum(first, time[0])
        usable = self.complete & (recorded >= MIN_RECORDED_SHARE * (last - first))
        return _within(time, first[usable], last[usable])

    def durations_off_plate(self, start: float, end: float) -> Float[np.ndarray, " span"]:
        """Compute the duration of each interval off the plates between two times, s."""
        inside = (self.offs > start) & (self.strikes < end)
        interval_start = np.concatenate([[start], np.minimum(self.offs[inside], end)])
        interval_end = np.concatenate([np.maximum(self.strikes[inside], start), [end]])
        return np.asarray(interval_end - interval_start)


def _within(
    time: Float[np.ndarray, " frame"], starts: Float[np.ndarray, " span"], ends: Float[np.ndarray, " span"]
) -> Bool[np.ndarray, " frame"]:
    return np.asarray(((time >= starts[:, None]) & (time <= ends[:, None])).any(axis=0))


def find_plate_contacts(forces: FootForces) -> dict[str, Steps]:
    """Find the stances of each foot on its plates.

    Parameters
    ----------
    forces
        Forces, upward positive, in any unit.

    Returns
    -------
    dict
        Stances by side.
    """
    threshold = max(CONTACT_SHARE * float(forces.wrench[:, 4].max()), 0.0)
    return {side: _find_steps(forces.time, forces.vertical(side), threshold) for side in forces.sides}


def _find_steps(
    time: Float[np.ndarray, " sample"], vertical: Float[np.ndarray, " sample"], threshold: float
) -> Steps:
    on = without_short_runs(time, vertical > threshold, MIN_PHASE_DURATION)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    first, after = edges[::2], edges[1::2]
    complete = (first > 0) & (after < time.size)
    return Steps(time[first], time[np.minimum(after, time.size - 1)], complete)


def all_contact_measured(
    time: Float[np.ndarray, " frame"], steps: Sequence[Steps]
) -> Bool[np.ndarray, " frame"]:
    """Return whether, in walking, the plates measured all ground contact at each time.

    Parameters
    ----------
    time
        Times, s.
    steps
        Stances of one foot or of both.
    """
    single_support = np.any([foot.single_support(time) for foot in steps], axis=0)
    if len(steps) < 2:
        return np.asarray(single_support)
    return np.asarray(single_support | np.all([foot.contact_known(time) for foot in steps], axis=0))
