"""Noise of residual moments: smooth over the gait cycle, new in each cycle, and in part the same in all.

Frames of a cycle are no independent samples, and what a model gets wrong it gets wrong in every cycle. Over
harmonics of the cycle, and over the mean and the contrasts of cycles of one speed, such noise is independent:
its covariance is a list of variances there, one smooth spectrum a coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

# Powers and what calibration took from them are found in turn.
_TURNS = 12
# Calibration is never taken to have removed more than this factor of a harmonic's power: what it fits
# exactly tells nothing of noise.
_MOST_REMOVED = 8.0


@dataclass(frozen=True)
class ResidualNoise:
    """Covariance of measured moments about the model, (N m)^2.

    Parameters
    ----------
    over_trials, over_frames
        Orthonormal rows: mean and contrasts of the cycles of each speed; waves of the cycle.
    variance
        Of each row of both, by coordinate.
    """

    over_trials: Float[np.ndarray, "trial trial"]
    over_frames: Float[np.ndarray, "frame frame"]
    variance: Float[np.ndarray, "trial coordinate frame"]

    @property
    def deviation(self) -> Float[np.ndarray, " coordinate"]:
        """Standard deviation of one moment, root mean square over cycles and phases, N m."""
        return np.asarray(np.sqrt(self.variance.mean(axis=(0, 2))))

    @property
    def independent(self) -> float:
        """Number of independent samples that tell as much of the noise's size as all frames."""
        by_coordinate = self.variance.sum(axis=(0, 2)) ** 2 / (self.variance**2).sum(axis=(0, 2))
        return float(by_coordinate.sum())

    def rotated(self, slopes: Float[np.ndarray, "trial coordinate frame *_"]) -> np.ndarray:
        """Take moments, or their slopes, to where noise is independent."""
        return _rotated(self.over_trials, self.over_frames, slopes)

    def through(self, slopes: Float[np.ndarray, "trial coordinate frame variable"]) -> np.ndarray:
        """Give the covariance of ``slopes' noise``."""
        rows = self.rotated(slopes).reshape(-1, slopes.shape[-1])
        return np.asarray((rows.T * self.variance.ravel()) @ rows)

    def draw(self, generator: np.random.Generator) -> Float[np.ndarray, "trial coordinate frame"]:
        """Make noise up, N m."""
        waves = np.sqrt(self.variance) * generator.standard_normal(self.variance.shape)
        return np.asarray(np.einsum("at,bf,acb->tcf", self.over_trials, self.over_frames, waves))


def residual_noise(
    residuals: Float[np.ndarray, "trial coordinate frame"],
    speeds: Float[np.ndarray, " trial"],
    slopes: Float[np.ndarray, "trial coordinate frame variable"],
    gain: Float[np.ndarray, "variable variable"],
) -> ResidualNoise:
    """Estimate the noise that left these residuals.

    Calibration took a part of the noise into its parameters. What it left is ``(1 - slopes gain slopes')`` of
    it, so variances are raised until what they would leave is what is seen (restricted maximum likelihood;
    Patterson & Thompson 1971, doi:10.1093/biomet/58.3.545).

    Parameters
    ----------
    residuals
        Modelled less measured moments, N m.
    speeds
        Of each cycle, m/s; NaN where unknown.
    slopes
        Of the moments by variables that were free to move.
    gain
        Times ``slopes' noise``: how far noise (N m) moved the variables.
    """
    over_trials, repeats = _cycle_contrasts(speeds)
    over_frames, harmonic = _waves(residuals.shape[-1])
    kinds = np.where(repeats, 1, 0)
    seen = _pooled(_rotated(over_trials, over_frames, residuals) ** 2, kinds, harmonic)
    rows = _rotated(over_trials, over_frames, slopes).reshape(-1, slopes.shape[-1])
    moved = rows @ gain
    own_share = np.einsum("ij,ij->i", moved, rows)
    power = seen
    for _ in range(_TURNS):
        variance = _spread_out(power, kinds, harmonic).ravel()
        expected = variance * (1.0 - 2.0 * own_share)
        expected += np.einsum("ij,ij->i", moved @ ((rows.T * variance) @ rows), moved)
        left = _pooled(expected.reshape(residuals.shape), kinds, harmonic)
        power = np.clip(power * seen / np.maximum(left, 1e-12 * power + 1e-300), seen, _MOST_REMOVED * seen)
    if (~repeats).any():
        # What repeats cannot vary less than what is new in each cycle makes it.
        power[1] = np.maximum(power[1], power[0])
    return ResidualNoise(over_trials, over_frames, _spread_out(power, kinds, harmonic))


def _cycle_contrasts(
    speeds: Float[np.ndarray, " trial"],
) -> tuple[Float[np.ndarray, "trial trial"], np.ndarray]:
    """Give orthonormal rows over cycles, and which of them hold what all cycles of a speed share."""
    _, group = np.unique(speeds, return_inverse=True)  # NaNs count as one speed
    rows, repeats = np.zeros((len(speeds), len(speeds))), np.zeros(len(speeds), dtype=bool)
    place = 0
    for number in range(group.max() + 1):
        members = np.flatnonzero(group == number)
        rows[place : place + len(members), members] = scipy.linalg.helmert(len(members), full=True)
        repeats[place] = True
        place += len(members)
    return rows, repeats


def _waves(frames: int) -> tuple[Float[np.ndarray, "frame frame"], Int[np.ndarray, " frame"]]:
    """Give orthonormal cosines and sines over the cycle, and the harmonic of each."""
    harmonic = (np.arange(frames) + 1) // 2
    angle = 2.0 * np.pi * harmonic[:, None] * np.arange(frames) / frames
    rows = np.where((np.arange(frames) % 2 == 1)[:, None], np.cos(angle), np.sin(angle))
    rows[0] = 1.0
    return rows / np.linalg.norm(rows, axis=1, keepdims=True), harmonic


def _rotated(over_trials: np.ndarray, over_frames: np.ndarray, values: np.ndarray) -> np.ndarray:
    by_wave = np.moveaxis(np.tensordot(over_frames, values, axes=(1, 2)), 0, 2)
    return np.asarray(np.tensordot(over_trials, by_wave, axes=(1, 0)))


def _pooled(
    values: Float[np.ndarray, "trial coordinate frame"], kinds: np.ndarray, harmonic: np.ndarray
) -> Float[np.ndarray, "kind coordinate harmonic"]:
    """Average over rows of a kind and over neighbouring harmonics: each alone is few values."""
    count = harmonic.max() + 1
    by_harmonic = np.stack([values[..., harmonic == one].mean(axis=-1) for one in range(count)], axis=-1)
    pooled = np.zeros((2, values.shape[1], count))
    for kind in np.unique(kinds):
        own = by_harmonic[kinds == kind].mean(axis=0)
        ends = np.concatenate([own[:, :1], own, own[:, -1:]], axis=1)
        pooled[kind] = (ends[:, :-2] + 2.0 * ends[:, 1:-1] + ends[:, 2:]) / 4.0
    return pooled


def _spread_out(
    power: Float[np.ndarray, "kind coordinate harmonic"], kinds: np.ndarray, harmonic: np.ndarray
) -> Float[np.ndarray, "trial coordinate frame"]:
    return np.asarray(power[kinds][..., harmonic])
