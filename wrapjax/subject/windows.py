"""Windows of equal frames that cover intervals of tasks other than gait, on the intervals' own time."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool

from wrapjax.subject.trials import FRAMES, TIME_TOLERANCE

#: Time between the frames of a window, s.
WINDOW_STEP = 0.01
#: Duration of a window, s: it has as many frames as a gait cycle.
WINDOW_SECONDS = (FRAMES - 1) * WINDOW_STEP
#: EMG before each window, s. Activation begins from rest there. Deactivation takes at most 0.14 s a time
#: constant (35 ms, four times as slow as activation) and the delay is 0.125 s at most, so that less than
#: a millionth of the start is left when the window begins.
SETTLING_SECONDS = 2.2


def window_limits(interval: tuple[float, float]) -> list[tuple[float, float]]:
    """Compute the start and end of each window that covers an interval, s.

    Windows follow each other from the start of the interval; the last one ends with it, and so overlaps the
    one before. The only window of an interval shorter than a window extends beyond its end.
    """
    start, end = interval
    count = max(math.ceil((end - start - TIME_TOLERANCE) / WINDOW_SECONDS), 1)
    first = [start + number * WINDOW_SECONDS for number in range(count)]
    if count > 1:
        first[-1] = end - WINDOW_SECONDS
    return [(begin, begin + WINDOW_SECONDS) for begin in first]


def counted_frames(interval: tuple[float, float]) -> Bool[np.ndarray, "trial frame"]:
    """Mark the frames of the windows of an interval that lie in it and in no earlier window."""
    counted = []
    covered = interval[0] - WINDOW_STEP
    for begin, end in window_limits(interval):
        time = np.linspace(begin, end, FRAMES)
        inside = (time > covered + TIME_TOLERANCE) & (time <= interval[1] + TIME_TOLERANCE)
        counted.append(inside)
        covered = end
    return np.array(counted)
