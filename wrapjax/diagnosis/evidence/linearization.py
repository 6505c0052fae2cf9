"""The calibrated model, its residual and all effects to first order about the baseline fit.

A score test examines the model where the calibration ended: the derivatives of the predicted moments by
calibrated variables, the signatures of the effects, and the changes by errors of the inputs. The residual is
moved to the prior mean of the calibrated variables, since their deviation from it is part of the null
hypothesis.

Derivatives and signatures use the mean EMG over the cycles of a speed. With the recorded EMG they would
contain its noise, which residuals contain as well; effects similar to the bursts of a noisy envelope would
then be found in every recording (as in any regression on variables measured with error; Fuller 1987,
doi:10.1002/9780470316665). The residual is moved with the same derivatives. With others, the difference of
both, a little noise times the large distance from the prior mean, would remain in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.effects.effect import Effect, Effects, scale_prior
from wrapjax.diagnosis.fits.prediction import finite_difference_signatures
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames, speed_numbers
from wrapjax.diagnosis.null_hypotheses.cycle_noise import CycleNoise, cycle_noise
from wrapjax.diagnosis.null_hypotheses.error_sources import (
    InputErrors,
    MuscleErrors,
    angle_errors,
    emg_errors,
    moment_arm_errors,
    muscle_errors,
)
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import (
    undriven_signatures,
    unrecorded_moment_signatures,
)
from wrapjax.model.forward import Recording, joint_moments, muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.excitation import EmgSpline
from wrapjax.threads import map_in_threads

Signature = Float[np.ndarray, "parameter row"]


@dataclass(frozen=True)
class Candidate:
    """Effect that the diagnosis may name as a cause: its signatures and prior.

    Parameters
    ----------
    id
        Identifier of the effect.
    variants
        Signatures of each variant, N m per unit of each parameter.
    prior_sd
        Prior standard deviations of the parameters.
    one_sided
        Whether each parameter cannot be negative.
    parts
        Numbers of the parameters of each part: as a rule the effect is present in one part only. Empty where
        all parameters belong together.
    limit
        Largest plausible effect sizes.
    """

    id: str
    variants: tuple[Signature, ...]
    prior_sd: Float[np.ndarray, " parameter"]
    one_sided: Bool[np.ndarray, " parameter"]
    parts: tuple[tuple[int, ...], ...] = ()
    limit: Float[np.ndarray, " parameter"] | float = np.inf

    def scaled_prior_sd(self, factor: float) -> Float[np.ndarray, " parameter"]:
        """Multiply the prior standard deviations by a factor, within the limits; see `scale_prior`."""
        return scale_prior(self.prior_sd, factor, self.limit)

    @property
    def hypotheses(self) -> tuple[tuple[tuple[int, ...], float], ...]:
        """Numbers of the parameters that are not zero, with the prior probability of each such hypothesis.

        Half of the probability is that of all parts, half that of one part alone.
        """
        everything = tuple(range(len(self.prior_sd)))
        if len(self.parts) < 2:
            return ((everything, 1.0),)
        return ((everything, 0.5), *((part, 0.5 / len(self.parts)) for part in self.parts))

    def log_prior(self, part: tuple[int, ...]) -> float:
        """Logarithm of the prior probability of one variant with these parameters."""
        return float(np.log(dict(self.hypotheses)[part] / len(self.variants)))


@dataclass(frozen=True)
class LinearizedModel:
    """The plain model and all effects to first order about the baseline fit, over the calibration cycles.

    Parameters
    ----------
    residual
        Measured less predicted moments, N m, at the prior mean of the calibrated variables.
    fitted_residual
        Measured less predicted moments, N m, as the calibration left them.
    slopes
        Derivatives of the predicted moments by the calibrated variables, in solver units, N m.
    prior_root, from_prior_mean
        Root of the prior covariance of the variables, and their deviation from the prior mean; see
        `parameter_prior`.
    nuisances
        Signatures of one prior standard deviation of each parameter of the nuisance effects, N m.
    candidates
        Effects that may be named.
    input_errors
        Errors of EMG and of angles, at their expected sizes.
    muscle_errors
        Errors of muscle force, of one unit of normalised force.
    speeds
        Speed number of each cycle, counted from 0 for the slowest.
    known_noise
        Noise where it was estimated from more cycles than these; None to estimate it from these.
    """

    residual: Float[np.ndarray, "cycle coordinate phase"]
    fitted_residual: Float[np.ndarray, "cycle coordinate phase"]
    slopes: Float[np.ndarray, "variable cycle coordinate phase"]
    prior_root: Float[np.ndarray, "variable sum"]
    from_prior_mean: Float[np.ndarray, " variable"]
    nuisances: Float[np.ndarray, "parameter cycle coordinate phase"]
    candidates: tuple[Candidate, ...]
    input_errors: tuple[InputErrors, ...]
    muscle_errors: MuscleErrors
    speeds: Int[np.ndarray, " cycle"]
    known_noise: CycleNoise | None = None

    @cached_property
    def noise(self) -> CycleNoise:
        """Noise that differs from cycle to cycle, and the size of the input errors."""
        if self.known_noise is not None:
            return self.known_noise
        return cycle_noise(self.fitted_residual, self.speeds, self.input_errors)

    def restricted(
        self, cycles: Int[np.ndarray, " chosen"], coordinates: Int[np.ndarray, " kept"]
    ) -> LinearizedModel:
        """Select cycles and coordinates; the noise stays that of all cycles."""

        def select(values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
            """Select along the axes ``cycle coordinate phase``, the last three."""
            return np.asarray(values)[..., cycles, :, :][..., coordinates, :]

        shape = self.residual.shape

        def select_rows(variant: Signature) -> Float[np.ndarray, "parameter kept_row"]:
            return select(variant.reshape(-1, *shape)).reshape(len(variant), -1)

        return replace(
            self,
            residual=select(self.residual),
            fitted_residual=select(self.fitted_residual),
            slopes=select(self.slopes),
            nuisances=select(self.nuisances),
            candidates=tuple(
                replace(one, variants=tuple(map(select_rows, one.variants))) for one in self.candidates
            ),
            input_errors=tuple(replace(one, signatures=select(one.signatures)) for one in self.input_errors),
            muscle_errors=replace(
                self.muscle_errors,
                states=self.muscle_errors.states[:, cycles],
                arms=select(self.muscle_errors.arms),
            ),
            speeds=self.speeds[cycles],
            known_noise=self.noise.of_coordinates(coordinates),
        )

    @property
    def input_variance(self) -> Float[np.ndarray, "coordinate phase"]:
        """Variance of the moments by errors of EMG and of angles, in the mean over cycles, (N m)^2."""
        total = np.zeros(self.fitted_residual.shape[1:])
        for share, errors in zip(self.noise.input_shares, self.input_errors, strict=True):
            total += share**2 * np.sum(errors.signatures**2, axis=0).mean(axis=0)
        return total

    @property
    def calibrated(self) -> Float[np.ndarray, "sum cycle coordinate phase"]:
        """Changes of the moments by one prior standard deviation of independent sums of variables, N m."""
        return np.tensordot(self.prior_root.T, self.slopes, axes=1)

    @property
    def parameter_sd(self) -> Float[np.ndarray, " variable"]:
        """Prior standard deviation of each calibrated variable, in solver units."""
        return np.sqrt(np.sum(self.prior_root**2, axis=1))


def linearize(data: DiagnosisInput, variables: Float[np.ndarray, " variable"]) -> LinearizedModel:
    """Linearise the plain model and all testable effects over the calibration cycles.

    Parameters
    ----------
    data
        Input of the diagnosis.
    variables
        Calibrated variables about which to linearise.
    """
    return linearized_model(
        data.law.free,
        jnp.asarray(data.law.with_free_law(variables)),
        data.calibration_recording,
        data.measured[data.plan.calibration],
        data.calibration_context,
        tuple(data.calibration_effects.values()),
    )


def linearized_model(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    measured: Float[np.ndarray, "trial coordinate frame"],
    context: Context,
    effects: Sequence[Effect],
    groups: Int[np.ndarray, " cycle"] | None = None,
) -> LinearizedModel:
    """Linearise a calibrated model and effects over some cycles.

    Parameters
    ----------
    problem, variables
        Calibration and its variables. Only its variables and their priors are used, not its cycles.
    recording, measured, context
        Inputs of the forward model, measured moments (N m), and context of the cycles.
    effects
        Effects that are testable on these cycles.
    groups
        Number of the group of each cycle whose cycles repeat each other, counted from 0; by speed if None.
    """
    parameters = problem.parameters(variables)
    frames = phase_frames(measured.shape[-1])
    curves = problem.curves
    speeds = speed_numbers(context.speeds) if groups is None else groups
    averaged = replace(recording, emg=mean_emg(recording.emg, speeds))
    states = muscle_states(curves, parameters, averaged)
    slopes = moment_slopes(problem, variables, averaged, frames)
    prior_root, from_prior_mean = parameter_prior(problem, variables)
    fitted = np.asarray(measured - np.asarray(joint_moments(curves, parameters, recording)))[..., frames]
    candidates = []
    nuisances = [
        moment_arm_errors(curves, parameters, averaged, context, frames),
        undriven_signatures(context, frames),
        unrecorded_moment_signatures(context, measured[..., frames], speeds),
    ]
    of_effects = map_in_threads(
        lambda effect: _candidate(effect, problem, parameters, averaged, frames), effects
    )
    for effect, candidate in zip(effects, of_effects, strict=True):
        if effect.nuisance:
            nuisances += [
                (variant * candidate.prior_sd[:, None]).reshape(-1, *fitted.shape)
                for variant in candidate.variants
            ]
        else:
            candidates.append(candidate)
            nuisances.append(_usual_spread(effect, candidate, fitted.shape))
    return LinearizedModel(
        residual=fitted + np.tensordot(from_prior_mean, slopes, axes=1),
        fitted_residual=fitted,
        slopes=slopes,
        prior_root=prior_root,
        from_prior_mean=from_prior_mean,
        nuisances=np.concatenate(nuisances),
        candidates=tuple(candidates),
        input_errors=(
            emg_errors(problem, variables, slopes, context),
            *angle_errors(problem, parameters, averaged, context, frames),
        ),
        muscle_errors=muscle_errors(states, parameters, frames),
        speeds=speeds,
    )


def mean_emg(emg: EmgSpline, speeds: Int[np.ndarray, " cycle"]) -> EmgSpline:
    """Average every envelope over the cycles of each speed, at the same phase of the cycle."""
    same = jnp.asarray(speeds[:, None] == speeds[None], dtype=float)
    mean = jnp.einsum("ct,mtpi->mcpi", same / same.sum(axis=1, keepdims=True), emg.coefficients)
    return replace(emg, coefficients=mean)


def parameter_prior(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"]
) -> tuple[Float[np.ndarray, "variable sum"], Float[np.ndarray, " variable"]]:
    """Derive the prior of the calibrated variables from all terms of the objective but the moment error.

    Penalties are means over muscles of squares in allowable errors. Multiplied by the number of muscles, one
    allowable error is one standard deviation of one muscle's quantity. Without the penalties fibers could be
    implausibly long, and any effect could be absorbed by that.

    Returns
    -------
    root, deviation
        Root of the prior covariance of the variables, and their deviation from the prior mean, in solver
        units.
    """
    muscles = len(problem.variables.index)
    penalties = replace(problem, moment_error=np.array(np.inf), alterations=())
    model = penalties.linearized_at(jnp.asarray(variables))
    # The bounds give a wide prior to variables that no penalty concerns.
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    precision = muscles * np.asarray(model.gauss_newton) + np.diag(1.0 / width**2)
    covariance = np.linalg.inv(precision)
    deviation = covariance @ (muscles * np.asarray(model.gradient))
    return np.linalg.cholesky(0.5 * (covariance + covariance.T)), deviation


def moment_slopes(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Float[np.ndarray, "variable cycle coordinate phase"]:
    """Differentiate the predicted moments over this recording by the variables, muscle by muscle, N m."""
    chosen = recording.at_frames(frames)
    shape = chosen.path.nominal.moment_arm.shape[1:]
    moments_only = Objective(
        curves=problem.curves,
        recording=chosen,
        measured=jnp.zeros(shape),
        variables=problem.variables,
        penalties=(),
        limits=(),
        # With this error the rows of the Jacobian are moments in N m.
        moment_error=np.array(1.0 / np.sqrt(np.prod(shape))),
    )
    jacobian = jax.jit(Objective.moment_jacobian)(moments_only, variables)
    return np.asarray(jacobian).T.reshape(-1, *shape)


def _usual_spread(
    effect: Effect, candidate: Candidate, shape: tuple[int, ...]
) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Compute the signatures of one standard deviation between people without the effect, N m.

    One variant holds in a person, each with the same probability: the covariance is the mean over variants.
    """
    usual_sd = np.array([entry.usual_sd for entry in effect.parameters]) / np.sqrt(len(candidate.variants))
    usual = np.flatnonzero(usual_sd)
    signatures = [usual_sd[usual, None] * variant[usual] for variant in candidate.variants]
    return np.concatenate(signatures).reshape(-1, *shape)


def _candidate(
    effect: Effect,
    problem: Objective,
    parameters: ModelParameters,
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Candidate:
    variants = []
    for number in range(len(effect.variants)):
        signature = finite_difference_signatures(
            problem.curves, parameters, recording, Effects((effect,), (number,))
        )
        variants.append(np.asarray(signature)[..., frames].reshape(len(effect.parameters), -1))
    return Candidate(
        effect.id,
        tuple(variants),
        np.array([entry.prior_sd for entry in effect.parameters]),
        np.array([entry.sign == 1 for entry in effect.parameters]),
        effect.parts,
        np.array([entry.limit for entry in effect.parameters]),
    )
