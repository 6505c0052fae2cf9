"""Errors of joint moments by coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class MomentErrors:
    """Errors of the joint moments of one gait cycle by coordinate, N m."""

    mean_absolute: Float[np.ndarray, " coordinate"]
    root_mean_square: Float[np.ndarray, " coordinate"]


def moment_errors(
    measured: Float[np.ndarray, "coordinate frame"], modelled: Float[np.ndarray, "coordinate frame"]
) -> MomentErrors:
    """Compute the errors of modelled moments (N m) over the frames of one cycle."""
    error = modelled - measured
    return MomentErrors(np.abs(error).mean(axis=-1), np.sqrt((error**2).mean(axis=-1)))


def pooled_mae(errors: Sequence[MomentErrors], coordinates: Sequence[str]) -> dict[str, float] | None:
    """Average the mean absolute errors of cycles, by coordinate and (``mean``) over coordinates.

    Cycles have equally many frames, so this is the mean over all frames. None if there is no cycle.
    """
    if not errors:
        return None
    mean = np.mean([cycle.mean_absolute for cycle in errors], axis=0)
    return dict(zip(coordinates, mean.tolist(), strict=True)) | {"mean": float(mean.mean())}
