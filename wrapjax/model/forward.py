"""From EMG and muscle paths to joint moments: the only forward model there is."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.geometry.paths import AbstractPath, PathState, fixed_path
from wrapjax.model.alteration import (
    Alteration,
    MuscleAlteration,
    MuscleInputs,
    altered_emg,
    altered_moments,
    altered_paths,
    muscle_alterations,
)
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.activation import muscle_activation, neural_activation
from wrapjax.muscle.curves import AbstractCurves
from wrapjax.muscle.excitation import EmgSpline
from wrapjax.muscle.hill import FiberState, rigid_tendon_fiber


class Recording(eqx.Module):
    """What was recorded of all cycles, as the model takes it in."""

    #: Leaves lead with ``muscle``.
    emg: EmgSpline
    path: AbstractPath
    #: Frames of EMG before and after each cycle.
    padding: int = eqx.field(static=True)

    def select_trials(self, trials: Int[np.ndarray, " chosen"]) -> Recording:
        """Keep some cycles, by their numbers; paths stay as they are nominally, and are held."""
        emg, nominal = jax.tree.map(lambda leaf: leaf[:, trials], (self.emg, _frames(self.path.nominal)))
        return Recording(emg, fixed_path(nominal), self.padding)


class MuscleState(eqx.Module):
    """What a muscle does over all cycles."""

    #: After delay and scale, padding trimmed.
    excitation: Float[Array, "*muscle trial frame"]
    activation: Float[Array, "*muscle trial frame"]
    path: PathState
    fiber: FiberState
    #: Its part of every joint moment, N m.
    moment: Float[Array, "*muscle trial coordinate frame"]


def _frames(path: PathState) -> PathState:
    """Keep what a path is at every frame, not what it is as a whole."""
    return PathState(path.length, path.velocity, path.moment_arm)


def muscle_state_along(
    path: PathState,
    curves: AbstractCurves,
    parameters: ModelParameters,
    emg: EmgSpline,
    padding: int,
    alterations: tuple[MuscleAlteration, ...] = (),
) -> MuscleState:
    """Run one muscle along a path over all cycles.

    Of the path, the tendon force of a muscle that is not altered depends, at a frame, on length and rate
    at that frame alone.

    Parameters
    ----------
    path, parameters, emg
        Of one muscle.
    curves
        Normalised force curves.
    padding
        Frames of EMG before and after each cycle.
    alterations
        Of this muscle, in their order.
    """
    inputs = MuscleInputs(curves, parameters, path, emg, padding)
    for alteration in alterations:
        inputs = alteration.inputs(inputs)
    own = inputs.parameters
    envelope = inputs.emg.at_delay(own.electromechanical_delay, own.synergy_weights)
    excitation = own.emg_scale * envelope
    for alteration in alterations:
        excitation = alteration.excitation(excitation, inputs)
    neural = neural_activation(
        excitation, own.activation_time_constant, inputs.emg.step, inputs.deactivation_ratio
    )
    inside = slice(padding, neural.shape[-1] - padding)
    activation = muscle_activation(jnp.maximum(neural[:, inside], 0.0), own.activation_nonlinearity)
    for alteration in alterations:
        activation = alteration.activation(activation, inputs)
    for alteration in alterations:
        inputs = alteration.fibers(inputs, activation)
    fiber = rigid_tendon_fiber(
        inputs.curves,
        activation,
        inputs.path.length,
        inputs.path.velocity,
        **inputs.law,
    )
    for alteration in alterations:
        fiber = alteration.tendon(fiber, activation, inputs)
    for alteration in alterations:
        fiber = alteration.force(fiber, activation, inputs)
    moment = path.moment_arm * fiber.tendon_force[:, None, :]
    return MuscleState(excitation[:, inside], activation, path, fiber, moment)


def muscle_states(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    alterations: tuple[Alteration, ...] = (),
) -> MuscleState:
    """Run every muscle over all cycles; leaves of the result lead with ``muscle``."""
    path = altered_paths(recording.path.at(parameters.path_changes), alterations)
    emg = altered_emg(recording.emg, alterations)
    return jax.vmap(muscle_state_along, in_axes=(0, None, 0, 0, None, 0))(
        path, curves, parameters, emg, recording.padding, muscle_alterations(alterations)
    )


def joint_moments(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    alterations: tuple[Alteration, ...] = (),
) -> Float[Array, "trial coordinate frame"]:
    """Predict the joint moments of all cycles, in N m (sign of the model's coordinates).

    Parameters
    ----------
    curves
        Normalised force curves.
    parameters
        Of all muscles.
    recording
        EMG and paths.
    alterations
        What else there is than the plain model, in its order within each stage.
    """
    states = muscle_states(curves, parameters, recording, alterations)
    return altered_moments(states.moment.sum(axis=0), alterations)


def apply_recording_alterations(
    recording: Recording, parameters: ModelParameters, alterations: tuple[Alteration, ...]
) -> tuple[Recording, tuple[Alteration, ...]]:
    """Alter EMG, paths and moments now; what is left says what single muscles do.

    The same comes out. But a program for it need not know what altered EMG, paths and moments, so that one
    serves all that does nothing else.

    Parameters
    ----------
    recording, alterations
        EMG and paths, and what else there is than the plain model.
    parameters
        They say how paths are held.
    """
    path = altered_paths(_frames(recording.path.at(parameters.path_changes)), alterations)
    emg = altered_emg(recording.emg, alterations)
    if emg.lag is None:
        emg = replace(emg, lag=jnp.zeros(emg.step.shape))
    moment = altered_moments(jnp.zeros(path.moment_arm.shape[1:]), alterations)
    left = tuple(Alteration(muscle=part) for part in muscle_alterations(alterations))
    return Recording(emg, fixed_path(path), recording.padding), (Alteration(moment=moment), *left)
