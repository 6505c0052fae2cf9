"""Errors of EMG, of joint angles and of muscle force, and the change of the predicted moments by each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.diagnosis.inputs.priors import MOMENT_ARM_SD
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.model.forward import MuscleState, Recording, joint_moments, muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import AbstractCurves

#: Matrix over all residuals, in the order ``cycle coordinate phase``, the last index running fastest.
Matrix = Float[np.ndarray, "row row"]

#: Expected relative error of an EMG envelope, and its correlation width in gait cycles.
EMG_ERROR, EMG_WIDTH = 0.10, 0.04
#: Expected error of a joint angle (rad), and its correlation width in gait cycles.
ANGLE_ERROR, ANGLE_WIDTH = np.radians(1.5), 0.08
#: Differences of activation, normalised fiber length and velocity at which errors of force are independent.
STATE_SCALES = (0.3, 0.075, 0.15)
# Largest moment arm (m) of a muscle about a coordinate that it does not cross.
_SMALLEST_ARM = 0.002


@dataclass(frozen=True)
class InputErrors:
    """Errors of the model's inputs, smooth over a cycle and independent between cycles.

    Parameters
    ----------
    signatures
        Change of the predicted moments by an error of one standard deviation of each input at that phase
        alone, N m.
    width
        Correlation width of the errors in gait cycles; see `periodic_kernel`.
    """

    signatures: Float[np.ndarray, "input cycle coordinate phase"]
    width: float


@dataclass(frozen=True)
class MuscleErrors:
    """Errors of muscle force that depend on the muscle's state, the same in every cycle.

    Parameters
    ----------
    states
        Activation, normalised fiber length and velocity, each divided by the distance at which errors
        become independent.
    arms
        Moment by one unit of error: moment arm times maximum isometric force, N m.
    """

    states: Float[np.ndarray, "muscle cycle phase quantity"]
    arms: Float[np.ndarray, "muscle cycle coordinate phase"]


def emg_errors(
    problem: Objective,
    variables: Float[Array, " variable"],
    by_variable: Float[np.ndarray, "variable cycle coordinate phase"],
    context: Context,
) -> InputErrors:
    """Compute the change of the moments by relative errors of each EMG channel.

    An error of the envelope is treated as an error of the EMG scales of the channel's muscles at that phase,
    which holds for errors that last longer than activation takes.

    Parameters
    ----------
    problem, variables
        Calibration and its variables.
    by_variable
        Derivatives of the moments by the variables, N m.
    context
        Context of the cycles.
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
    """Compute the change of the moments by errors of joint angles through the muscle paths.

    Returns none where the derivatives of the paths by the angles are not known.
    """
    by_angle = context.paths_by_angle
    if by_angle is None:
        return ()
    changes = _moments_by_angle(problem.curves, parameters, recording, by_angle)
    return (InputErrors(ANGLE_ERROR * np.asarray(changes)[..., frames], ANGLE_WIDTH),)


@eqx.filter_jit
def _moments_by_angle(
    curves: AbstractCurves, parameters: ModelParameters, recording: Recording, by_angle: PathState
) -> Float[Array, "angle trial coordinate frame"]:
    """Differentiate moments by each angle, equally off at all frames, through the paths; N m per radian."""

    def moments(path: PathState) -> Float[Array, "trial coordinate frame"]:
        return joint_moments(curves, parameters, replace(recording, path=fixed_path(path)))

    nominal = recording.path.nominal
    at = PathState(nominal.length, nominal.velocity, nominal.moment_arm)

    def along(direction: PathState) -> Float[Array, "trial coordinate frame"]:
        return jax.jvp(moments, (at,), (direction,))[1]

    # One after the other: all at once would need memory for muscles times frames times angles.
    return jax.lax.map(along, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), by_angle))


def moment_arm_errors(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    context: Context,
    frames: Int[np.ndarray, " phase"],
) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Compute the change of the moments by a constant error of each moment arm, one standard deviation, N m.

    The length of the path changes with the angle as the arm says. Arms about coordinates that a muscle does
    not cross have no errors.
    """
    path = recording.path.at(parameters.path_changes)
    angles, velocities = jnp.asarray(context.angles), jnp.asarray(context.velocities)
    changes = np.asarray(_moments_by_arm(curves, parameters, recording, path, angles, velocities))
    crossed = np.abs(np.asarray(path.moment_arm)).max(axis=(1, 3)).T > _SMALLEST_ARM
    return MOMENT_ARM_SD * changes[crossed][..., frames]


@eqx.filter_jit
def _moments_by_arm(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    path: PathState,
    angles: Float[Array, "trial coordinate frame"],
    velocities: Float[Array, "trial coordinate frame"],
) -> Float[Array, "coordinate muscle trial coordinate frame"]:
    """Differentiate each muscle's moments by a constant change of its moment arms, N m per m."""
    at = PathState(path.length, path.velocity, path.moment_arm)

    def moments(path: PathState) -> Float[Array, "muscle trial coordinate frame"]:
        return muscle_states(curves, parameters, replace(recording, path=fixed_path(path))).moment

    def along(coordinate: Int[Array, ""]) -> Float[Array, "muscle trial coordinate frame"]:
        angle, velocity = angles[:, coordinate], velocities[:, coordinate]
        direction = PathState(
            jnp.broadcast_to(angle.mean() - angle, at.length.shape),
            jnp.broadcast_to(-velocity, at.velocity.shape),
            jnp.zeros_like(at.moment_arm).at[:, :, coordinate].set(1.0),
        )
        return jax.jvp(moments, (at,), (direction,))[1]

    return jax.lax.map(along, jnp.arange(angles.shape[1]))


def muscle_errors(
    states: MuscleState, parameters: ModelParameters, frames: Int[np.ndarray, " phase"]
) -> MuscleErrors:
    """Collect muscle states, and the moments by one unit of normalised force, at these frames."""
    fiber = states.fiber
    quantities = (states.activation, fiber.normalized_length, fiber.normalized_velocity)
    scaled = [
        np.asarray(quantity)[..., frames] / scale
        for quantity, scale in zip(quantities, STATE_SCALES, strict=True)
    ]
    force = np.asarray(parameters.max_isometric_force)[:, None, None, None]
    return MuscleErrors(np.stack(scaled, axis=-1), np.asarray(states.path.moment_arm)[..., frames] * force)


def periodic_kernel(phases: int, width: float) -> Float[np.ndarray, "phase phase"]:
    """Compute the correlation of a smooth periodic function between equally spaced phases of the gait cycle.

    Parameters
    ----------
    phases
        Number of phases; the first is not repeated at the end.
    width
        Lag, in gait cycles, at which a narrow kernel falls to ``exp(-1/2)``.
    """
    lag = np.subtract.outer(np.arange(phases), np.arange(phases)) / phases
    return np.exp(-0.5 * (np.sin(np.pi * lag) / (np.pi * width)) ** 2)


def block_diagonal(blocks: Float[np.ndarray, "cycle own own"]) -> Matrix:
    """Assemble the covariance of all cycles from the covariance within each, (N m)^2."""
    cycles, rows, _ = blocks.shape
    total = np.zeros((cycles, rows, cycles, rows))
    index = np.arange(cycles)
    total[index, :, index, :] = blocks
    return total.reshape(cycles * rows, cycles * rows)


def input_blocks(errors: InputErrors) -> Float[np.ndarray, "cycle own own"]:
    """Compute the covariance of the moments within each cycle by errors of inputs, (N m)^2."""
    _, cycles, coordinates, phases = errors.signatures.shape
    kernel = periodic_kernel(phases, errors.width)
    outer = np.einsum("ickp,iclq->ckplq", errors.signatures, errors.signatures)
    blocks = outer * kernel[None, None, :, None, :]
    return np.asarray(blocks.reshape(cycles, coordinates * phases, coordinates * phases))
