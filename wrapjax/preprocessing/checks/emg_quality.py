"""Detection of faulty EMG channels: no signal, clipped, duplicate, wrong unit, rectified or smoothed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import butter, sosfiltfilt, welch

from wrapjax.subject.emg_envelopes import HIGH_PASS_HZ
from wrapjax.subject.recordings import MAX_ENVELOPE

#: A channel whose amplitude above `HIGH_PASS_HZ` is below this share of the median channel's has no signal.
MIN_LEVEL_SHARE = 0.01
#: Limits of the root mean square of raw EMG above `HIGH_PASS_HZ` at the electrode, V. The noise of good
#: amplifiers is near 1 uV; surface EMG peaks at about 5 mV (De Luca 1997, doi:10.1123/jab.13.2.135).
MIN_VOLTS, MAX_VOLTS = 3e-7, 5e-3
#: A channel is clipped if it has at least this many runs of at least so many equal samples at its extreme.
MIN_CLIPPED_SAMPLES, MIN_CLIPPED_RUNS = 3, 3
#: Correlation above which two channels are duplicates.
DUPLICATE_CORRELATION = 0.999
#: Largest share of samples equal to the one before; a channel above it was held constant or filled in.
MAX_EQUAL_SHARE = 0.5
#: Smallest share of the power of raw EMG above `HIGH_PASS_HZ`; movement artifacts may have the rest.
MIN_HIGH_FREQUENCY_SHARE = 0.02
#: Largest factor between the amplitude of a channel and that of the median channel in the same unit.
MAX_LEVEL_RATIO = 100.0


def emg_faults(
    channels: Sequence[str], volts: Float[np.ndarray, "channel sample"], rate: float
) -> Iterator[tuple[str, str, str]]:
    """Find channels that are not valid raw EMG.

    Parameters
    ----------
    channels
        Names of the channels.
    volts
        Raw EMG at the electrode, V, evenly sampled.
    rate
        Sampling rate, Hz, above twice `HIGH_PASS_HZ`.

    Yields
    ------
    channel, message, hint
        Name of the channel, expected and actual signal, and a suggested correction. Only the most specific
        fault of a channel is reported.
    """
    sections = butter(4, HIGH_PASS_HZ, "highpass", fs=rate, output="sos")
    fast = sosfiltfilt(sections, volts, axis=1)
    level = np.sqrt(np.mean(fast**2, axis=1))
    alive = ~np.array([_is_flat(row) for row in volts])
    median_level = float(np.median(level[alive])) if alive.any() else 0.0
    correlation = _correlate(fast, alive)
    for row, name in enumerate(channels):
        fault = (
            _constant(volts[row])
            or _processed(volts[row], rate)
            or _clipped(volts[row])
            or _stuck(volts[row])
            or _quiet(level[row], median_level)
            or _duplicate(row, correlation, channels)
            or _wrong_unit(level[row], median_level)
        )
        if fault:
            yield (name, *fault)


def envelope_faults(
    channels: Sequence[str], envelopes: Float[np.ndarray, "channel sample"]
) -> Iterator[tuple[str, str, str]]:
    """Find channels that are not valid envelopes.

    Parameters
    ----------
    channels
        Names of the channels.
    envelopes
        Envelopes normalised to about 1, dimensionless.

    Yields
    ------
    channel, message, hint
        As `emg_faults`.
    """
    centered = envelopes - envelopes.mean(axis=1, keepdims=True)
    correlation = _correlate(centered, np.ptp(envelopes, axis=1) > 0.0)
    for row, name in enumerate(channels):
        fault = (
            _constant(envelopes[row], "")
            or _fault_unless_envelope(envelopes[row])
            or _duplicate(row, correlation, channels)
        )
        if fault:
            yield (name, *fault)


#: Message and hint of a fault, None if there is none.
Fault = tuple[str, str] | None


def _is_flat(signal: Float[np.ndarray, " sample"]) -> bool:
    return float(np.mean(np.diff(signal) == 0.0)) > MAX_EQUAL_SHARE


def _constant(signal: Float[np.ndarray, " sample"], unit: str = " V") -> Fault:
    if np.ptp(signal) == 0.0:
        return f"is dead: expected EMG, found {signal[0]:.3g}{unit} throughout", _LEAVE_OUT
    return None


def _fault_unless_envelope(signal: Float[np.ndarray, " sample"]) -> Fault:
    low, peak = float(signal.min()), float(signal.max())
    # The undershoot of filters is small; raw EMG is symmetric about zero.
    if low < -0.5 * peak:
        return f"is raw: expected an envelope, found values from {low:.3g} to {peak:.3g}", _IS_RAW
    if peak > MAX_ENVELOPE:
        message = (
            f"is in another unit: expected an envelope normalised to about 1, found a peak of {peak:.4g}"
        )
        return message, "divide each channel by its maximum"
    return None


def _stuck(signal: Float[np.ndarray, " sample"]) -> Fault:
    if _is_flat(signal):
        share = float(np.mean(np.diff(signal) == 0.0))
        return f"is dead: expected EMG, found {share:.0%} of samples equal to the one before", _LEAVE_OUT
    return None


def _quiet(level: float, median_level: float) -> Fault:
    if level < MIN_LEVEL_SHARE * median_level and level < MIN_VOLTS:
        found = f"found {level:.2g} V (root mean square above {HIGH_PASS_HZ:g} Hz)"
        return f"is dead: {found}, where the median channel has {median_level:.2g} V", _LEAVE_OUT
    return None


def _processed(signal: Float[np.ndarray, " sample"], rate: float) -> Fault:
    if signal.min() >= 0.0:
        message = "is rectified: expected raw EMG of both signs, found no negative sample"
        return message, _IS_ENVELOPE
    frequency, power = welch(signal, rate, nperseg=min(signal.size, int(rate)))
    share = float(power[frequency > HIGH_PASS_HZ].sum() / power.sum())
    if share < MIN_HIGH_FREQUENCY_SHARE:
        message = f"is smoothed: expected raw EMG, found {share:.1%} of its power above {HIGH_PASS_HZ:g} Hz"
        return message, f"{_IS_ENVELOPE}; otherwise check for movement artifacts of cables"
    return None


def _clipped(signal: Float[np.ndarray, " sample"]) -> Fault:
    for side, extreme in (("highest", signal.max()), ("lowest", signal.min())):
        runs = _runs(signal == extreme)
        long = runs[runs >= MIN_CLIPPED_SAMPLES]
        if long.size >= MIN_CLIPPED_RUNS:
            found = f"found it {long.size} times constant at its {side} value, {extreme:.3g} V"
            message = f"is clipped (saturated): {found}, for up to {long.max()} samples"
            return message, "lower the amplifier's gain; " + _LEAVE_OUT
    return None


def _runs(on: Bool[np.ndarray, " sample"]) -> np.ndarray:
    """Compute the lengths of all runs of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return edges[1::2] - edges[::2]


def _correlate(
    signals: Float[np.ndarray, "channel sample"], alive: Bool[np.ndarray, " channel"]
) -> np.ndarray:
    """Compute the correlations between channels without a mean; zero for channels without a signal."""
    norm = np.linalg.norm(signals, axis=1)
    scaled = np.where(alive[:, None], signals, 0.0) / np.where(norm > 0.0, norm, 1.0)[:, None]
    return scaled @ scaled.T


def _duplicate(row: int, correlation: Float[np.ndarray, "channel channel"], channels: Sequence[str]) -> Fault:
    high = np.abs(correlation[row]) > DUPLICATE_CORRELATION
    duplicates = [index for index in np.flatnonzero(high) if index != row]
    if not duplicates:
        return None
    other = int(duplicates[0])
    kind = "is a duplicate of" if correlation[row, other] > 0.0 else "is the inverse of"
    return f"{kind} '{channels[other]}': their correlation is {correlation[row, other]:.4f}", _LEAVE_OUT


def _wrong_unit(level: float, median_level: float) -> Fault:
    found = f"found {level:.2g} V (root mean square above {HIGH_PASS_HZ:g} Hz)"
    if not MIN_VOLTS <= level <= MAX_VOLTS:
        expected = f"expected {MIN_VOLTS:.1g} to {MAX_VOLTS:.1g} V at the electrode"
        hint = 'is it in "mV" or "uV", or amplified? Write unit and gain in [emg]'
        return f"is in another unit: {expected}, {found}", hint
    if not 1.0 / MAX_LEVEL_RATIO <= level / median_level <= MAX_LEVEL_RATIO:
        message = f"is in another unit than the others: {found}, where the median channel has"
        return f"{message} {median_level:.2g} V", "are all channels in the same unit and amplified alike?"
    return None


_IS_ENVELOPE = 'are these envelopes? Then write kind = "envelope" in [emg], in place of unit and gain'
_IS_RAW = 'is this raw EMG? Then write unit in [emg], in place of kind = "envelope"'
_LEAVE_OUT = "leave it out of [emg.channels], or name it in accept"
