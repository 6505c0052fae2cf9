"""The low-pass filter of motion and forces, and axes of laboratories."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfiltfilt

#: Cut-off of motion and forces times the gait period (Ao, Fregly et al.).
MOTION_HARMONIC = 7.0
#: Run forwards and backwards, so that nothing is delayed, this makes the fourth order of gait laboratories.
FILTER_ORDER = 2


def low_pass(
    time: Float[np.ndarray, " frame"], values: Float[np.ndarray, "channel frame"], cutoff_hz: float
) -> Float[np.ndarray, "channel frame"]:
    """Filter low-pass by a zero-lag Butterworth filter of fourth order in all.

    Parameters
    ----------
    time
        s, even.
    values
        Anything, finite.
    cutoff_hz
        Hz; at or above half the rate nothing is filtered.
    """
    rate = (time.size - 1) / (time[-1] - time[0])
    if cutoff_hz >= 0.5 * rate:
        return values
    sections = butter(FILTER_ORDER, cutoff_hz, "lowpass", fs=rate, output="sos")
    # Mirrored beyond both ends by a whole period of the cut-off: forces begin and end in mid-step.
    padding = min(round(rate / cutoff_hz), time.size - 1)
    return sosfiltfilt(sections, values, axis=1, padlen=padding)


def laboratory_axes(forward: str, up: str) -> Float[np.ndarray, "3 3"]:
    """Give the rotation from a laboratory's axes to OpenSim's: x forward, y up, z to the right.

    Parameters
    ----------
    forward, up
        ``x``, ``-x``, ``y``, ``-y``, ``z`` or ``-z`` of the laboratory, two different axes.

    Returns
    -------
    Float[np.ndarray, "3 3"]
        Multiplies columns of laboratory coordinates.
    """
    ahead, above = (_axis(name) for name in (forward, up))
    return np.array([ahead, above, np.cross(ahead, above)])


def _axis(name: str) -> Float[np.ndarray, " 3"]:
    axis = np.zeros(3)
    axis["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return axis
