"""Which steps were on force plates, and when what plates measured is all that the ground does.

Over ground a foot may step beside the plates, and then nothing tells its force. What is known is told by the
forces alone, whatever their unit: a foot on its plate; a foot in the air, for a while before and after, and
between two steps that are no further apart than a swing; and, by the middle half of a stance in walking, the
other foot in the air.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.preprocessing.force_plates import FootForces
from wrapjax.preprocessing.gait_events import SHORTEST_PHASE, without_short_runs

#: A foot is on a plate above this share of the largest force that any foot bears.
ON_PLATE = 0.05
#: No swing lasts longer than this many of a foot's stances: walking, a stance takes 0.4 of the gait cycle or
#: more. A longer gap has a step in it that was not measured.
LONGEST_SWING = 1.5
#: How long a foot is surely in the air before it strikes and after it has left the ground, in stances.
SURELY_IN_AIR = 0.25
#: Part of a stance in which, walking, the other foot is in the air.
OTHER_IN_AIR = (0.25, 0.75)
#: Share of that part whose motion must be known: in half of it forces do little but rise, or fall, which goes
#: with a wrong size as well as with a wrong time.
LEAST_RECORDED = 0.75


@dataclass(frozen=True)
class Steps:
    """Steps of one foot on its plates.

    Parameters
    ----------
    strikes, offs
        s; a step that was under way when the recording began, or when it ended, begins or ends there.
    whole
        Whether both ends of a step were recorded.
    """

    strikes: Float[np.ndarray, " step"]
    offs: Float[np.ndarray, " step"]
    whole: Bool[np.ndarray, " step"]

    @property
    def stance(self) -> float:
        """How long the foot is on the ground in a step, s: the median; NaN without a step."""
        if self.strikes.size == 0:
            return float("nan")
        durations = self.offs - self.strikes
        return float(np.median(durations[self.whole]) if self.whole.any() else durations.max())

    def on(self, time: Float[np.ndarray, " frame"], earlier: float = 0.0) -> Bool[np.ndarray, " frame"]:
        """Say whether the foot is on a plate, or is so within ``earlier`` s before or after."""
        return _within(time, self.strikes - earlier, self.offs + earlier)

    def known(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Say whether the foot is surely on a plate or in the air, not beside the plates."""
        if self.strikes.size == 0:
            return np.zeros(time.size, bool)
        swings = self.strikes[1:] - self.offs[:-1] <= LONGEST_SWING * self.stance
        in_air = _within(time, self.offs[:-1][swings], self.strikes[1:][swings])
        return self.on(time, SURELY_IN_AIR * self.stance) | in_air

    def alone(self, time: Float[np.ndarray, " frame"]) -> Bool[np.ndarray, " frame"]:
        """Say whether the foot, in the middle of a stance that was recorded, surely bears the body alone."""
        first, last = (self.strikes + share * (self.offs - self.strikes) for share in OTHER_IN_AIR)
        recorded = np.minimum(last, time[-1]) - np.maximum(first, time[0])
        told = self.whole & (recorded >= LEAST_RECORDED * (last - first))
        return _within(time, first[told], last[told])

    def times_off(self, start: float, end: float) -> Float[np.ndarray, " span"]:
        """Give how long the foot is off its plates each time between two times, s."""
        inside = (self.offs > start) & (self.strikes < end)
        left = np.concatenate([[start], np.minimum(self.offs[inside], end)])
        met = np.concatenate([np.maximum(self.strikes[inside], start), [end]])
        return np.asarray(met - left)


def _within(
    time: Float[np.ndarray, " frame"], starts: Float[np.ndarray, " span"], ends: Float[np.ndarray, " span"]
) -> Bool[np.ndarray, " frame"]:
    return np.asarray(((time >= starts[:, None]) & (time <= ends[:, None])).any(axis=0))


def measured_steps(forces: FootForces) -> dict[str, Steps]:
    """Find the steps of each foot that were on its plates, by side.

    Parameters
    ----------
    forces
        Upward positive; in any unit.
    """
    threshold = max(ON_PLATE * float(forces.wrench[:, 4].max()), 0.0)
    return {side: _steps(forces.time, forces.vertical(side), threshold) for side in forces.sides}


def _steps(
    time: Float[np.ndarray, " sample"], vertical: Float[np.ndarray, " sample"], threshold: float
) -> Steps:
    on = without_short_runs(time, vertical > threshold, SHORTEST_PHASE)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    first, after = edges[::2], edges[1::2]
    whole = (first > 0) & (after < time.size)
    return Steps(time[first], time[np.minimum(after, time.size - 1)], whole)


def all_measured(time: Float[np.ndarray, " frame"], steps: Sequence[Steps]) -> Bool[np.ndarray, " frame"]:
    """Say when the plates measured all that the ground does, walking.

    Parameters
    ----------
    time
        s.
    steps
        Of one foot or both.
    """
    alone = np.any([foot.alone(time) for foot in steps], axis=0)
    if len(steps) < 2:
        return np.asarray(alone)
    return np.asarray(alone | np.all([foot.known(time) for foot in steps], axis=0))
