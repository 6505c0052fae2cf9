"""The map of the gap: how large an error repeats from cycle to cycle, by speed, coordinate and phase.

The mean error of a few cycles holds noise as well. Taken away bin by bin, noise leaves zeros where chance was
on its side and too much elsewhere. So the size of what repeats is estimated for a coordinate as a whole, and
the map says how it is shared out over the cycle.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from wrapjax.gap.where.budget import binned

#: How far a speed's mean error is drawn towards that of all speeds: what is amiss at one is mostly amiss at
#: the others, and their noise is another.
TOWARDS_ALL = 0.3


def gap_map(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    noise: Float[np.ndarray, "speed coordinate frame"],
) -> Float[np.ndarray, "speed coordinate bin"]:
    """Estimate the root mean square over each bin of the error that repeats at a speed, N m.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m, of cycles that the fit has not seen.
    speeds
        Which speed each cycle was walked at, counted from 0.
    noise
        Variance between cycles that no input makes, (N m)^2. What errors of inputs make of the mean is part
        of the map: it is in the prediction, and repeats with it.
    """
    counts = np.bincount(speeds)
    own = np.stack([residuals[speeds == speed].mean(axis=0) for speed in range(len(counts))])
    drawn = (1.0 - TOWARDS_ALL) * own + TOWARDS_ALL * own.mean(axis=0)
    wanted = binned(own**2 - noise / counts[:, None, None]).sum(axis=(0, 2), keepdims=True)
    shape = binned(drawn**2)
    whole = shape.sum(axis=(0, 2), keepdims=True)
    repeats = shape * np.maximum(wanted, 0.0) / np.where(whole > 0.0, whole, 1.0)
    # Drawn towards other speeds, a part could come out larger than the whole.
    squares = np.stack([np.mean(residuals[speeds == speed] ** 2, axis=0) for speed in range(len(counts))])
    return np.sqrt(np.minimum(repeats, binned(squares)))
