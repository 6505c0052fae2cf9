"""Gait events (foot strike and toe-off) and gait cycles from the vertical ground reaction force."""

from __future__ import annotations

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
