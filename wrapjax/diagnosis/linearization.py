"""What errors of EMG, of angles and of muscles themselves would do to the moments.

What a calibration expected of its variables before it saw a moment.

A calibrated model, its residuals and all that may explain them, as straight lines.

A score test looks at the model where calibration left it: how the prediction would change with what was
calibrated, with as much of each effect as is expected, and with errors of what was recorded. Residuals are
taken back to where calibrated parameters were expected, since their give is part of the null hypothesis.

Lines are drawn along EMG in the mean of the cycles of a speed. Along the recorded EMG they would hold its
noise, which residuals hold as well: what is like the bursts of a noisy envelope would then be found in
everyone (as in any regression on what is measured with error; Fuller 1987, doi:10.1002/9780470316665).
Residuals are taken back along the same lines. Along others, the difference of both would be left in them: a
little noise, times the long way to where parameters were expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.cycle_noise import CycleNoise, cycle_noise
from wrapjax.diagnosis.effects.effect import Effect, Effects
from wrapjax.diagnosis.null_covariance import InputErrors, MuscleErrors
from wrapjax.diagnosis.prediction import finite_difference_signatures
from wrapjax.diagnosis.projection import Candidate
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import MuscleState, Recording, joint_moments, muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.excitation import EmgSpline

#: Expected error of an EMG envelope, as a share of itself, and how long it goes on alike in gait cycles.
EMG_ERROR, EMG_WIDTH = 0.10, 0.04
#: Expected error of a joint angle (rad), and how long it goes on alike.
ANGLE_ERROR, ANGLE_WIDTH = np.radians(1.5), 0.08
#: Differences of activation, normalised fiber length and velocity at which errors of force are independent.
STATE_SCALES = (0.3, 0.075, 0.15)


def emg_errors(
    problem: Objective,
    variables: Float[Array, " variable"],
    by_variable: Float[np.ndarray, "variable cycle coordinate phase"],
    context: Context,
) -> InputErrors:
    """Run errors of EMG through the model: an envelope off by some share is a scale off by it just then.

    That is so for errors that last longer than muscles take to activate.
    """
    by_channel = np.zeros((len(context.channels), *by_variable.shape[1:]))
    for number, label in enumerate(problem.variables.labels):
        muscle, quantity = label.rsplit(".", 1)
        if quantity == "emg_scale":
            channel = context.muscle_channels[context.muscles.index(muscle)]
            by_channel[channel] += float(variables[number]) * by_variable[number]
    return InputErrors(EMG_ERROR * by_channel, EMG_WIDTH)


def angle_errors(
    problem: Objective,
    parameters: ModelParameters,
    recording: Recording,
    context: Context,
    frames: Int[np.ndarray, " phase"],
) -> tuple[InputErrors, ...]:
    """Run errors of angles through the paths; none where the paths are not known beside these angles."""
    by_angle = context.paths_by_angle
    if by_angle is None:
        return ()
    moved = _by_angle(problem.curves, parameters, recording, by_angle)
    return (InputErrors(ANGLE_ERROR * np.asarray(moved)[..., frames], ANGLE_WIDTH),)


@eqx.filter_jit
def _by_angle(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, by_angle: PathState
) -> Float[Array, "angle trial coordinate frame"]:
    """Differentiate moments by each angle at all frames alike, through the paths: N m per radian."""

    def moments(path: PathState) -> Float[Array, "trial coordinate frame"]:
        return joint_moments(curves, parameters, replace(recording, path=fixed_path(path)))

    nominal = recording.path.nominal
    here = PathState(nominal.length, nominal.velocity, nominal.moment_arm)

    def along(direction: PathState) -> Float[Array, "trial coordinate frame"]:
        return jax.jvp(moments, (here,), (direction,))[1]

    # One after the other: all at once would fill memory with muscles times frames times angles.
    return jax.lax.map(along, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), by_angle))


def muscle_errors(
    states: MuscleState, parameters: ModelParameters, frames: Int[np.ndarray, " phase"]
) -> MuscleErrors:
    """Say where each muscle is in its states, and what a unit of normalised force would move."""
    fiber = states.fiber
    quantities = (states.activation, fiber.normalized_length, fiber.normalized_velocity)
    scaled = [
        np.asarray(own)[..., frames] / scale for own, scale in zip(quantities, STATE_SCALES, strict=True)
    ]
    force = np.asarray(parameters.max_isometric_force)[:, None, None, None]
    return MuscleErrors(np.stack(scaled, axis=-1), np.asarray(states.path.moment_arm)[..., frames] * force)


def expectations(
    problem: Objective, variables: Float[Array | np.ndarray, " variable"]
) -> tuple[Float[np.ndarray, "variable sum"], Float[np.ndarray, " variable"]]:
    """Read what a calibration expects of its variables off all that it minimises but the moment error.

    Penalties are means over muscles of squares in allowable errors. As many times as much, an allowable
    error is one standard deviation of one muscle's quantity. Without them fibers would be free to be
    absurdly long, and any effect could hide in that.

    Returns
    -------
    spread, away
        A root of the prior covariance of the variables, and how far these are from where they are
        expected, both in solver units.
    """
    muscles = len(problem.variables.index)
    kept = replace(problem, moment_error=np.array(np.inf), alterations=())
    own = kept.linearized_at(jnp.asarray(variables))
    # Nothing is expected beyond its bounds; that also holds what no penalty sees.
    width = np.asarray(problem.upper) - np.asarray(problem.lower)
    precision = muscles * np.asarray(own.gauss_newton) + np.diag(1.0 / width**2)
    covariance = np.linalg.inv(precision)
    away = covariance @ (muscles * np.asarray(own.gradient))
    return np.linalg.cholesky(0.5 * (covariance + covariance.T)), away


#: Phases of a gait cycle that are looked at: residuals change little between them.
PHASES = 25


@dataclass(frozen=True)
class LinearizedModel:
    """What a score test takes in; signatures lead with what they are by, then ``cycle coordinate phase``.

    Parameters
    ----------
    residual
        Measured less predicted moments, N m, at the expected values of what was calibrated.
    fitted
        The same as calibration left it.
    slopes
        By each calibrated variable, in solver units.
    spread, away
        What is expected of these variables: see `expectations`.
    nuisances
        By each amount of the effects that are always allowed for, one prior standard deviation of it.
    candidates
        The effects that may be named.
    input_errors
        Of EMG and of angles.
    muscle_errors
        At one unit of normalised force.
    speeds
        Which speed each cycle was walked at, counted from 0 for the slowest.
    """

    residual: Float[np.ndarray, "cycle coordinate phase"]
    fitted: Float[np.ndarray, "cycle coordinate phase"]
    slopes: Float[np.ndarray, "variable cycle coordinate phase"]
    spread: Float[np.ndarray, "variable sum"]
    away: Float[np.ndarray, " variable"]
    nuisances: Float[np.ndarray, "amount cycle coordinate phase"]
    candidates: tuple[Candidate, ...]
    input_errors: tuple[InputErrors, ...]
    muscle_errors: MuscleErrors
    speeds: Int[np.ndarray, " cycle"]

    @cached_property
    def noise(self) -> CycleNoise:
        """What is new in each cycle, and how large errors of inputs are."""
        return cycle_noise(self.fitted, self.speeds, self.input_errors)

    @property
    def input_variance(self) -> Float[np.ndarray, "coordinate phase"]:
        """What errors of EMG and of angles make of the moments, in the mean of cycles, (N m)^2."""
        total = np.zeros(self.fitted.shape[1:])
        for share, errors in zip(self.noise.input_shares, self.input_errors, strict=True):
            total += share**2 * np.sum(errors.signatures**2, axis=0).mean(axis=0)
        return total

    @property
    def calibrated(self) -> Float[np.ndarray, "sum cycle coordinate phase"]:
        """By independent sums of calibrated variables, one prior standard deviation of each."""
        return np.tensordot(self.spread.T, self.slopes, axes=1)


def linearized_model(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    measured: Float[np.ndarray, "trial coordinate frame"],
    context: Context,
    effects: Sequence[Effect],
) -> LinearizedModel:
    """Draw all straight lines at a calibrated model.

    Parameters
    ----------
    problem, variables
        What was calibrated, and where it ended. Only what is variable, and its priors, count here.
    recording, measured, context
        Of the cycles that are looked at, which need not be those of the problem.
    effects
        Those that this recording can show.
    """
    parameters = problem.parameters(variables)
    frames = phase_frames(measured.shape[-1])
    curves = problem.curves

    def at_phases(values: Float[Array | np.ndarray, "*any frame"]) -> Float[np.ndarray, "*any phase"]:
        return np.asarray(values)[..., frames]

    speeds = speed_numbers(context.speeds)
    quiet = replace(recording, emg=in_the_mean(recording.emg, speeds))
    states = muscle_states(curves, parameters, quiet)
    by_variable = moment_slopes(problem, variables, quiet, frames)
    expected, away = expectations(problem, variables)
    fitted = at_phases(measured - np.asarray(joint_moments(curves, parameters, recording)))
    candidates, nuisances = [], [np.zeros((0, *fitted.shape))]
    for effect in effects:
        own = _candidate(effect, problem, parameters, quiet, frames)
        if effect.nuisance:
            nuisances += [
                (variant * own.prior_sd[:, None]).reshape(-1, *fitted.shape) for variant in own.variants
            ]
        else:
            candidates.append(own)
    return LinearizedModel(
        residual=fitted + np.tensordot(away, by_variable, axes=1),
        fitted=fitted,
        slopes=by_variable,
        spread=expected,
        away=away,
        nuisances=np.concatenate(nuisances),
        candidates=tuple(candidates),
        input_errors=(
            emg_errors(problem, variables, by_variable, context),
            *angle_errors(problem, parameters, quiet, context, frames),
        ),
        muscle_errors=muscle_errors(states, parameters, frames),
        speeds=speeds,
    )


def in_the_mean(emg: EmgSpline, speeds: Int[np.ndarray, " cycle"]) -> EmgSpline:
    """Take the mean of every envelope over the cycles of each speed, at the same part of the cycle."""
    alike = jnp.asarray(speeds[:, None] == speeds[None], dtype=float)
    mean = jnp.einsum("ct,mtpi->mcpi", alike / alike.sum(axis=1, keepdims=True), emg.coefficients)
    return replace(emg, coefficients=mean)


def phase_frames(frames: int) -> Int[np.ndarray, " phase"]:
    """Pick frames at equal distances round the cycle, whose last frame is its first; no frame twice."""
    phases = min(PHASES, frames - 1)
    return np.round(np.arange(phases) * (frames - 1) / phases).astype(int)


def speed_numbers(speeds: Float[np.ndarray, " cycle"]) -> Int[np.ndarray, " cycle"]:
    """Number speeds from the slowest; cycles of unknown speed count as of one."""
    known = np.unique(speeds[np.isfinite(speeds)])
    return np.where(np.isfinite(speeds), np.searchsorted(known, speeds), len(known)).astype(int)


def moment_slopes(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Float[np.ndarray, "variable cycle coordinate phase"]:
    """Differentiate predicted moments by the variables, muscle by muscle, over this recording (N m)."""
    shape = recording.path.nominal.moment_arm.shape[1:]
    own = Objective(
        curves=problem.curves,
        recording=recording,
        measured=jnp.zeros(shape),
        variables=problem.variables,
        penalties=(),
        limits=(),
        # Rows are then moments in N m.
        moment_error=np.array(1.0 / np.sqrt(np.prod(shape))),
    )
    return np.asarray(jax.jit(Objective.moment_jacobian)(own, variables)).T.reshape(-1, *shape)[..., frames]


def _candidate(
    effect: Effect,
    problem: Objective,
    parameters: ModelParameters,
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Candidate:
    variants = []
    for number in range(len(effect.variants)):
        found = finite_difference_signatures(
            problem.curves, parameters, recording, Effects((effect,), (number,))
        )
        variants.append(np.asarray(found)[..., frames].reshape(len(effect.parameters), -1))
    return Candidate(
        effect.id,
        tuple(variants),
        np.array([entry.prior_sd for entry in effect.parameters]),
        np.array([entry.sign == 1 for entry in effect.parameters]),
        effect.parts,
        np.array([entry.limit for entry in effect.parameters]),
    )
