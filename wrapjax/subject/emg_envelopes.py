"""EMG envelopes: resampling to even times, filters of raw EMG, and normalisation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

#: Cut-off frequency of the high-pass filter, Hz, which removes movement artifacts.
HIGH_PASS_HZ = 40.0
#: Cut-off frequency of the low-pass filter times the gait period, so that the same harmonics pass at all
#: speeds.
LOW_PASS_HARMONIC = 3.5
#: Cut-off frequency of the low-pass filter of tasks other than gait, Hz.
LOW_PASS_HZ = 6.0
#: Order of both Butterworth filters, before they are run forwards and backwards.
FILTER_ORDER = 4


def sampling_rate(time: Float[np.ndarray, " sample"]) -> float:
    """Compute the sampling rate of a recording in Hz from the median time step."""
    return float(1.0 / np.median(np.diff(time)))


def resample_evenly(
    time: Float[np.ndarray, " sample"], values: Float[np.ndarray, "channel sample"]
) -> tuple[Float[np.ndarray, " even_sample"], Float[np.ndarray, "channel even_sample"]]:
    """Resample a recording to evenly spaced times, as filters require.

    Times that deviate from an even grid by less than a step (rounding) are replaced by the grid and the
    values are kept. Otherwise the values are interpolated by a cubic spline at the median time step.

    Returns
    -------
    time, values
        Even times, s, and values at these times.
    """
    even = np.linspace(time[0], time[-1], time.size)
    if np.abs(time - even).max() < even[1] - even[0]:
        return even, values
    count = round((time[-1] - time[0]) * sampling_rate(time)) + 1
    even = np.linspace(time[0], time[-1], count)
    return even, CubicSpline(time, values, axis=1)(even)


def compute_envelopes(
    volts: Float[np.ndarray, "channel sample"], rate: float, cycle_duration: float
) -> Float[np.ndarray, "channel sample"]:
    """Compute envelopes of the raw EMG of gait; see `envelopes_below`.

    Parameters
    ----------
    volts
        Raw EMG in V, evenly sampled.
    rate
        Sampling rate in Hz, above twice `HIGH_PASS_HZ`.
    cycle_duration
        Gait period in s; the low-pass cut-off frequency is `LOW_PASS_HARMONIC` over it.

    Returns
    -------
    Float[np.ndarray, "channel sample"]
        Envelopes in V, not negative, not normalised.
    """
    return envelopes_below(volts, rate, LOW_PASS_HARMONIC / cycle_duration)


def envelopes_below(
    volts: Float[np.ndarray, "channel sample"], rate: float, cutoff: float
) -> Float[np.ndarray, "channel sample"]:
    """Compute envelopes of raw EMG: high-pass filter, subtract mean, rectify, low-pass filter, clip at zero.

    Method of Meyer et al. (2017). Both filters are zero-lag: Butterworth filters of order 4 run forwards and
    backwards. The mean of each channel is taken over time.

    Parameters
    ----------
    volts
        Raw EMG in V, evenly sampled.
    rate
        Sampling rate in Hz, above twice `HIGH_PASS_HZ`.
    cutoff
        Cut-off frequency of the low-pass filter in Hz.

    Returns
    -------
    Float[np.ndarray, "channel sample"]
        Envelopes in V, not negative, not normalised.
    """
    high_pass = butter(FILTER_ORDER, HIGH_PASS_HZ, "highpass", fs=rate, output="sos")
    low_pass = butter(FILTER_ORDER, cutoff, "lowpass", fs=rate, output="sos")
    filtered = sosfiltfilt(high_pass, volts, axis=1)
    rectified = np.abs(filtered - filtered.mean(axis=1, keepdims=True))
    return np.maximum(sosfiltfilt(low_pass, rectified, axis=1), 0.0)


def normalise(
    emg: Float[np.ndarray, "trial channel frame"], maxima: Float[np.ndarray, " channel"] | None = None
) -> Float[np.ndarray, "trial channel frame"]:
    """Divide each channel by an envelope, by its maximum over all trials and frames if none is given.

    The divisors must be positive.
    """
    return emg / (emg.max(axis=(0, 2)) if maxima is None else maxima)[None, :, None]
