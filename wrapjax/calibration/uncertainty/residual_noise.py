"""Covariance of measured joint moments about the model, estimated from the residuals of a calibration.

Residuals are correlated over the frames of a cycle, and errors of the model recur in every cycle. The noise
is modelled as independent over harmonics of the gait cycle, and over the mean and the contrasts of the cycles
of each speed. In that basis its covariance is diagonal: a smooth power spectrum for each coordinate, one for
the means (errors that recur) and one for the contrasts (noise that differs between cycles).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

# Number of fixed-point iterations of the power spectra.
_ITERATIONS = 12
# Largest correction of the power of a harmonic for what the calibration fitted: components that are fitted
# exactly contain no information on the noise.
_MAX_CORRECTION = 8.0


@dataclass(frozen=True)
class ResidualNoise:
    """Covariance of measured moments about the model.

    Parameters
    ----------
    over_trials, over_frames
        Orthonormal basis vectors as rows: mean and contrasts of the cycles of each speed; harmonics over the
        frames of a cycle.
    variance
        Variance of each pair of basis vectors by coordinate, (N m)^2.
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
        """Number of independent samples with the same information on the noise variance as all frames."""
        by_coordinate = self.variance.sum(axis=(0, 2)) ** 2 / (self.variance**2).sum(axis=(0, 2))
        return float(by_coordinate.sum())

    def transform(self, slopes: Float[np.ndarray, "trial coordinate frame *_"]) -> np.ndarray:
        """Transform moments, or their derivatives, to the basis in which the noise is independent."""
        return _transform(self.over_trials, self.over_frames, slopes)

    def propagate(self, slopes: Float[np.ndarray, "trial coordinate frame variable"]) -> np.ndarray:
        """Compute the covariance of ``slopes' noise``, for moment derivatives ``slopes``."""
        rows = self.transform(slopes).reshape(-1, slopes.shape[-1])
        return np.asarray((rows.T * self.variance.ravel()) @ rows)

    def draw(self, generator: np.random.Generator) -> Float[np.ndarray, "trial coordinate frame"]:
        """Draw a sample of the noise, N m."""
        waves = np.sqrt(self.variance) * generator.standard_normal(self.variance.shape)
        return np.asarray(np.einsum("at,bf,acb->tcf", self.over_trials, self.over_frames, waves))


def residual_noise(
    residuals: Float[np.ndarray, "trial coordinate frame"],
    speeds: Float[np.ndarray, " trial"],
    slopes: Float[np.ndarray, "trial coordinate frame variable"],
    gain: Float[np.ndarray, "variable variable"],
) -> ResidualNoise:
    """Estimate the covariance of the noise from the residuals of a calibration.

    The calibration fitted a part of the noise, so that the residuals are ``(I - slopes gain slopes') noise``.
    The variances are increased until the residuals that they predict have the observed power (restricted
    maximum likelihood; Patterson & Thompson 1971, doi:10.1093/biomet/58.3.545).

    Parameters
    ----------
    residuals
        Modelled less measured moments, N m.
    speeds
        Walking speed of each cycle, m/s; NaN where unknown.
    slopes
        Derivatives of the moments by the free variables, N m per solver unit.
    gain
        Matrix G such that noise changes the variables by ``G slopes' noise``.
    """
    over_trials, is_mean = _cycle_contrasts(speeds)
    over_frames, harmonic = _harmonics(residuals.shape[-1])
    kinds = np.where(is_mean, 1, 0)
    observed = _smoothed_power(_transform(over_trials, over_frames, residuals) ** 2, kinds, harmonic)
    rows = _transform(over_trials, over_frames, slopes).reshape(-1, slopes.shape[-1])
    response = rows @ gain
    leverage = np.einsum("ij,ij->i", response, rows)
    power = observed
    for _ in range(_ITERATIONS):
        variance = _expand_power(power, kinds, harmonic).ravel()
        expected = variance * (1.0 - 2.0 * leverage)
        expected += np.einsum("ij,ij->i", response @ ((rows.T * variance) @ rows), response)
        predicted = _smoothed_power(expected.reshape(residuals.shape), kinds, harmonic)
        scaled = power * observed / np.maximum(predicted, 1e-12 * power + 1e-300)
        power = np.clip(scaled, observed, _MAX_CORRECTION * observed)
    if (~is_mean).any():
        # The means of cycles vary at least as much as the noise that differs between cycles makes them.
        power[1] = np.maximum(power[1], power[0])
    return ResidualNoise(over_trials, over_frames, _expand_power(power, kinds, harmonic))


def _cycle_contrasts(
    speeds: Float[np.ndarray, " trial"],
) -> tuple[Float[np.ndarray, "trial trial"], np.ndarray]:
    """Compute orthonormal basis vectors over cycles, and which of them are means of the cycles of a speed."""
    _, group = np.unique(speeds, return_inverse=True)  # NaNs are one speed
    rows, is_mean = np.zeros((len(speeds), len(speeds))), np.zeros(len(speeds), dtype=bool)
    place = 0
    for number in range(group.max() + 1):
        members = np.flatnonzero(group == number)
        rows[place : place + len(members), members] = scipy.linalg.helmert(len(members), full=True)
        is_mean[place] = True
        place += len(members)
    return rows, is_mean


def _harmonics(frames: int) -> tuple[Float[np.ndarray, "frame frame"], Int[np.ndarray, " frame"]]:
    """Compute orthonormal cosines and sines over the cycle, and the number of the harmonic of each."""
    harmonic = (np.arange(frames) + 1) // 2
    angle = 2.0 * np.pi * harmonic[:, None] * np.arange(frames) / frames
    rows = np.where((np.arange(frames) % 2 == 1)[:, None], np.cos(angle), np.sin(angle))
    rows[0] = 1.0
    return rows / np.linalg.norm(rows, axis=1, keepdims=True), harmonic


def _transform(over_trials: np.ndarray, over_frames: np.ndarray, values: np.ndarray) -> np.ndarray:
    by_wave = np.moveaxis(np.tensordot(over_frames, values, axes=(1, 2)), 0, 2)
    return np.asarray(np.tensordot(over_trials, by_wave, axes=(1, 0)))


def _smoothed_power(
    values: Float[np.ndarray, "trial coordinate frame"], kinds: np.ndarray, harmonic: np.ndarray
) -> Float[np.ndarray, "kind coordinate harmonic"]:
    """Average over basis vectors of a kind and over neighbouring harmonics, which have few values each."""
    count = harmonic.max() + 1
    by_harmonic = np.stack([values[..., harmonic == one].mean(axis=-1) for one in range(count)], axis=-1)
    pooled = np.zeros((2, values.shape[1], count))
    for kind in np.unique(kinds):
        mean = by_harmonic[kinds == kind].mean(axis=0)
        padded = np.concatenate([mean[:, :1], mean, mean[:, -1:]], axis=1)
        pooled[kind] = (padded[:, :-2] + 2.0 * padded[:, 1:-1] + padded[:, 2:]) / 4.0
    return pooled


def _expand_power(
    power: Float[np.ndarray, "kind coordinate harmonic"], kinds: np.ndarray, harmonic: np.ndarray
) -> Float[np.ndarray, "trial coordinate frame"]:
    return np.asarray(power[kinds][..., harmonic])
