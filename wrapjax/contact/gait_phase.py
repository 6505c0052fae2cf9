"""Where in the gait cycle frames are, counted from the strikes of the foot."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def evenly(frames: int) -> Float[np.ndarray, " frame"]:
    """Give the phase of cycles that begin and end with a strike, %."""
    return np.linspace(0.0, 100.0, frames)


def phase_from_strikes(
    time: Float[np.ndarray, " frame"], strikes: Float[np.ndarray, " strike"]
) -> Float[np.ndarray, " frame"] | None:
    """Count each frame from the strike before it, in % of the time to the next one.

    Parameters
    ----------
    time
        s.
    strikes
        When the foot meets the ground, s, in order.

    Returns
    -------
    array or None
        From 0 on, and beyond 100 in a cycle that goes on past a strike, so that it rises throughout. None
        where the recording does not have the strikes before and after all frames.
    """
    step = (time[-1] - time[0]) / (time.size - 1)
    if strikes.size < 2 or time[0] < strikes[0] - step or time[-1] > strikes[-1] + step:
        return None
    passed = np.interp(time, strikes, 100.0 * np.arange(strikes.size))
    # A cycle that was cut at a strike begins there, on whichever side of it its first frame is.
    began = np.floor((passed[0] + 100.0 * step / np.diff(strikes).mean()) / 100.0)
    return np.maximum(passed - 100.0 * began, 0.0)
