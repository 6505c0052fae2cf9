"""From EMG in volts to normalised envelopes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

#: Cut-off of the high-pass filter in Hz, which removes movement of the skin and the cables.
HIGH_PASS_HZ = 40.0
#: Cut-off of the low-pass filter times the gait period: slow and fast walking keep the same harmonics.
LOW_PASS_HARMONIC = 3.5
FILTER_ORDER = 4


def sampling_rate(time: Float[np.ndarray, " sample"]) -> float:
    """Measure the rate of a recording in Hz, by its median step."""
    return float(1.0 / np.median(np.diff(time)))


def even_samples(
    time: Float[np.ndarray, " sample"], values: Float[np.ndarray, "channel sample"]
) -> tuple[Float[np.ndarray, " even_sample"], Float[np.ndarray, "channel even_sample"]]:
    """Put a recording on an even time grid, as filters need.

    Times that are even but for rounding (less than a step off) are replaced by even ones; others are
    interpolated by a cubic spline at the median step.
    """
    even = np.linspace(time[0], time[-1], time.size)
    if np.abs(time - even).max() < even[1] - even[0]:
        return even, values
    count = round((time[-1] - time[0]) * sampling_rate(time)) + 1
    even = np.linspace(time[0], time[-1], count)
    return even, CubicSpline(time, values, axis=1)(even)


def envelopes_of_raw(
    volts: Float[np.ndarray, "channel sample"], rate: float, cycle_duration: float
) -> Float[np.ndarray, "channel sample"]:
    """Turn raw EMG into envelopes (Meyer et al. 2017): high-pass, demean, rectify, low-pass, clip at zero.

    Both filters are Butterworth filters of order 4 run forwards and backwards, so that nothing is delayed.
    The mean is taken along time, channel by channel.

    Parameters
    ----------
    volts
        Raw EMG, evenly sampled.
    rate
        Samples a second, above twice `HIGH_PASS_HZ`.
    cycle_duration
        Gait period in s; the low-pass cut-off is 3.5 over it.

    Returns
    -------
    Float[np.ndarray, "channel sample"]
        Envelopes in volts, not negative, not yet normalised.
    """
    high_pass = butter(FILTER_ORDER, HIGH_PASS_HZ, "highpass", fs=rate, output="sos")
    low_pass = butter(FILTER_ORDER, LOW_PASS_HARMONIC / cycle_duration, "lowpass", fs=rate, output="sos")
    moving = sosfiltfilt(high_pass, volts, axis=1)
    rectified = np.abs(moving - moving.mean(axis=1, keepdims=True))
    return np.maximum(sosfiltfilt(low_pass, rectified, axis=1), 0.0)


def normalise(emg: Float[np.ndarray, "trial channel frame"]) -> Float[np.ndarray, "trial channel frame"]:
    """Divide each channel by its maximum over all trials and frames; that maximum must be positive."""
    return emg / emg.max(axis=(0, 2))[None, :, None]
