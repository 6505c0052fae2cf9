"""EMG channels that are none: dead, clipped, copies of each other, in another unit, processed or not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import butter, sosfiltfilt, welch

from wrapjax.subject.emg import HIGH_PASS_HZ
from wrapjax.subject.recordings import MOST_ENVELOPE

#: A channel with less than this share of the median channel's power of muscle (as amplitude) is dead.
DEAD_SHARE = 0.01
#: At the electrode raw EMG above `HIGH_PASS_HZ` has a root mean square between these, in V. Noise of good
#: amplifiers is near 1 uV; surface EMG peaks at about 5 mV (De Luca 1997, doi:10.1123/jab.13.2.135).
LEAST_VOLTS, MOST_VOLTS = 3e-7, 5e-3
#: Equal samples in a row at a channel's extreme, and how many such rows, that only clipping gives.
CLIPPED_RUN, CLIPPED_RUNS = 3, 3
#: Correlation from which two channels are one signal.
SAME = 0.999
#: Share of equal neighbours from which a channel was held or filled in.
STUCK_SHARE = 0.5
#: Raw EMG has at least this share of its power above `HIGH_PASS_HZ`; movement of cables may hold the rest.
LEAST_FAST_SHARE = 0.02
#: How far a channel's amplitude may be from the median channel's, as a factor, and be in the same unit.
MOST_RATIO = 100.0


def emg_faults(
    channels: Sequence[str], volts: Float[np.ndarray, "channel sample"], rate: float
) -> Iterator[tuple[str, str, str]]:
    """Name channels that are no raw EMG.

    Parameters
    ----------
    channels
        Names.
    volts
        At the electrode, evenly sampled.
    rate
        Samples a second, above twice `HIGH_PASS_HZ`.

    Yields
    ------
    channel, message, hint
        What was expected and found, and what may mend it; one fault a channel, the one that explains most.
    """
    sections = butter(4, HIGH_PASS_HZ, "highpass", fs=rate, output="sos")
    fast = sosfiltfilt(sections, volts, axis=1)
    level = np.sqrt(np.mean(fast**2, axis=1))
    alive = ~np.array([_is_flat(row) for row in volts])
    usual = float(np.median(level[alive])) if alive.any() else 0.0
    copies = _copies(fast, alive)
    for row, name in enumerate(channels):
        fault = (
            _constant(volts[row])
            or _processed(volts[row], rate)
            or _clipped(volts[row])
            or _stuck(volts[row])
            or _quiet(level[row], usual)
            or _copied(row, copies, channels)
            or _wrong_unit(level[row], usual)
        )
        if fault:
            yield (name, *fault)


def envelope_faults(
    channels: Sequence[str], envelopes: Float[np.ndarray, "channel sample"]
) -> Iterator[tuple[str, str, str]]:
    """Name channels that are no envelopes.

    Parameters
    ----------
    channels
        Names.
    envelopes
        Normalised to about 1, without unit.

    Yields
    ------
    channel, message, hint
        As `emg_faults`.
    """
    moving = envelopes - envelopes.mean(axis=1, keepdims=True)
    copies = _copies(moving, np.ptp(envelopes, axis=1) > 0.0)
    for row, name in enumerate(channels):
        fault = (
            _constant(envelopes[row], "") or _no_envelope(envelopes[row]) or _copied(row, copies, channels)
        )
        if fault:
            yield (name, *fault)


Fault = tuple[str, str] | None


def _is_flat(signal: Float[np.ndarray, " sample"]) -> bool:
    return float(np.mean(np.diff(signal) == 0.0)) > STUCK_SHARE


def _constant(signal: Float[np.ndarray, " sample"], unit: str = " V") -> Fault:
    if np.ptp(signal) == 0.0:
        return f"is dead: expected EMG, found {signal[0]:.3g}{unit} throughout", _LEAVE_OUT
    return None


def _no_envelope(signal: Float[np.ndarray, " sample"]) -> Fault:
    low, peak = float(signal.min()), float(signal.max())
    # What filters ring below zero is little; raw EMG goes as far down as up.
    if low < -0.5 * peak:
        return f"is raw: expected an envelope, found values from {low:.3g} to {peak:.3g}", _IS_RAW
    if peak > MOST_ENVELOPE:
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


def _quiet(level: float, usual: float) -> Fault:
    if level < DEAD_SHARE * usual and level < LEAST_VOLTS:
        found = f"found {level:.2g} V (root mean square above {HIGH_PASS_HZ:g} Hz)"
        return f"is dead: {found}, where the median channel has {usual:.2g} V", _LEAVE_OUT
    return None


def _processed(signal: Float[np.ndarray, " sample"], rate: float) -> Fault:
    if signal.min() >= 0.0:
        message = "is rectified: expected raw EMG of both signs, found no negative sample"
        return message, _IS_ENVELOPE
    frequency, power = welch(signal, rate, nperseg=min(signal.size, int(rate)))
    share = float(power[frequency > HIGH_PASS_HZ].sum() / power.sum())
    if share < LEAST_FAST_SHARE:
        message = f"is smoothed: expected raw EMG, found {share:.1%} of its power above {HIGH_PASS_HZ:g} Hz"
        return message, f"{_IS_ENVELOPE}; else look for movement of cables"
    return None


def _clipped(signal: Float[np.ndarray, " sample"]) -> Fault:
    for side, extreme in (("highest", signal.max()), ("lowest", signal.min())):
        runs = _runs(signal == extreme)
        long = runs[runs >= CLIPPED_RUN]
        if long.size >= CLIPPED_RUNS:
            found = f"found it {long.size} times held at its {side} value, {extreme:.3g} V"
            message = f"is clipped (saturated): {found}, for up to {long.max()} samples"
            return message, "lower the amplifier's gain; " + _LEAVE_OUT
    return None


def _runs(on: Bool[np.ndarray, " sample"]) -> np.ndarray:
    """Lengths of all runs of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return edges[1::2] - edges[::2]


def _copies(fast: Float[np.ndarray, "channel sample"], alive: Bool[np.ndarray, " channel"]) -> np.ndarray:
    """Correlate channels; zero for those that are flat."""
    norm = np.linalg.norm(fast, axis=1)
    scaled = np.where(alive[:, None], fast, 0.0) / np.where(norm > 0.0, norm, 1.0)[:, None]
    return scaled @ scaled.T


def _copied(row: int, copies: Float[np.ndarray, "channel channel"], channels: Sequence[str]) -> Fault:
    same = [place for place in np.flatnonzero(np.abs(copies[row]) > SAME) if place != row]
    if not same:
        return None
    other = int(same[0])
    kind = "is a duplicate of" if copies[row, other] > 0.0 else "is the reverse of"
    return f"{kind} '{channels[other]}': their correlation is {copies[row, other]:.4f}", _LEAVE_OUT


def _wrong_unit(level: float, usual: float) -> Fault:
    found = f"found {level:.2g} V (root mean square above {HIGH_PASS_HZ:g} Hz)"
    if not LEAST_VOLTS <= level <= MOST_VOLTS:
        expected = f"expected {LEAST_VOLTS:.1g} to {MOST_VOLTS:.1g} V at the electrode"
        hint = 'is it in "mV" or "uV", or amplified? Write unit and gain in [emg]'
        return f"is in another unit: {expected}, {found}", hint
    if not 1.0 / MOST_RATIO <= level / usual <= MOST_RATIO:
        message = f"is in another unit than the others: {found}, where the median channel has {usual:.2g} V"
        return message, "are all channels in the same unit and amplified alike?"
    return None


_IS_ENVELOPE = 'are these envelopes? Then write kind = "envelope" in [emg], in place of unit and gain'
_IS_RAW = 'is this raw EMG? Then write unit in [emg], in place of kind = "envelope"'
_LEAVE_OUT = "leave it out of [emg.channels], or name it in accept"
