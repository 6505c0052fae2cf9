"""Noise floor of the moment error, and the share of the error above it that a model or an effect removes.

The noise floor is the mean squared error that a correct model would leave. It is estimated from differences
between cycles of one speed, less those that the recorded inputs explain: these are predicted, cycle by cycle,
from the differences between the inputs, with coefficients that change smoothly over the gait cycle. The part
of a held-out difference that is predicted is input-driven. A better model could remove it, although it does
not repeat (a drift of the EMG gain over the session has no mean).

Cycles of a speed are compared by contrasts, sums with orthonormal weights that add up to zero. There is one
contrast less than cycles, and noise is as independent in contrasts as in cycles. Deviations from the mean are
not independent: all but one of them determine the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats
from scipy.linalg import helmert

#: Number of bootstrap samples of cycles.
RESAMPLES = 500
# Correlation width of coefficients and noise over the gait cycle, in gait cycles.
_PHASE_WIDTH = 0.06
# Variance that all inputs together drive, relative to that of the noise, that is tried.
_STRENGTHS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
# Number of frames of a cycle that are used.
_FRAMES = 25
# Largest share of the variance between cycles that counts as driven by inputs: some of it is always noise.
_MOST_DRIVEN = 0.8
_SINGLE_CYCLES = "one cycle at each speed cannot show how much of the error is noise"

CycleErrors = Float[np.ndarray, " cycle"]


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval, or the reason why it is not known.

    Parameters
    ----------
    value, low, high
        Estimate and ends of the interval; NaN where there is a ``reason``.
    reason
        Reason why it is not known; empty where it is.
    """

    value: float
    low: float
    high: float
    reason: str = ""

    @property
    def known(self) -> bool:
        """Whether there is an estimate."""
        return not self.reason

    @classmethod
    def unknown(cls, reason: str) -> Estimate:
        """Return an estimate without a value."""
        return cls(np.nan, np.nan, np.nan, reason)


@dataclass(frozen=True)
class RepeatedCycles:
    """Cycles at speeds with two cycles or more.

    Parameters
    ----------
    cycles
        Indices of these cycles.
    speeds
        Numbers of these speeds, among all speeds.
    number
        Speed of each of these cycles, as a position in ``speeds``.
    n_speeds
        Number of all speeds.
    """

    cycles: Int[np.ndarray, " repeated"]
    speeds: Int[np.ndarray, " repeated_speed"]
    number: Int[np.ndarray, " repeated"]
    n_speeds: int

    @classmethod
    def of(cls, speeds: Int[np.ndarray, " cycle"]) -> RepeatedCycles:
        """Select repeated cycles by the speed number of each cycle, counted from 0."""
        cycles = np.flatnonzero(np.bincount(speeds)[speeds] > 1)
        repeated, number = np.unique(speeds[cycles], return_inverse=True)
        return cls(cycles, repeated, number, int(speeds.max()) + 1)

    def by_speed(
        self, variance: Float[np.ndarray, "repeated_speed coordinate frame"]
    ) -> Float[np.ndarray, " speed"]:
        """Average a variance at each of these speeds; return it for all speeds, zero at others."""
        total = np.zeros(self.n_speeds)
        total[self.speeds] = variance.mean(axis=(1, 2))
        return total


@dataclass(frozen=True)
class NoiseFloor:
    """Mean squared error of each cycle that a correct model would leave, (N m)^2.

    Parameters
    ----------
    by_cycle
        Noise floor of each cycle; not finite where no speed has two cycles.
    without_driven
        Noise floor if no difference between cycles could be explained: the input-driven part is an estimate.
    relative_sd
        Relative standard deviation of the mean noise floor.
    """

    by_cycle: CycleErrors
    without_driven: CycleErrors
    relative_sd: float

    @property
    def known(self) -> bool:
        """Whether some speed has more than one cycle."""
        return bool(np.isfinite(self.by_cycle).all())

    def of(self, cycles: Bool[np.ndarray, " cycle"]) -> NoiseFloor:
        """Select cycles."""
        return NoiseFloor(self.by_cycle[cycles], self.without_driven[cycles], self.relative_sd)


def cycle_errors(residuals: Float[np.ndarray, "cycle coordinate frame"]) -> CycleErrors:
    """Compute the mean squared error of each cycle, (N m)^2."""
    return np.mean(residuals**2, axis=(1, 2))


def noise_floor(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    independent_values: float,
    driven: Float[np.ndarray, " speed"] | None = None,
) -> NoiseFloor:
    """Estimate the noise floor from the deviations of cycles from the mean of their speed.

    The deviations are scaled, as the sample mean is closer to the cycles than the true mean. A cycle without
    another at its speed gets the mean of the others.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    speeds
        Speed number of each cycle, counted from 0.
    independent_values
        Number of independent values of noise in a cycle, over all coordinates.
    driven
        Input-driven variance between cycles at each speed, (N m)^2; zero if not given.
    """
    by_cycle, without_driven = np.full(len(residuals), np.nan), np.full(len(residuals), np.nan)
    freedom = []
    for speed in np.unique(speeds):
        cycles = speeds == speed
        count = int(cycles.sum())
        if count > 1:
            deviations = residuals[cycles] - residuals[cycles].mean(axis=0)
            without_driven[cycles] = cycle_errors(deviations) * count / (count - 1.0)
            share = 0.0 if driven is None else driven[speed] / np.mean(without_driven[cycles])
            by_cycle[cycles] = without_driven[cycles] * (1.0 - np.clip(share, 0.0, _MOST_DRIVEN))
            freedom.append(count - 1.0)
    if freedom:
        by_cycle, without_driven = (
            np.where(np.isnan(one), np.nanmean(one), one) for one in (by_cycle, without_driven)
        )
    # Deviations contain the noise of these very cycles, except what the mean of few cycles absorbed of it.
    relative_sd = np.sqrt(2.0 / independent_values * np.sum(1.0 / np.square(freedom))) / max(len(freedom), 1)
    return NoiseFloor(by_cycle, without_driven, float(relative_sd))


def input_driven_variance(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    inputs: Float[np.ndarray, "cycle input frame"],
    speeds: Int[np.ndarray, " cycle"],
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Estimate the variance between cycles that follows the recorded inputs, (N m)^2.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m.
    inputs
        Possible causes of differences: joint angles and rates, EMG, the order of cycles (constant over
        frames), in any units.
    speeds
        Speed number of each cycle, counted from 0.

    Returns
    -------
    Array
        Covariance of contrasts with their predictions from all other contrasts; by chance it can be negative.

    Notes
    -----
    The strength of the inputs relative to the noise maximises the likelihood of left-out contrasts over all
    coordinates.
    """
    _, coordinates, frames = residuals.shape
    chosen = np.unique(np.linspace(0, frames - 1, _FRAMES).astype(int))
    differences = _contrasts(residuals, speeds)
    features = _contrasts(inputs, speeds)
    spread = np.sqrt(np.mean(features**2, axis=(0, 2), keepdims=True))
    features = (features / np.where(spread > 0.0, spread, 1.0))[:, :, chosen]
    sampled = differences[:, :, chosen]
    scale = np.sqrt(np.mean(sampled**2, axis=(0, 2)))
    targets = (sampled / np.where(scale > 0.0, scale, 1.0)[None, :, None]).transpose(0, 2, 1)
    targets = targets.reshape(-1, coordinates)
    rows = features.transpose(0, 2, 1).reshape(-1, features.shape[1])
    phase = np.tile(np.arange(len(chosen)) / (len(chosen) - 1.0), len(sampled))
    near = np.exp(-2.0 * (np.sin(np.pi * (phase[:, None] - phase[None])) / (2 * np.pi * _PHASE_WIDTH)) ** 2)
    contrast = np.repeat(np.arange(len(sampled)), len(chosen))
    noise = near * (contrast[:, None] == contrast[None]) + 1e-3 * np.eye(len(near))
    by_inputs = near * (rows @ rows.T) / rows.shape[1]
    fits = [_predict_left_out(strength * by_inputs + noise, contrast, targets) for strength in _STRENGTHS]
    predicted = max(fits, key=lambda one: one[0])[1]
    return _covariance_by_frame(predicted, targets, scale, np.bincount(speeds) - 1, len(chosen), frames)


def _predict_left_out(
    covariance: Float[np.ndarray, "row row"],
    contrast: Int[np.ndarray, " row"],
    targets: Float[np.ndarray, "row coordinate"],
) -> tuple[float, Float[np.ndarray, "row coordinate"]]:
    """Predict each contrast from the others; return the log likelihood, with profiled scale, as well."""
    inverse = np.linalg.inv(covariance)
    along = inverse @ targets
    predicted = np.zeros_like(targets)
    logarithms, quadratic = 0.0, np.zeros(targets.shape[1])
    for number in range(contrast.max() + 1):
        rows = contrast == number
        # The inverse of a partitioned matrix gives the prediction without another inverse for each contrast.
        precision = inverse[np.ix_(rows, rows)]
        missed = np.linalg.solve(precision, along[rows])
        predicted[rows] = targets[rows] - missed
        logarithms += np.linalg.slogdet(precision)[1]
        quadratic += np.einsum("rc,rs,sc->c", missed, precision, missed)
    count = len(targets)
    likelihood = 0.5 * targets.shape[1] * logarithms - 0.5 * count * np.sum(np.log(quadratic / count))
    return float(likelihood), predicted


def _covariance_by_frame(
    predicted: Float[np.ndarray, "row coordinate"],
    targets: Float[np.ndarray, "row coordinate"],
    scale: Float[np.ndarray, " coordinate"],
    counts: Int[np.ndarray, " speed"],
    chosen: int,
    frames: int,
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Compute the covariance of predicted and actual contrasts at each speed, interpolated to all frames."""
    product = (predicted * targets * scale**2).reshape(counts.sum(), chosen, -1)
    places = np.linspace(0.0, chosen - 1.0, frames)
    by_speed = []
    for contrasts in np.split(product, np.cumsum(counts)[:-1]):
        mean = contrasts.mean(axis=0)
        by_speed.append([np.interp(places, np.arange(chosen), column) for column in mean.T])
    return np.array(by_speed)


def _contrasts(
    values: Float[np.ndarray, "cycle quantity frame"], speeds: Int[np.ndarray, " cycle"]
) -> Float[np.ndarray, "contrast quantity frame"]:
    """Compute orthonormal contrasts between the cycles of each speed, one speed after the other."""
    each = [values[speeds == speed] for speed in range(speeds.max() + 1)]
    return np.concatenate([np.tensordot(helmert(len(cycles)), cycles, axes=1) for cycles in each])


def explainable_share(
    errors: CycleErrors, floor: NoiseFloor, speeds: Int[np.ndarray, " cycle"], seed: int = 0
) -> Estimate:
    """Estimate the share of the mean squared error that is above the noise floor; see `shrinkage`."""
    if not floor.known:
        return Estimate.unknown(_SINGLE_CYCLES)
    total, noise = _bootstrap(errors, speeds, seed), _bootstrap_floor(floor, speeds, seed)
    return _ratio(total - noise, total, speeds)


def shrinkage(
    before: CycleErrors,
    after: CycleErrors,
    floor: NoiseFloor,
    speeds: Int[np.ndarray, " cycle"],
    seed: int = 0,
) -> Estimate:
    """Estimate the share of the explainable error that is removed: (before - after) / (before - floor).

    The estimate is not clipped to 0 to 1.

    Parameters
    ----------
    before, after
        Mean squared errors, (N m)^2, of cycles that fits have not used, without and with the effect.
    floor
        Noise floor of these cycles.
    speeds
        Speed number of each cycle; cycles are resampled within each speed.
    seed
        Seed of the bootstrap.

    Notes
    -----
    The interval is a percentile bootstrap over cycles, widened by the quantile of Student's t distribution,
    as that of few cycles is too narrow. The noise floor is resampled as well: with all or a part of the
    input-driven variance counted as noise, and within its standard deviation.
    """
    if not floor.known:
        return Estimate.unknown(_SINGLE_CYCLES)
    total, noise = _bootstrap(before, speeds, seed), _bootstrap_floor(floor, speeds, seed)
    return _ratio(_bootstrap(before - after, speeds, seed), total - noise, speeds)


# Mean over all cycles, then means over bootstrap samples of them.
Means = Float[np.ndarray, " sample"]


def _bootstrap(values: CycleErrors, speeds: Int[np.ndarray, " cycle"], seed: int) -> Means:
    """Compute the mean over all cycles, then over bootstrap samples drawn within each speed."""
    generator = np.random.default_rng(seed)
    groups = [np.flatnonzero(speeds == speed) for speed in np.unique(speeds)]
    samples = np.concatenate(
        [generator.choice(cycles, (RESAMPLES, len(cycles))) for cycles in groups], axis=1
    )
    return np.append(np.mean(values), np.mean(values[samples], axis=1))


def _bootstrap_floor(floor: NoiseFloor, speeds: Int[np.ndarray, " cycle"], seed: int) -> Means:
    """Compute the mean noise floor of the same samples of cycles; the first is the estimate itself."""
    generator = np.random.default_rng([seed, 1])
    with_driven, without_driven = (
        _bootstrap(one, speeds, seed) for one in (floor.by_cycle, floor.without_driven)
    )
    share = np.append(0.0, generator.uniform(size=RESAMPLES))
    deviate = np.append(0.0, generator.normal(size=RESAMPLES))
    return (with_driven + share * (without_driven - with_driven)) * (1.0 + floor.relative_sd * deviate)


def _ratio(numerator: Means, denominator: Means, speeds: Int[np.ndarray, " cycle"]) -> Estimate:
    """Estimate the ratio of two means over cycles."""
    freedom = max(len(speeds) - len(np.unique(speeds)), 1)
    wider = stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975) * np.sqrt(len(speeds) / freedom)
    if denominator[0] - wider * (denominator[0] - np.quantile(denominator[1:], 0.025)) <= 0.0:
        return Estimate.unknown("the error cannot be distinguished from noise on these cycles")
    value = float(numerator[0] / denominator[0])
    ratios = numerator[1:] / denominator[1:]
    low, high = (value + wider * (np.quantile(ratios, at) - value) for at in (0.025, 0.975))
    return Estimate(value, float(low), float(high))
