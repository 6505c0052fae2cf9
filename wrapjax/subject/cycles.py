"""From a recording of any rate to gait cycles of equally many frames."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.subject.trials import FRAMES

#: Seconds of EMG kept before and after each cycle, so that it can be delayed electromechanically.
PADDING_SECONDS = 0.2
#: Frames beside a cycle come in multiples of this: people who walk at other paces then share compiled code.
PADDING_STEP = 10
#: A cycle may reach beyond the recording by this much, in s: times are often printed with few digits.
TIME_TOLERANCE = 1e-5


def padding_frames(cycles: list[tuple[float, float]]) -> int:
    """Count the frames to add on each side of every cycle: `PADDING_SECONDS` of the shortest, or more."""
    shortest = min(end - start for start, end in cycles)
    # A cycle from 0.07 to 0.57 s lasts 0.49999999999999994 s, which must not cost more frames.
    frames = math.ceil(PADDING_SECONDS / (shortest / (FRAMES - 1)) - 1e-9)
    return PADDING_STEP * math.ceil(frames / PADDING_STEP)


def cycle_times(cycles: list[tuple[float, float]], padding: int = 0) -> Float[np.ndarray, "trial frame"]:
    """Space frames evenly over each cycle, and as many as ``padding`` beyond either end at the same step.

    Parameters
    ----------
    cycles
        Start and end of each cycle in s.
    padding
        Frames added before and after.

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
        Time of the samples in s, strictly increasing, not necessarily even.
    values
        The recording.
    at
        Wanted times in s. Before the first and after the last sample the edge value is held.

    Returns
    -------
    values, rates
        Interpolated values, and the spline's derivative by time.
    """
    spline = CubicSpline(time, values, axis=1, bc_type="not-a-knot")
    inside = np.clip(at, time[0], time[-1])
    return np.moveaxis(spline(inside), 1, 0), np.moveaxis(spline(inside, 1), 1, 0)
