"""What errors of EMG, of angles and of muscles themselves would do to the moments."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibrate import Objective
from wrapjax.gap.context import Context
from wrapjax.gap.evidence.covariance import InputErrors, MuscleErrors
from wrapjax.geometry import PathState, fixed_path
from wrapjax.model import ModelParameters, MuscleState, Recording, joint_moments
from wrapjax.muscle import AbstractCurves

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
