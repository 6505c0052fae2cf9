"""Where the moment error is: its total split exactly into parts that call for different cures.

With a residual r of cycle c at speed v, at one coordinate and phase of the gait cycle, r = b + m_v + e_c:
a constant, what repeats from cycle to cycle, and what does not. What repeats is common to all speeds or
specific to one; what does not follows the inputs (EMG, angles, the order of cycles) or nothing that was
recorded. All parts are mean squares in (N m)^2 and add up to the total in every bin. The variance of a mean
of few cycles is taken from what repeats and given to the noise, so that parts are unbiased; they may be
negative and are never clipped.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

#: Width of a bin in percent of the gait cycle.
BIN_PERCENT = 5
#: Bins of a gait cycle.
BINS = 100 // BIN_PERCENT


@dataclass(frozen=True)
class Budget:
    """Mean squared moment error by speed, coordinate and bin of the gait cycle, in (N m)^2.

    Parameters
    ----------
    bias
        Of the mean over all phases and speeds. A bin also holds the product of that mean with what
        repeats there; over all bins and speeds the products cancel.
    common
        Repeats at all speeds alike.
    specific
        Repeats at this speed, beyond what it has in common with the others. Zero where there is but one.
    driven
        Differs between cycles and follows what was recorded of them.
    noise
        The rest.
    """

    bias: Float[np.ndarray, "speed coordinate bin"]
    common: Float[np.ndarray, "speed coordinate bin"]
    specific: Float[np.ndarray, "speed coordinate bin"]
    driven: Float[np.ndarray, "speed coordinate bin"]
    noise: Float[np.ndarray, "speed coordinate bin"]

    @property
    def repeatable(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """What is the same in every cycle of a speed."""
        return self.bias + self.common + self.specific

    @property
    def explainable(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """What a better model could take away."""
        return self.repeatable + self.driven

    @property
    def total(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """All of it: the mean squared error."""
        return self.explainable + self.noise

    @property
    def explainable_share(self) -> float:
        """Part of the whole error that a better model could take away; can leave 0 to 1 by chance."""
        return float(self.explainable.sum() / self.total.sum())

    def pooled(self) -> dict[str, Float[np.ndarray, " coordinate"]]:
        """Give each part by coordinate, averaged over speeds and the gait cycle."""
        return {field.name: getattr(self, field.name).mean(axis=(0, 2)) for field in fields(self)}


def split_error(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    driven: Float[np.ndarray, "speed coordinate frame"] | None = None,
) -> Budget:
    """Split the moment error of repeated gait cycles.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m, over one gait cycle each, first and last frame included.
        To say what a fit leaves they must be of cycles that it has not seen: its own look too good.
    speeds
        Which speed each cycle was walked at, counted from 0; at least two cycles of each.
    driven
        Variance between cycles that follows what was recorded of them (see `driven_variance`), by
        speed; none if not given.

    Raises
    ------
    ValueError
        If a speed has fewer than two cycles: what repeats cannot be told from what does not.
    """
    counts = np.bincount(speeds)
    if (counts < 2).any():
        raise ValueError(f"cycles a speed: {counts.tolist()}; two are the fewest that show what repeats")
    each = [residuals[speeds == speed] for speed in range(len(counts))]
    mean = np.stack([own.mean(axis=0) for own in each])
    variance = np.stack([own.var(axis=0, ddof=1) for own in each])
    # A mean over a cycle counts the frame at both ends once.
    offset = _over_cycle(mean).mean(axis=0)[None, :, None]
    repeated = mean - offset
    of_mean = variance / counts[:, None, None]
    of_grand_mean = of_mean.sum(axis=0, keepdims=True) / len(counts) ** 2
    common = np.broadcast_to(repeated.mean(axis=0, keepdims=True) ** 2 - of_grand_mean, mean.shape)
    parts = {
        "bias": mean**2 - repeated**2,
        "common": common,
        "specific": repeated**2 - of_mean - common,
        "driven": np.zeros_like(mean) if driven is None else driven,
    }
    parts["noise"] = variance - parts["driven"]
    return Budget(**{name: binned(part) for name, part in parts.items()})


def _over_cycle(values: Float[np.ndarray, "*axes frame"]) -> Float[np.ndarray, "*axes"]:
    """Average over a gait cycle, whose first and last frame are the same phase."""
    return (values[..., :-1].sum(axis=-1) + 0.5 * (values[..., -1] - values[..., 0])) / (values.shape[-1] - 1)


def binned(values: Float[np.ndarray, "*axes frame"]) -> Float[np.ndarray, "*axes bin"]:
    """Average over each bin, sharing out frames on a border between two."""
    return np.tensordot(values, bin_weights(values.shape[-1]), axes=(-1, 1))


def bin_weights(frames: int) -> Float[np.ndarray, "bin frame"]:
    """Give how much each frame counts in the mean over each bin of the gait cycle.

    Every frame stands for the time around it, half an interval to either side; the first and the last
    for half as much.
    """
    phase = np.linspace(0.0, BINS, frames)
    half = 0.5 * (phase[1] - phase[0])
    starts, ends = np.maximum(phase - half, 0.0), np.minimum(phase + half, BINS)
    bins = np.arange(BINS)[:, None]
    shared = np.minimum(ends[None], bins + 1.0) - np.maximum(starts[None], bins)
    return np.maximum(shared, 0.0)
