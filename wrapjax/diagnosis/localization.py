"""Localization of the moment error: parts by speed, coordinate and phase, and muscle forces that remove it.

Error budget: a residual r of cycle c at speed v, at one coordinate and phase of the gait cycle, is
r = b + m_v + e_c, the sum of a constant, a part that repeats from cycle to cycle, and one that does not. The
repeatable part is common to all speeds or specific to one; the other is driven by the inputs (EMG, angles,
the order of cycles) or is noise. All parts are mean squares in (N m)^2 and add up to the total in every bin.
The variance of a mean of few cycles is subtracted from the repeatable part and added to the noise, so that
parts are unbiased; they may be negative and are never clipped.

Map of the repeatable error: the mean error of a few cycles contains noise as well. If noise were subtracted
bin by bin, bins would become zero or too large by chance. Therefore the size of the repeatable error is
estimated for a coordinate as a whole, and the map shows how it is distributed over the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.fits.baseline import BaselineFit
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames
from wrapjax.diagnosis.null_hypotheses.error_sources import periodic_kernel
from wrapjax.diagnosis.null_hypotheses.noise_floor import (
    Estimate,
    NoiseFloor,
    RepeatedCycles,
    cycle_errors,
    explainable_share,
    noise_floor,
)

#: Width of a bin in percent of the gait cycle.
BIN_PERCENT = 5
#: Number of bins of a gait cycle.
BINS = 100 // BIN_PERCENT
#: Weight of the mean over all speeds in the mean error of a speed: errors of the model are mostly similar at
#: all speeds, and the noise of the speeds is independent.
SPEED_POOLING = 0.3
#: Prior standard deviation of a muscle's force, in maximum isometric forces, and its correlation width in
#: gait cycles.
FORCE_ERROR, FORCE_WIDTH = 0.05, 0.05


@dataclass(frozen=True)
class ErrorBudget:
    """Mean squared moment error by speed, coordinate and bin of the gait cycle, in (N m)^2.

    Parameters
    ----------
    bias
        Error of the mean over all phases and speeds. A bin also contains the product of that mean with the
        repeatable error there; over all bins and speeds the products cancel.
    common
        Repeatable error that is common to all speeds.
    specific
        Repeatable error at this speed alone. Zero with one speed.
    driven
        Differences between cycles that follow the recorded inputs.
    noise
        Remaining differences between cycles.
    """

    bias: Float[np.ndarray, "speed coordinate bin"]
    common: Float[np.ndarray, "speed coordinate bin"]
    specific: Float[np.ndarray, "speed coordinate bin"]
    driven: Float[np.ndarray, "speed coordinate bin"]
    noise: Float[np.ndarray, "speed coordinate bin"]

    @property
    def repeatable(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """Error that is the same in every cycle of a speed."""
        return self.bias + self.common + self.specific

    @property
    def explainable(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """Error that a better model could remove."""
        return self.repeatable + self.driven

    @property
    def total(self) -> Float[np.ndarray, "speed coordinate bin"]:
        """Mean squared error."""
        return self.explainable + self.noise

    @property
    def explainable_share(self) -> float:
        """Share of the total error that a better model could remove; can be outside 0 to 1 by chance."""
        return float(self.explainable.sum() / self.total.sum())

    def pooled(self) -> dict[str, Float[np.ndarray, " coordinate"]]:
        """Average each part over speeds and the gait cycle, by coordinate."""
        return {field.name: getattr(self, field.name).mean(axis=(0, 2)) for field in fields(self)}


@dataclass(frozen=True)
class MuscleShare:
    """Muscle forces that would remove the error, as far as moment arms determine them.

    Parameters
    ----------
    muscles
        Names of the muscles.
    force
        Change of force, N; mean over the cycles of each speed.
    resolution
        0 where moment arms do not determine the muscle's part, 1 where they determine all of it.
    """

    muscles: tuple[str, ...]
    force: Float[np.ndarray, "muscle speed phase"]
    resolution: Float[np.ndarray, " muscle"]


@dataclass(frozen=True)
class Localization:
    """The baseline fit's error on held-out cycles.

    Parameters
    ----------
    budget, speeds
        Parts of the error, and the speed of each row, m/s; for speeds with two cycles or more.
    error_map
        Root mean square of the repeatable error, N m; see `repeatable_error_map`.
    noise_floor
        Noise floor of each cycle.
    explainable_share
        Share of the error above the noise floor.
    muscle_share
        Muscle forces that would remove the error; None without a linearised model.
    """

    budget: ErrorBudget
    speeds: Float[np.ndarray, " speed"]
    error_map: Float[np.ndarray, "speed coordinate bin"]
    noise_floor: NoiseFloor
    explainable_share: Estimate
    muscle_share: MuscleShare | None


def localize(data: DiagnosisInput, baseline: BaselineFit, linearized: LinearizedModel | None) -> Localization:
    """Localize the baseline fit's error on held-out cycles.

    Parameters
    ----------
    data, baseline
        Input of the diagnosis and its baseline fit.
    linearized
        Linearised model, which gives the variance by errors of the inputs; None: errors of the inputs count
        as explainable, which is all that can be said of a fit that has not converged.
    """
    repeated = RepeatedCycles.of(data.speeds)
    residual = baseline.residual[repeated.cycles]
    driven, floor = baseline.driven_variance, baseline.noise_floor
    if linearized is None:
        noise = between_cycle_variance(residual, repeated.number) - driven
    else:
        noise = np.broadcast_to(np.diag(linearized.noise.between)[:, None], driven.shape)
        driven = without_input_errors(driven, linearized.input_variance)
        by_speed = repeated.by_speed(driven)
        floor = noise_floor(baseline.residual, data.speeds, linearized.noise.independent_values, by_speed)
    first = [int(np.flatnonzero(data.speeds == speed)[0]) for speed in repeated.speeds]
    return Localization(
        budget=split_error(residual, repeated.number, driven),
        speeds=data.context.speeds[first],
        error_map=repeatable_error_map(residual, repeated.number, noise),
        noise_floor=floor,
        explainable_share=explainable_share(cycle_errors(baseline.residual), floor, data.speeds),
        muscle_share=None if linearized is None else _muscle_share(data, baseline, linearized),
    )


def between_cycle_variance(
    residuals: Float[np.ndarray, "cycle coordinate frame"], speeds: Int[np.ndarray, " cycle"]
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Compute the variance between the cycles of each speed, (N m)^2."""
    return np.stack([residuals[speeds == speed].var(axis=0, ddof=1) for speed in range(speeds.max() + 1)])


def without_input_errors(
    driven: Float[np.ndarray, "speed coordinate frame"],
    error_variance: Float[np.ndarray, "coordinate phase"],
) -> Float[np.ndarray, "speed coordinate frame"]:
    """Reduce the input-driven variance by the part that errors of EMG and angles cause, (N m)^2.

    That part follows the inputs as well, yet no model removes it. All frames are scaled by one factor. With a
    factor for each frame, the result would be clipped at zero where noise makes it too small, and not where
    noise makes it too large.
    """
    mean = np.mean(driven, axis=(1, 2), keepdims=True)
    factor = 1.0 - error_variance.mean() / np.where(mean > 0.0, mean, np.inf)
    return np.asarray(np.maximum(factor, 0.0) * driven)


def split_error(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    driven: Float[np.ndarray, "speed coordinate frame"] | None = None,
) -> ErrorBudget:
    """Split the moment error of repeated gait cycles into its parts.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m, over one gait cycle each, first and last frame included. Cycles
        that a fit has used have smaller errors than others.
    speeds
        Speed number of each cycle, counted from 0; at least two cycles of each.
    driven
        Input-driven variance between cycles (see `input_driven_variance`), by speed; zero if not given.

    Raises
    ------
    ValueError
        If a speed has fewer than two cycles: the repeatable part cannot be separated then.
    """
    counts = np.bincount(speeds)
    if (counts < 2).any():
        raise ValueError(
            f"cycles at each speed: {counts.tolist()}; at least two are needed to split the error"
        )
    by_speed = [residuals[speeds == speed] for speed in range(len(counts))]
    mean = np.stack([cycles.mean(axis=0) for cycles in by_speed])
    variance = np.stack([cycles.var(axis=0, ddof=1) for cycles in by_speed])
    offset = _cycle_mean(mean).mean(axis=0)[None, :, None]
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
    return ErrorBudget(**{name: binned(part) for name, part in parts.items()})


def _cycle_mean(values: Float[np.ndarray, "*axes frame"]) -> Float[np.ndarray, "*axes"]:
    """Average over a gait cycle, whose first and last frame are the same phase and count once together."""
    return (values[..., :-1].sum(axis=-1) + 0.5 * (values[..., -1] - values[..., 0])) / (values.shape[-1] - 1)


def binned(values: Float[np.ndarray, "*axes frame"]) -> Float[np.ndarray, "*axes bin"]:
    """Average over each bin; a frame on the border of two bins counts in both."""
    return np.tensordot(values, bin_weights(values.shape[-1]), axes=(-1, 1))


def bin_weights(frames: int) -> Float[np.ndarray, "bin frame"]:
    """Compute the weight of each frame in the mean over each bin of the gait cycle.

    A frame stands for the time around it, half an interval to either side; the first and the last for half
    as much.
    """
    phase = np.linspace(0.0, BINS, frames)
    half = 0.5 * (phase[1] - phase[0])
    starts, ends = np.maximum(phase - half, 0.0), np.minimum(phase + half, BINS)
    bins = np.arange(BINS)[:, None]
    shared = np.minimum(ends[None], bins + 1.0) - np.maximum(starts[None], bins)
    return np.maximum(shared, 0.0)


def repeatable_error_map(
    residuals: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    noise: Float[np.ndarray, "speed coordinate frame"],
) -> Float[np.ndarray, "speed coordinate bin"]:
    """Estimate the root mean square over each bin of the repeatable error at each speed, N m.

    Parameters
    ----------
    residuals
        Measured less predicted moments, N m, of cycles that the fit has not used.
    speeds
        Speed number of each cycle, counted from 0.
    noise
        Variance between cycles that no input causes, (N m)^2. The mean change by errors of the inputs is
        part of the map: it is in the prediction, and repeats with it.
    """
    counts = np.bincount(speeds)
    mean = np.stack([residuals[speeds == speed].mean(axis=0) for speed in range(len(counts))])
    pooled = (1.0 - SPEED_POOLING) * mean + SPEED_POOLING * mean.mean(axis=0)
    total = binned(mean**2 - noise / counts[:, None, None]).sum(axis=(0, 2), keepdims=True)
    shape = binned(pooled**2)
    total_shape = shape.sum(axis=(0, 2), keepdims=True)
    squares = shape * np.maximum(total, 0.0) / np.where(total_shape > 0.0, total_shape, 1.0)
    # By pooling, the repeatable part of a bin could become larger than its mean squared error.
    largest = np.stack([np.mean(residuals[speeds == speed] ** 2, axis=0) for speed in range(len(counts))])
    return np.sqrt(np.minimum(squares, binned(largest)))


def _muscle_share(data: DiagnosisInput, baseline: BaselineFit, linearized: LinearizedModel) -> MuscleShare:
    residual = baseline.residual[data.plan.calibration][..., phase_frames(data.measured.shape[-1])]
    force = np.asarray(data.context.parameters.max_isometric_force)
    deviations = np.concatenate(
        [
            residual[linearized.speeds == speed] - residual[linearized.speeds == speed].mean(axis=0)
            for speed in set(linearized.speeds)
        ]
    )
    arms = linearized.muscle_errors.arms / force[:, None, None, None]
    return muscle_share(
        data.context.muscles, residual, arms, force, deviations.std(axis=(0, 2)), linearized.speeds
    )


def muscle_share(
    muscles: tuple[str, ...],
    residual: Float[np.ndarray, "cycle coordinate phase"],
    arms: Float[np.ndarray, "muscle cycle coordinate phase"],
    max_isometric_force: Float[np.ndarray, " muscle"],
    noise: Float[np.ndarray, " coordinate"],
    speeds: Int[np.ndarray, " cycle"],
) -> MuscleShare:
    """Distribute the mean residual of each speed over the muscles by the smallest smooth forces.

    The forces are the posterior mean under independent normal priors of all muscles.

    Parameters
    ----------
    muscles
        Names of the muscles.
    residual
        Measured less predicted moments, N m.
    arms
        Moment arms, m.
    max_isometric_force
        Maximum isometric forces, N.
    noise
        Standard deviation of each coordinate's residual between cycles, N m.
    speeds
        Speed number of each cycle, counted from 0.
    """
    phases = residual.shape[-1]
    kernel = periodic_kernel(phases, FORCE_WIDTH)
    prior = (FORCE_ERROR * max_isometric_force) ** 2
    forces, resolutions = [], []
    for speed in np.unique(speeds):
        cycles = speeds == speed
        mean, arm = residual[cycles].mean(axis=0), arms[:, cycles].mean(axis=1)
        rows = mean.size
        # Covariance of the moments by random forces.
        by_force = np.einsum("m,mkp,mlq->kplq", prior, arm, arm) * kernel[None, :, None, :]
        by_noise = np.repeat(noise**2 / cycles.sum() + 1e-6, phases)
        total = by_force.reshape(rows, rows) + np.diag(by_noise)
        # Covariance of every muscle's force with the moments.
        across = prior[:, None, None, None] * kernel[None, :, None, :] * arm[:, None, :, :]
        across = across.reshape(len(muscles), phases, rows)
        forces.append(across @ np.linalg.solve(total, mean.ravel()))
        solved = np.linalg.solve(total, across.reshape(-1, rows).T)
        explained = np.einsum("ij,ji->i", across.reshape(-1, rows), solved).reshape(len(muscles), phases)
        resolutions.append(explained.mean(axis=1) / prior)
    return MuscleShare(muscles, np.stack(forces, axis=1), np.clip(np.mean(resolutions, axis=0), 0.0, 1.0))
