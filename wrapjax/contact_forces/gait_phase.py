"""Where in the gait cycle frames are, counted from the strikes of the foot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

#: A cycle that is listed so near to a strike of the recorded force, in s, begins with the strike. Forces are
#: recorded late by their threshold, and where they were filtered low-pass early, by some 20 ms.
AT_STRIKE = 0.03


def uniform_phases(frames: int) -> Float[np.ndarray, " frame"]:
    """Give the phase of cycles that begin and end with a strike, %."""
    return np.linspace(0.0, 100.0, frames)


def gait_phases(
    time: Float[np.ndarray, "trial frame"], strikes: Sequence[Float[np.ndarray, " _"]]
) -> Float[np.ndarray, "trial frame"]:
    """Count the frames of a leg's cycles from the strikes of its foot, all cycles in the same way.

    Where all cycles begin and end at strikes, they were listed by them, and the list is taken as it is:
    forces that were filtered rise too early. Where any does not, each is counted by recorded strikes.

    Parameters
    ----------
    time
        s.
    strikes
        By cycle, when the foot met the ground in its recording, s, in order; none where that is not known.

    Returns
    -------
    array
        %, rising by 100 from strike to strike, and from less than 100 on. Cycles without strikes are
        counted as the others are on average; evenly, where nothing is known of any.
    """
    count, frames = time.shape
    known = [row for row in range(count) if strikes[row].size]
    if all(_is_from_strike_to_strike(time[row], strikes[row]) for row in known):
        return np.tile(uniform_phases(frames), (count, 1))
    counted = {row: phase_from_strikes(time[row], strikes[row]) for row in known}
    usual = _mean_phase(np.array(list(counted.values())))
    return np.array([counted.get(row, usual) for row in range(count)])


def phase_from_strikes(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> Float[np.ndarray, " frame"]:
    """Count each frame from the strike before it, in % of the time to the next one.

    Parameters
    ----------
    time
        Of a cycle, s.
    strikes
        When the foot meets the ground, s, in order; one at least. Before the first and after the last the
        foot goes on as it did: strides last as long as the median one, or as the cycle where there is none.

    Returns
    -------
    array
        From 0 on, and beyond 100 in a cycle that goes on past a strike, so that it rises throughout.
    """
    step = (time[-1] - time[0]) / (time.size - 1)
    every = _continued(time, strikes)
    passed = np.interp(time, every, 100.0 * np.arange(every.size))
    # A cycle that was cut at a strike begins there, on whichever side of it its first frame is.
    began = np.floor((passed[0] + 100.0 * step / np.diff(every).mean()) / 100.0)
    return np.maximum(passed - 100.0 * began, 0.0)


def _continued(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> Float[np.ndarray, " continued"]:
    """Go on with strikes to either side, until one lies well before and one well after all frames."""
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
    """Say whether a cycle begins at a strike and ends at the next one."""
    every = _continued(time, strikes)
    first = int(np.abs(every - time[0]).argmin())
    return first + 1 < every.size and bool(
        (np.abs(every[first : first + 2] - time[[0, -1]]) <= AT_STRIKE).all()
    )


def _mean_phase(phases: Float[np.ndarray, "trial frame"]) -> Float[np.ndarray, " frame"]:
    """Average phases, of which 99 and 1 % are near one another."""
    turned = np.exp(2j * np.pi * phases[:, 0] / 100.0).mean()
    start = np.angle(turned) / (2.0 * np.pi) * 100.0 % 100.0
    return start + (phases - phases[:, :1]).mean(axis=0)
