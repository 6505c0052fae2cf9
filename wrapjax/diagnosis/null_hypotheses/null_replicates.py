"""Null replicates: simulated residuals of subjects like the diagnosed one, without any effect.

A replicate has the subject's angles, EMG and calibrated parameters, but muscles with force curves by other
formulas, slightly different moment arms, and other noise of electrodes and moments. It is calibrated again,
and its residual is scored. Tabulated distributions give no usable detection threshold, because the residual
of a model whose curves differ from the person's is not noise.
`wrapjax.diagnosis.evidence.score` derives the threshold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.evidence.linearization import LinearizedModel, moment_slopes
from wrapjax.diagnosis.inputs.input import phase_frames
from wrapjax.diagnosis.null_hypotheses.cycle_noise import CycleNoise
from wrapjax.diagnosis.null_hypotheses.error_sources import EMG_ERROR, EMG_WIDTH, input_blocks
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.excitation import EmgSpline
from wrapjax.threads import map_in_threads

#: Standard deviation of relative errors of moment arms; and of parameters, in prior standard deviations.
ARM_ERROR, PARAMETER_ERROR = 0.08, 0.3
# Gauss-Newton steps of each calibration, each with its own derivatives, and step lengths tried for each.
_STEPS, _TRIES = 5, 4


class ReplicateCurves(AbstractCurves):
    """Force curves by other formulas than the model's, with parameters that differ between replicates."""

    #: Widths of the active curve: ascending limb, descending limb.
    width: Float[Array, "2"]
    #: Exponent of the active curve; 2 for a normal curve, larger for a flatter top.
    power: Float[Array, ""]
    #: Hill's a over F0, and the largest force of lengthening fibers.
    shortening: Float[Array, ""]
    plateau: Float[Array, ""]
    #: Strain at which the passive force is F0, and steepness of the passive curve.
    strain: Float[Array, ""]
    steepness: Float[Array, ""]

    @classmethod
    def drawn(cls, key: PRNGKeyArray) -> ReplicateCurves:
        """Draw curves; ranges are those of textbooks and common models."""
        share = jax.random.uniform(key, (7,))

        def between(place: int, low: float, high: float) -> Float[Array, ""]:
            return low + (high - low) * share[place]

        return cls(
            width=jnp.stack([between(0, 0.40, 0.56), between(1, 0.42, 0.60)]),
            power=between(2, 1.8, 2.6),
            shortening=between(3, 0.22, 0.40),
            plateau=between(4, 1.3, 1.7),
            strain=between(5, 0.5, 0.7),
            steepness=between(6, 3.0, 5.0),
        )

    def active_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Active force over normalised fiber length."""
        distance = jnp.sqrt((length - 1.0) ** 2 + 1e-6)
        return jnp.exp(-((distance / jnp.where(length < 1.0, self.width[0], self.width[1])) ** self.power))

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Hill's hyperbola, and for lengthening fibers another hyperbola with the same slope at zero."""
        slow = jnp.clip(velocity, -1.0, 0.0)
        fast = jnp.clip(velocity, 0.0, 1.5)
        shortening = (1.0 + slow) / (1.0 - slow / self.shortening)
        slope = 1.0 + 1.0 / self.shortening
        gain = self.plateau - 1.0
        return jnp.where(velocity < 0.0, shortening, 1.0 + gain * slope * fast / (gain + slope * fast))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Zero below optimal length, exponential above."""
        stretch = jnp.clip(length - 1.0, 0.0, 1.2) / self.strain
        return jnp.expm1(self.steepness * stretch) / jnp.expm1(self.steepness)


@dataclass(frozen=True)
class NullModel:
    """Model that all null replicates of a subject share.

    Parameters
    ----------
    problem, variables
        Calibration of the plain model, and its variables.
    recording
        Inputs of the forward model over the cycles that are scored.
    linearized
        Linearised model over these cycles.
    noise
        Noise of the measured moments, and sizes of the errors of EMG and angles.
    """

    problem: Objective
    variables: Float[np.ndarray, " variable"]
    recording: Recording
    linearized: LinearizedModel
    noise: CycleNoise

    @property
    def emg_error(self) -> float:
        """Relative error of an EMG envelope; the expected one where it could not be estimated."""
        shares = self.noise.input_shares
        return EMG_ERROR * (shares[0] if shares else 1.0)

    def noise_root(self, phases: int) -> Float[np.ndarray, "cycle own own"]:
        """Compute a root of the covariance within each cycle of moment noise and errors of angles, N m.

        Errors of EMG are not part of it: replicates are simulated with other envelopes than were recorded.
        """
        block = self.noise.block(phases)
        total = np.repeat(block[None], self.linearized.slopes.shape[1], axis=0)
        for share, errors in zip(self.noise.input_shares[1:], self.linearized.input_errors[1:], strict=True):
            total += share**2 * input_blocks(errors)
        return np.linalg.cholesky(total + 1e-9 * np.eye(len(block)))


def null_replicate_residuals(
    model: NullModel, count: int, seed: int = 0
) -> Float[np.ndarray, "replicate row"]:
    """Simulate and calibrate null replicates; return their residuals at the prior mean, N m.

    Parameters
    ----------
    model
        Model of the subject.
    count
        Number of replicates.
    seed
        Seed; a replicate does not depend on their number.
    """
    recording, linearized, layout = model.recording, model.linearized, model.problem.variables
    _, cycles, coordinates, phases = linearized.slopes.shape
    frames = phase_frames(recording.path.nominal.length.shape[-1])
    noise = model.noise_root(phases)
    # Moments are as precise as the subject's fit left them, and the prior is that of the calibration.
    prior = np.mean(linearized.fitted_residual**2) * np.linalg.inv(
        linearized.prior_root @ linearized.prior_root.T
    )
    keys = jax.random.split(jax.random.key(seed), count)

    def simulated_residual(number: int) -> Float[np.ndarray, " row"]:
        parameter_key, muscle_key = jax.random.split(keys[number], 2)
        deviates = np.asarray(jax.random.normal(parameter_key, linearized.from_prior_mean.shape))
        shift = PARAMETER_ERROR * linearized.prior_root @ deviates
        true = np.clip(model.variables + shift, layout.lower, layout.upper)
        moments = _replicate_moments(
            layout.unpack(jnp.asarray(true)), recording, jnp.asarray(model.emg_error), muscle_key
        )
        draws = np.random.default_rng([seed, number]).normal(size=(cycles, coordinates * phases))
        measured = np.asarray(moments)[..., frames].reshape(cycles, -1)
        measured = measured + np.einsum("cij,cj->ci", noise, draws)
        return _residual_at_prior_mean(model, prior, measured.ravel(), frames)

    return np.array(map_in_threads(simulated_residual, range(count)))


def _residual_at_prior_mean(
    model: NullModel,
    prior: Float[np.ndarray, "variable variable"],
    measured: Float[np.ndarray, " row"],
    frames: Int[np.ndarray, " phase"],
) -> Float[np.ndarray, " row"]:
    """Calibrate by damped Gauss-Newton steps, and move the residual to the prior mean of the variables."""
    problem, linearized = model.problem, model.linearized
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    prior_mean = model.variables - linearized.from_prior_mean
    chosen = model.recording.at_frames(frames)

    def residual_at(variables: Float[np.ndarray, " variable"]) -> Float[np.ndarray, " row"]:
        return measured - np.asarray(_moments(problem, jnp.asarray(variables), chosen)).ravel()

    def cost(variables: Float[np.ndarray, " variable"], residual: Float[np.ndarray, " row"]) -> float:
        deviation = variables - prior_mean
        return float(residual @ residual + deviation @ prior @ deviation)

    variables = np.array(model.variables)
    residual = residual_at(variables)
    slopes = linearized.slopes.reshape(len(linearized.slopes), -1)
    damping = 1e-2
    for number in range(_STEPS):
        if number:
            updated = moment_slopes(problem, jnp.asarray(variables), model.recording, frames)
            slopes = updated.reshape(len(slopes), -1)
        gram = slopes @ slopes.T + prior
        downhill = slopes @ residual - prior @ (variables - prior_mean)
        for _ in range(_TRIES):
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram)), downhill)
            tried = np.clip(variables + step, lower, upper)
            residual_tried = residual_at(tried)
            if cost(tried, residual_tried) < cost(variables, residual):
                variables, residual, damping = tried, residual_tried, 0.2 * damping
                break
            damping *= 10.0
    # The subject's derivatives are used, as its score test is what the replicates are for.
    return residual + (variables - prior_mean) @ linearized.slopes.reshape(len(linearized.slopes), -1)


@eqx.filter_jit
def _moments(
    problem: Objective, variables: Float[Array, " variable"], recording: Recording
) -> Float[Array, "trial coordinate frame"]:
    return joint_moments(problem.curves, problem.parameters(variables), recording)


@jax.jit
def _replicate_moments(
    parameters: ModelParameters, recording: Recording, emg_error: Float[Array, ""], key: PRNGKeyArray
) -> Float[Array, "trial coordinate frame"]:
    """Simulate the moments that inverse dynamics of a replicate would give, without noise."""
    curve_key, arm_key, electrode_key = jax.random.split(key, 3)
    path = recording.path.at(parameters.path_changes)
    scale = 1.0 + ARM_ERROR * jax.random.normal(arm_key, path.length.shape[:1])
    simulated = replace(
        recording,
        emg=_with_emg_noise(recording.emg, emg_error, electrode_key),
        path=fixed_path(_with_scaled_arms(path, scale)),
    )
    return joint_moments(ReplicateCurves.drawn(curve_key), parameters, simulated)


def _with_scaled_arms(path: PathState, scale: Float[Array, " muscle"]) -> PathState:
    """Scale moment arms, and the changes of length that go with them."""
    mean = path.length.mean(axis=(1, 2), keepdims=True)
    factor = scale[:, None, None]
    return PathState(
        mean + factor * (path.length - mean), factor * path.velocity, factor[..., None] * path.moment_arm
    )


def _with_emg_noise(emg: EmgSpline, error: Float[Array, ""], key: PRNGKeyArray) -> EmgSpline:
    """Multiply every envelope by smooth noise, independent between cycles and electrodes.

    Muscles of one electrode have the same envelope. A number computed from it seeds the noise, so that they
    get the same noise.
    """
    intervals = emg.coefficients.shape[-1]
    waves = max(2, round(1.0 / (2.0 * EMG_WIDTH)))
    phase = jnp.arange(intervals) / intervals
    basis = jnp.concatenate(
        [wave(2.0 * jnp.pi * jnp.arange(1, waves + 1)[:, None] * phase[None]) for wave in (jnp.sin, jnp.cos)]
    )

    def noisy(coefficients: Float[Array, "trial 4 interval"]) -> Float[Array, "trial 4 interval"]:
        electrode_key = jax.random.fold_in(key, _envelope_number(coefficients))
        weights = jax.random.normal(electrode_key, (coefficients.shape[0], 2 * waves)) / jnp.sqrt(waves)
        return coefficients * jnp.exp(error * weights @ basis)[:, None, :]

    return replace(emg, coefficients=jax.lax.map(noisy, emg.coefficients))


def _envelope_number(coefficients: Float[Array, "trial 4 interval"]) -> UInt[Array, ""]:
    mean = jnp.mean(jnp.abs(coefficients))
    return jnp.asarray(jax.lax.bitcast_convert_type(mean.astype(jnp.float32), jnp.int32)).astype(jnp.uint32)
