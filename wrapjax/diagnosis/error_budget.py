"""Where the moment error is: its total split exactly into parts that call for different cures.

With a residual r of cycle c at speed v, at one coordinate and phase of the gait cycle, r = b + m_v + e_c:
a constant, what repeats from cycle to cycle, and what does not. What repeats is common to all speeds or
specific to one; what does not follows the inputs (EMG, angles, the order of cycles) or nothing that was
recorded. All parts are mean squares in (N m)^2 and add up to the total in every bin. The variance of a mean
of few cycles is taken from what repeats and given to the noise, so that parts are unbiased; they may be
negative and are never clipped.

How much of what differs between cycles follows what was recorded of them.

Differences between cycles are taken for a sum over recorded inputs: how much each of them differs, times a
coefficient that changes smoothly over the gait cycle. What this gets right of a difference that it has not
seen is driven by the inputs: a better model could take it away, though it does not repeat (a drift of the EMG
gain over the session has no mean).

Cycles of a speed are compared by contrasts, sums with orthonormal weights that add up to zero: there is one
less of them than cycles, and noise is as independent in them as it is in cycles. Deviations from the mean are
not: all but one of them give away the last.

The map of the gap: how large an error repeats from cycle to cycle, by speed, coordinate and phase.

The mean error of a few cycles holds noise as well. Taken away bin by bin, noise leaves zeros where chance was
on its side and too much elsewhere. So the size of what repeats is estimated for a coordinate as a whole, and
the map says how it is shared out over the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import helmert

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


# Over how much of a gait cycle coefficients and noise go on alike.
_PHASE_WIDTH = 0.06
# Variance of what all inputs together drive, in that of the noise.
_STRENGTHS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
# Frames of a cycle that are looked at.
_FRAMES = 25


def driven_variance(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    inputs: Float[np.ndarray, "cycle input frame"],
    speeds: Int[np.ndarray, " cycle"],
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Estimate the variance between cycles that follows what was recorded of them, in (N m)^2.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    inputs
        What may drive them: joint angles and rates, EMG, the order of cycles (constant over frames), in
        any units.
    speeds
        Which speed each cycle was walked at, counted from 0.

    Returns
    -------
    Array
        Covariance of contrasts with what is foretold of them from all others; by chance it can be negative.

    Notes
    -----
    How strong inputs are beside noise is what makes left-out contrasts likeliest, over all coordinates.
    """
    _, coordinates, frames = residuals.shape
    chosen = np.unique(np.linspace(0, frames - 1, _FRAMES).astype(int))
    differences = _contrasts(residuals, speeds)
    features = _contrasts(inputs, speeds)
    spread = np.sqrt(np.mean(features**2, axis=(0, 2), keepdims=True))
    features = (features / np.where(spread > 0.0, spread, 1.0))[:, :, chosen]
    seen = differences[:, :, chosen]
    scale = np.sqrt(np.mean(seen**2, axis=(0, 2)))
    targets = (seen / np.where(scale > 0.0, scale, 1.0)[None, :, None]).transpose(0, 2, 1)
    targets = targets.reshape(-1, coordinates)
    rows = features.transpose(0, 2, 1).reshape(-1, features.shape[1])
    phase = np.tile(np.arange(len(chosen)) / (len(chosen) - 1.0), len(seen))
    near = np.exp(-2.0 * (np.sin(np.pi * (phase[:, None] - phase[None])) / (2 * np.pi * _PHASE_WIDTH)) ** 2)
    contrast = np.repeat(np.arange(len(seen)), len(chosen))
    noise = near * (contrast[:, None] == contrast[None]) + 1e-3 * np.eye(len(near))
    alike = near * (rows @ rows.T) / rows.shape[1]
    found = [_left_out(strength * alike + noise, contrast, targets) for strength in _STRENGTHS]
    foretold = max(found, key=lambda one: one[0])[1]
    return _shared_variance(foretold, targets, scale, np.bincount(speeds) - 1, len(chosen), frames)


def _left_out(
    covariance: Float[np.ndarray, "row row"],
    contrast: Int[np.ndarray, " row"],
    targets: Float[np.ndarray, "row coordinate"],
) -> tuple[float, Float[np.ndarray, "row coordinate"]]:
    """Foretell each contrast from the others; give its log likelihood, the scale profiled out, as well."""
    inverse = np.linalg.inv(covariance)
    along = inverse @ targets
    foretold = np.zeros_like(targets)
    logarithms, quadratic = 0.0, np.zeros(targets.shape[1])
    for own in range(contrast.max() + 1):
        rows = contrast == own
        # By the inverse of a partitioned matrix: no other one needs inverting for each.
        precision = inverse[np.ix_(rows, rows)]
        missed = np.linalg.solve(precision, along[rows])
        foretold[rows] = targets[rows] - missed
        logarithms += np.linalg.slogdet(precision)[1]
        quadratic += np.einsum("rc,rs,sc->c", missed, precision, missed)
    count = len(targets)
    likelihood = 0.5 * targets.shape[1] * logarithms - 0.5 * count * np.sum(np.log(quadratic / count))
    return float(likelihood), foretold


def _shared_variance(
    foretold: Float[np.ndarray, "row coordinate"],
    targets: Float[np.ndarray, "row coordinate"],
    scale: Float[np.ndarray, " coordinate"],
    counts: Int[np.ndarray, " speed"],
    chosen: int,
    frames: int,
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Covariance of what was foretold with what came, at all frames."""
    product = (foretold * targets * scale**2).reshape(counts.sum(), chosen, -1)
    places = np.linspace(0.0, chosen - 1.0, frames)
    found = []
    for contrasts in np.split(product, np.cumsum(counts)[:-1]):
        own = contrasts.mean(axis=0)
        found.append([np.interp(places, np.arange(chosen), column) for column in own.T])
    return np.array(found)


def _contrasts(
    values: Float[np.ndarray, "cycle quantity frame"], speeds: Int[np.ndarray, " cycle"]
) -> Float[np.ndarray, "contrast quantity frame"]:
    """Compare the cycles of each speed with one another, one speed after the other."""
    each = [values[speeds == speed] for speed in range(speeds.max() + 1)]
    return np.concatenate([np.tensordot(helmert(len(own)), own, axes=1) for own in each])


#: How far a speed's mean error is drawn towards that of all speeds: what is amiss at one is mostly amiss at
#: the others, and their noise is another.
TOWARDS_ALL = 0.3


def repeatable_error_map(
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
