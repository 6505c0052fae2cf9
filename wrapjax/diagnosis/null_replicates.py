"""People like the subject, with nothing amiss: what evidence is found where there is nothing to find.

A twin has the subject's angles, EMG and calibrated parameters, but muscles with force curves of another
form, moment arms that are a little off, electrodes and moments with noise of their own. It is calibrated
again, to first order, and scored. No threshold from a table of distributions would do: what is left of a
model whose curves are not a person's own is not noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.cycle_noise import CycleNoise
from wrapjax.diagnosis.linearization import EMG_ERROR, EMG_WIDTH, LinearizedModel, moment_slopes, phase_frames
from wrapjax.diagnosis.null_covariance import input_blocks
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import Recording, joint_moments
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.excitation import EmgSpline

#: How far moment arms are off, as a share of themselves, and parameters, in prior standard deviations.
ARM_ERROR, PARAMETER_ERROR = 0.08, 0.3
# Steps of calibrating a twin again, each with slopes of its own, and how many lengths of each are tried.
_ROUNDS, _TRIES = 5, 4


class TwinCurves(AbstractCurves):
    """Force curves by other formulas than the model's, each person's a little different."""

    #: Of the active curve's flanks: short side, long side.
    width: Float[Array, "2"]
    #: How flat its top is; 2 for a normal curve.
    power: Float[Array, ""]
    #: Hill's a over F0, and the largest force of lengthening fibers.
    shortening: Float[Array, ""]
    plateau: Float[Array, ""]
    #: Strain at which passive force is F0, and how steep it gets there.
    strain: Float[Array, ""]
    steepness: Float[Array, ""]

    @classmethod
    def drawn(cls, key: PRNGKeyArray) -> TwinCurves:
        """Draw a person's curves; ranges are those of textbooks and common models."""
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
        off = jnp.sqrt((length - 1.0) ** 2 + 1e-6)
        return jnp.exp(-((off / jnp.where(length < 1.0, self.width[0], self.width[1])) ** self.power))

    def force_velocity(self, velocity: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Hill's hyperbola, and another one for lengthening fibers with the slope that it has at zero."""
        slow = jnp.clip(velocity, -1.0, 0.0)
        fast = jnp.clip(velocity, 0.0, 1.5)
        shortening = (1.0 + slow) / (1.0 - slow / self.shortening)
        slope = 1.0 + 1.0 / self.shortening
        gain = self.plateau - 1.0
        return jnp.where(velocity < 0.0, shortening, 1.0 + gain * slope * fast / (gain + slope * fast))

    def passive_force(self, length: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Nothing below optimal length, exponential above."""
        stretch = jnp.clip(length - 1.0, 0.0, 1.2) / self.strain
        return jnp.expm1(self.steepness * stretch) / jnp.expm1(self.steepness)


@dataclass(frozen=True)
class NullModel:
    """What all twins of a subject share.

    Parameters
    ----------
    problem, variables
        The calibrated plain model.
    recording
        Of the cycles that are looked at.
    gap
        Its straight lines.
    noise
        Of measured moments, and how large errors of EMG and angles are.
    """

    problem: Objective
    variables: Float[np.ndarray, " variable"]
    recording: Recording
    gap: LinearizedModel
    noise: CycleNoise

    @property
    def emg_error(self) -> float:
        """Error of an envelope as a share of itself; what is expected where nothing is known of it."""
        shares = self.noise.input_shares
        return EMG_ERROR * (shares[0] if shares else 1.0)

    def measured_noise(self, phases: int) -> Float[np.ndarray, "cycle own own"]:
        """Give a root of the covariance within each cycle of noise of moments and of errors of angles.

        Errors of EMG are no part of it: a twin lives by other envelopes than were recorded.
        """
        block = self.noise.block(phases)
        whole = np.repeat(block[None], self.gap.slopes.shape[1], axis=0)
        for share, errors in zip(self.noise.input_shares[1:], self.gap.input_errors[1:], strict=True):
            whole += share**2 * input_blocks(errors)
        return np.linalg.cholesky(whole + 1e-9 * np.eye(len(block)))


def null_replicate_residuals(world: NullModel, count: int, seed: int = 0) -> Float[np.ndarray, "twin row"]:
    """Make twins and calibrate them; give residuals as a score test takes them in (see `LinearizedModel`).

    Parameters
    ----------
    world
        The subject.
    count
        How many twins.
    seed
        Equal seeds give equal twins.
    """
    recording, gap, layout = world.recording, world.gap, world.problem.variables
    _, cycles, coordinates, phases = gap.slopes.shape
    frames = phase_frames(recording.path.nominal.length.shape[-1])
    noise = world.measured_noise(phases)
    residuals: list[np.ndarray] = []
    for number, key in enumerate(jax.random.split(jax.random.key(seed), count)):
        own = jax.random.split(key, 2)
        shift = PARAMETER_ERROR * gap.spread @ np.asarray(jax.random.normal(own[0], gap.away.shape))
        truth = np.clip(world.variables + shift, layout.lower, layout.upper)
        lived = _twin_moments(
            layout.unpack(jnp.asarray(truth)), recording, jnp.asarray(world.emg_error), own[1]
        )
        draws = np.random.default_rng([seed, number]).normal(size=(cycles, coordinates * phases))
        measured = np.asarray(lived)[..., frames].reshape(cycles, -1)
        measured = measured + np.einsum("cij,cj->ci", noise, draws)
        residuals.append(_expected_residual(world, measured.ravel(), frames))
    return np.array(residuals)


def _expected_residual(
    world: NullModel, measured: Float[np.ndarray, " row"], frames: Int[np.ndarray, " phase"]
) -> Float[np.ndarray, " row"]:
    """Calibrate by damped Gauss-Newton steps, and take what is left to where parameters are expected."""
    problem, gap = world.problem, world.gap
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    # Moments as exact as the subject's fit left them, parameters as free as they were.
    prior = np.mean(gap.fitted**2) * np.linalg.inv(gap.spread @ gap.spread.T)
    expected = world.variables - gap.away

    def left(at: Float[np.ndarray, " variable"]) -> Float[np.ndarray, " row"]:
        predicted = _moments(problem, jnp.asarray(at), world.recording)
        return measured - np.asarray(predicted)[..., frames].ravel()

    def cost(at: Float[np.ndarray, " variable"], residual: Float[np.ndarray, " row"]) -> float:
        return float(residual @ residual + (at - expected) @ prior @ (at - expected))

    at = np.array(world.variables)
    residual = left(at)
    slopes = gap.slopes.reshape(len(gap.slopes), -1)
    damping = 1e-2
    for number in range(_ROUNDS):
        if number:
            anew = moment_slopes(problem, jnp.asarray(at), world.recording, frames)
            slopes = anew.reshape(len(slopes), -1)
        gram = slopes @ slopes.T + prior
        downhill = slopes @ residual - prior @ (at - expected)
        for _ in range(_TRIES):
            step = np.linalg.solve(gram + damping * np.diag(np.diag(gram)), downhill)
            tried = np.clip(at + step, lower, upper)
            found = left(tried)
            if cost(tried, found) < cost(at, residual):
                at, residual, damping = tried, found, 0.2 * damping
                break
            damping *= 10.0
    # Straight lines are the subject's: it is its score that is tried.
    return residual + (at - expected) @ gap.slopes.reshape(len(gap.slopes), -1)


@eqx.filter_jit
def _moments(
    problem: Objective, variables: Float[Array, " variable"], recording: Recording
) -> Float[Array, "trial coordinate frame"]:
    return joint_moments(problem.curves, problem.parameters(variables), recording)


@jax.jit
def _twin_moments(
    parameters: ModelParameters, recording: Recording, emg_error: Float[Array, ""], key: PRNGKeyArray
) -> Float[Array, "trial coordinate frame"]:
    """Give what inverse dynamics of a twin would measure, without noise."""
    curves, arms, electrodes = jax.random.split(key, 3)
    path = recording.path.at(parameters.path_changes)
    scale = 1.0 + ARM_ERROR * jax.random.normal(arms, path.length.shape[:1])
    lived = replace(
        recording,
        emg=_with_noise(recording.emg, emg_error, electrodes),
        path=fixed_path(_with_arms(path, scale)),
    )
    return joint_moments(TwinCurves.drawn(curves), parameters, lived)


def _with_arms(path: PathState, scale: Float[Array, " muscle"]) -> PathState:
    """Scale moment arms, and the changes of length that go with them."""
    mean = path.length.mean(axis=(1, 2), keepdims=True)
    by = scale[:, None, None]
    return PathState(mean + by * (path.length - mean), by * path.velocity, by[..., None] * path.moment_arm)


def _with_noise(emg: EmgSpline, error: Float[Array, ""], key: PRNGKeyArray) -> EmgSpline:
    """Let every electrode be off by a share of itself that wanders over each cycle.

    Muscles of one electrode have the same envelope: one that a number made of it draws the noise by.
    """
    intervals = emg.coefficients.shape[-1]
    waves = max(2, round(1.0 / (2.0 * EMG_WIDTH)))
    phase = jnp.arange(intervals) / intervals
    basis = jnp.concatenate(
        [wave(2.0 * jnp.pi * jnp.arange(1, waves + 1)[:, None] * phase[None]) for wave in (jnp.sin, jnp.cos)]
    )

    def of_one(coefficients: Float[Array, "trial 4 interval"]) -> Float[Array, "trial 4 interval"]:
        own = jax.random.fold_in(key, _number_of(coefficients))
        weights = jax.random.normal(own, (coefficients.shape[0], 2 * waves)) / jnp.sqrt(waves)
        return coefficients * jnp.exp(error * weights @ basis)[:, None, :]

    return replace(emg, coefficients=jax.lax.map(of_one, emg.coefficients))


def _number_of(coefficients: Float[Array, "trial 4 interval"]) -> UInt[Array, ""]:
    mean = jnp.mean(jnp.abs(coefficients))
    return jnp.asarray(jax.lax.bitcast_convert_type(mean.astype(jnp.float32), jnp.int32)).astype(jnp.uint32)
