"""From EMG and muscle paths to joint moments: the only forward model there is."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from wrapjax.geometry import AbstractPath, PathState
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle import (
    EmgSpline,
    FiberState,
    HillCurves,
    muscle_activation,
    neural_activation,
    rigid_tendon_fiber,
)


class Recording(eqx.Module):
    """What was recorded of all cycles, as the model takes it in."""

    #: Leaves lead with ``muscle``.
    emg: EmgSpline
    path: AbstractPath
    #: Frames of EMG before and after each cycle.
    padding: int = eqx.field(static=True)


class MuscleState(eqx.Module):
    """What a muscle does over all cycles."""

    #: After delay and scale, padding trimmed.
    excitation: Float[Array, "*muscle trial frame"]
    activation: Float[Array, "*muscle trial frame"]
    path: PathState
    fiber: FiberState
    #: Its part of every joint moment, N m.
    moment: Float[Array, "*muscle trial coordinate frame"]


def muscle_state_along(
    path: PathState, curves: HillCurves, parameters: ModelParameters, emg: EmgSpline, padding: int
) -> MuscleState:
    """Run one muscle along a path over all cycles.

    Of the path, the tendon force at a frame depends on length and rate at that frame alone.

    Parameters
    ----------
    path, parameters, emg
        Of one muscle.
    curves
        Normalised force curves.
    padding
        Frames of EMG before and after each cycle.
    """
    excitation = parameters.emg_scale * emg.at_delay(parameters.electromechanical_delay)
    neural = neural_activation(excitation, parameters.activation_time_constant, emg.step)
    inside = slice(padding, neural.shape[-1] - padding)
    activation = muscle_activation(jnp.maximum(neural[:, inside], 0.0), parameters.activation_nonlinearity)
    fiber = rigid_tendon_fiber(
        curves,
        activation,
        path.length,
        path.velocity,
        max_isometric_force=parameters.max_isometric_force,
        optimal_fiber_length=parameters.optimal_fiber_length,
        tendon_slack_length=parameters.tendon_slack_length,
        pennation_angle=parameters.pennation_angle,
        max_fiber_velocity=parameters.max_fiber_velocity,
    )
    moment = path.moment_arm * fiber.tendon_force[:, None, :]
    return MuscleState(excitation[:, inside], activation, path, fiber, moment)


def muscle_states(curves: HillCurves, parameters: ModelParameters, recording: Recording) -> MuscleState:
    """Run every muscle over all cycles; leaves of the result lead with ``muscle``."""
    path = recording.path.at(parameters.path_changes)
    return jax.vmap(muscle_state_along, in_axes=(0, None, 0, 0, None))(
        path, curves, parameters, recording.emg, recording.padding
    )


def joint_moments(
    curves: HillCurves, parameters: ModelParameters, recording: Recording
) -> Float[Array, "trial coordinate frame"]:
    """Predict the joint moments of all cycles, in N m (sign of the model's coordinates)."""
    return muscle_states(curves, parameters, recording).moment.sum(axis=0)
