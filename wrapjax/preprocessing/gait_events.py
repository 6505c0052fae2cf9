"""When feet meet and leave the ground, by the vertical force under each."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

#: A foot is on the ground above this vertical force in N: above what plates drift and walkers' hands shake.
CONTACT_FORCE = 30.0
#: Contacts and gaps shorter than this, in s, are none: plates ring, and feet brush the belt.
SHORTEST_PHASE = 0.08
#: A gait cycle lasts at least and at most this, in s. What is longer has a step off the plate in it.
SHORTEST_CYCLE, LONGEST_CYCLE = 0.5, 3.0


@dataclass(frozen=True)
class Contacts:
    """Steps of one foot.

    Parameters
    ----------
    strikes
        Time in s of each first sample on the ground.
    offs
        Time in s of each first sample off the ground. A contact that was under way when the recording
        began, or when it ended, has only one of the two.
    """

    strikes: Float[np.ndarray, " strike"]
    offs: Float[np.ndarray, " off"]

    def cycles(
        self, start: float = -np.inf, end: float = np.inf, longest: float = LONGEST_CYCLE
    ) -> tuple[tuple[float, float], ...]:
        """List gait cycles, each from a strike to the next of the same foot, that lie between two times.

        Parameters
        ----------
        start, end
            Limits in s.
        longest
            Leave out cycles longer than this, in s: a step between was not measured.
        """
        pairs = zip(self.strikes[:-1].tolist(), self.strikes[1:].tolist(), strict=True)
        return tuple(
            (first, last)
            for first, last in pairs
            if SHORTEST_CYCLE <= last - first <= longest and first >= start and last <= end
        )


def find_contacts(
    time: Float[np.ndarray, " sample"],
    vertical_force: Float[np.ndarray, " sample"],
    threshold: float = CONTACT_FORCE,
) -> Contacts:
    """Find when a foot meets and leaves the ground.

    Parameters
    ----------
    time
        s, strictly increasing.
    vertical_force
        Of the ground on this foot, upwards, in N, not filtered: a low-pass filter makes feet touch early.
    threshold
        N.

    Returns
    -------
    Contacts
        At samples of the recording, to no more than one of them.
    """
    on = without_short_runs(time, vertical_force > threshold, SHORTEST_PHASE)
    change = np.flatnonzero(on[1:] != on[:-1]) + 1
    return Contacts(strikes=time[change[on[change]]], offs=time[change[~on[change]]])


def without_short_runs(
    time: Float[np.ndarray, " sample"], on: Bool[np.ndarray, " sample"], shortest: float
) -> Bool[np.ndarray, " sample"]:
    """Turn over runs of equal values shorter than ``shortest`` (s): gaps first, then what is still short.

    Runs at either end of the recording stay: how long they were nobody knows.
    """
    cleaned = on.copy()
    for value in (False, True):
        edges = np.flatnonzero(cleaned[1:] != cleaned[:-1]) + 1
        for first, last in pairwise(edges):
            if cleaned[first] == value and time[last] - time[first] < shortest:
                cleaned[first:last] = not value
    return cleaned
