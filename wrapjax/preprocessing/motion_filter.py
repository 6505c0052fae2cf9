"""Low-pass filter of markers, joint angles and ground reaction forces (for EMG: `wrapjax.subject.emg`)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfiltfilt

#: Cut-off frequency of motion and forces times the gait period (Ao, Fregly et al.).
MOTION_HARMONIC = 7.0
#: Order of the Butterworth filter. Run forwards and backwards (zero lag) it has the fourth order that is
#: usual in gait laboratories.
FILTER_ORDER = 2


def low_pass(
    time: Float[np.ndarray, " frame"], values: Float[np.ndarray, "channel frame"], cutoff_hz: float
) -> Float[np.ndarray, "channel frame"]:
    """Filter signals by a zero-lag low-pass Butterworth filter of fourth order.

    Parameters
    ----------
    time
        Times, s, evenly spaced.
    values
        Finite values of each channel.
    cutoff_hz
        Cut-off frequency, Hz. At or above half the sampling rate, the values are returned unchanged.

    Returns
    -------
    Float[np.ndarray, "channel frame"]
        Filtered values.
    """
    rate = (time.size - 1) / (time[-1] - time[0])
    if cutoff_hz >= 0.5 * rate:
        return values
    sections = butter(FILTER_ORDER, cutoff_hz, "lowpass", fs=rate, output="sos")
    # Signals are extended at both ends by a period of the cut-off frequency, as forces can start in
    # mid-stance.
    padding = min(round(rate / cutoff_hz), time.size - 1)
    return sosfiltfilt(sections, values, axis=1, padlen=padding)
