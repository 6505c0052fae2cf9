"""How much of what differs between cycles follows what was recorded of them.

Differences between cycles are taken for a sum over recorded inputs: how much each of them differs, times a
coefficient that changes smoothly over the gait cycle. What this gets right of a difference that it has not
seen is driven by the inputs: a better model could take it away, though it does not repeat (a drift of the EMG
gain over the session has no mean).

Cycles of a speed are compared by contrasts, sums with orthonormal weights that add up to zero: there is one
less of them than cycles, and noise is as independent in them as it is in cycles. Deviations from the mean are
not: all but one of them give away the last.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import helmert

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
