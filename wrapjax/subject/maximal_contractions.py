"""Envelopes of maximal voluntary contractions, which normalise raw EMG in place of the trials' own maxima."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.storage import Storage
from wrapjax.subject.emg_envelopes import LOW_PASS_HZ, envelopes_below, resample_evenly
from wrapjax.subject.recordings import MIN_RAW_EMG_RATE

#: A channel whose envelope in a trial exceeds that of its maximal contraction by this factor is named.
MOST_ABOVE = 1.2


def read_maxima(
    channels: tuple[str, ...],
    files: tuple[Path, ...],
    read: Callable[[Path], Storage],
    problems: list[Problem],
) -> Float[np.ndarray, " channel"] | None:
    """Compute the largest envelope of each channel over recordings of maximal contractions.

    Envelopes are those of trials other than gait: zero-phase low-pass filter at 6 Hz.

    Parameters
    ----------
    channels
        EMG channels, which each file must have as columns.
    files
        Recordings of raw EMG, in the unit of the trials; each may be of some muscles' contractions.
    read
        Function that reads a table.
    problems
        List to which faults are added.

    Returns
    -------
    Float[np.ndarray, " channel"] or None
        Maxima in the unit of the EMG; None if there are no files, or with faults.
    """
    peaks = []
    for file in files:
        try:
            table = read(file)
        except InputError as error:
            problems.extend(error.problems)
            continue
        missing = [name for name in channels if name not in table.columns]
        problems += [
            Problem(str(file), "is not in the file", f"column {name}", nearest_name(name, table.columns))
            for name in missing
        ]
        rate = (table.time.size - 1) / (table.time[-1] - table.time[0])
        if rate < MIN_RAW_EMG_RATE:
            message = f"expected raw EMG at {MIN_RAW_EMG_RATE:g} Hz or more, found {rate:.4g} Hz"
            problems.append(Problem(str(file), message))
        if missing or rate < MIN_RAW_EMG_RATE:
            continue
        columns = [table.columns.index(name) for name in channels]
        time, volts = resample_evenly(table.time, table.values.T[columns])
        even_rate = (time.size - 1) / (time[-1] - time[0])
        peaks.append(envelopes_below(volts, even_rate, LOW_PASS_HZ).max(axis=1))
    if not peaks or len(peaks) < len(files):
        return None
    largest = np.max(peaks, axis=0)
    silent = [name for name, peak in zip(channels, largest, strict=True) if peak <= 0.0]
    problems += [
        Problem(", ".join(map(str, files)), "expected EMG, found none in any contraction", f"column {name}")
        for name in silent
    ]
    return None if silent else largest


def notes_on_maxima(
    channels: tuple[str, ...], peaks: Float[np.ndarray, " channel"], maxima: Float[np.ndarray, " channel"]
) -> list[str]:
    """Name channels that exceed their maximal contraction in a trial: it was not maximal."""
    return [
        f"channel '{channel}' reaches {ratio:.2g} times the envelope of its maximal contraction"
        for channel, ratio in zip(channels, peaks / maxima, strict=True)
        if ratio > MOST_ABOVE
    ]
