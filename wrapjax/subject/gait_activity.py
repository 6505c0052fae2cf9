"""Usual phases of activity of leg muscles in walking, and pairs of channels that have each other's.

Two channels that were exchanged in all recordings cannot be found by comparing recordings with each other,
and hardly by moments, to which a calibration adapts. Their envelopes have the other's phases of activity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from wrapjax.subject.muscle_groups import standard_name

_VASTI = ((89.0, 116.0),)
_GASTROCNEMIUS = ((9.0, 50.0),)
_MEDIAL_HAMSTRINGS = ((77.0, 108.0),)
_GLUTEUS_MEDIUS = ((94.0, 129.0),)

#: First and last phase of activity, in percent of the gait cycle from foot strike; beyond 100, in the next
#: cycle. Means of healthy adults (Perry & Burnfield 2010, Gait Analysis, ISBN 978-1-55642-766-4).
USUAL_ACTIVITY: Mapping[str, tuple[tuple[float, float], ...]] = {
    "tibant": ((56.0, 113.0),),
    "edl": ((57.0, 112.0),),
    "ehl": ((58.0, 111.0),),
    "soleus": ((7.0, 52.0),),
    "gasmed": _GASTROCNEMIUS,
    "gaslat": _GASTROCNEMIUS,
    "tibpost": ((0.0, 54.0),),
    "fdl": ((13.0, 54.0),),
    "fhl": ((25.0, 53.0),),
    "perlong": ((18.0, 51.0),),
    "perbrev": ((21.0, 51.0),),
    "vaslat": _VASTI,
    "vasmed": _VASTI,
    "vasint": _VASTI,
    "recfem": ((56.0, 63.0), *_VASTI),
    "bflh": ((81.0, 108.0),),
    "semimem": _MEDIAL_HAMSTRINGS,
    "semiten": _MEDIAL_HAMSTRINGS,
    "glmax1": ((91.0, 124.0),),
    "glmax2": ((91.0, 112.0),),
    "glmax3": ((91.0, 110.0),),
    **{f"gl{part}{number}": _GLUTEUS_MEDIUS for part in ("med", "min") for number in "123"},
}

#: Width of the onset and end of activity, in percent of the gait cycle.
_ONSET_WIDTH = 5.0
#: Gain in correlation, summed over both channels, above which a pair counts as possibly exchanged. In three
#: untouched recordings of walking no pair gains more than 0.34; channels exchanged on purpose gain 1.2 and
#: 1.6. The limit was chosen on these recordings, in the middle of a wide gap.
EXCHANGE_GAIN = 0.7


def usual_envelope(muscles: Sequence[str], frames: int) -> Float[np.ndarray, " frame"] | None:
    """Return the usual envelope of a channel over a gait cycle, between 0 and 1.

    Parameters
    ----------
    muscles
        Names of the muscles that the channel drives, with side.
    frames
        Number of frames, the first and the last at foot strike.

    Returns
    -------
    envelope
        Mean over the muscles whose usual activity is known; None if that of none is.
    """
    phase = np.linspace(0.0, 100.0, frames)
    envelopes = []
    for name in dict.fromkeys(map(standard_name, muscles)):
        if name not in USUAL_ACTIVITY:
            continue
        envelope = np.zeros(frames)
        for first, last in USUAL_ACTIVITY[name]:
            for cycle in (-100.0, 0.0, 100.0):
                rise, fall = (np.tanh((phase - at - cycle) / _ONSET_WIDTH) for at in (first, last))
                envelope += 0.5 * (rise - fall)
        envelopes.append(envelope)
    return np.mean(envelopes, axis=0) if envelopes else None


def exchanged_channels(
    envelopes: Mapping[str, Float[np.ndarray, " frame"]], muscles: Mapping[str, Sequence[str]]
) -> dict[tuple[str, str], float]:
    """Find pairs of channels whose envelopes fit each other's usual activity better than their own.

    Parameters
    ----------
    envelopes
        Typical envelope over a gait cycle, by channel, in any unit; the first and the last frame are at foot
        strike.
    muscles
        Names of the muscles that each channel drives.

    Returns
    -------
    pairs
        Pairs of channels, in their order, whose correlation with the usual envelopes, summed over both, is
        larger by more than `EXCHANGE_GAIN` if they are exchanged; with that gain.
    """
    usual = {
        name: own
        for name, envelope in envelopes.items()
        if (own := usual_envelope(muscles[name], len(envelope))) is not None and np.ptp(envelope) > 0.0
    }

    def correlation(recorded: str, expected: str) -> float:
        return float(np.corrcoef(envelopes[recorded], usual[expected])[0, 1])

    gains = {
        (first, second): (
            correlation(first, second)
            + correlation(second, first)
            - correlation(first, first)
            - correlation(second, second)
        )
        for first, second in combinations(usual, 2)
    }
    return {pair: gain for pair, gain in gains.items() if gain > EXCHANGE_GAIN}
