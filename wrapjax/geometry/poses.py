"""Which poses a surrogate is trained and judged on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

#: Narrower belts are widened to this (rad): with a single recorded cycle a belt has no width at all,
#: and a polynomial fitted along one curve says nothing beside it.
MINIMUM_BELT_WIDTH = np.radians(5.0)


def walking_belt(
    angles: Float[np.ndarray, "trial coordinate frame"],
) -> tuple[Float[np.ndarray, "coordinate frame"], Float[np.ndarray, "coordinate frame"]]:
    """Find the lowest and highest angle of every coordinate at every frame, over all cycles.

    Parameters
    ----------
    angles
        In rad.

    Returns
    -------
    tuple of arrays
        Lower and upper edge in rad, at least `MINIMUM_BELT_WIDTH` apart.
    """
    lower, upper = angles.min(axis=0), angles.max(axis=0)
    missing = np.maximum(MINIMUM_BELT_WIDTH - (upper - lower), 0.0)
    return lower - 0.5 * missing, upper + 0.5 * missing


def random_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "pose coordinate"]:
    """Draw poses uniformly from the walking belt, the same number at every frame.

    The last frame repeats the first (heel strike to heel strike) and gets none.

    Parameters
    ----------
    angles
        In rad.
    count
        Number of poses; spread evenly over the frames.
    """
    lower, upper = walking_belt(angles)
    frames = angles.shape[-1] - 1
    frame = np.arange(count) * frames // count
    low, high = lower[:, frame].T, upper[:, frame].T
    return low + (high - low) * generator.random(low.shape)


def smooth_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], duration: Float[np.ndarray, " trial"]
) -> Float[np.ndarray, "pose coordinate"]:
    """Take the recorded poses of the shortest (fastest) cycle, its repeated last frame left out.

    Parameters
    ----------
    angles
        In rad.
    duration
        Of each cycle, in s.
    """
    return angles[int(np.argmin(duration)), :, :-1].T
