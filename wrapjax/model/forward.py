"""Forward model: joint moments from EMG and muscle paths."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

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
from wrapjax.muscle.personal_law import PersonalCurves, personal_neural_activation, personal_shape


class Recording(eqx.Module):
    """EMG and muscle paths of all cycles: the recorded inputs of the forward model."""

    #: EMG splines; their leading axis is ``muscle``.
    emg: EmgSpline
    path: AbstractPath
    #: Frames of EMG before each cycle.
    padding: int = eqx.field(static=True)
    #: Numbers of the frames of a cycle at which paths are given and moments computed; None for all.
    frames: tuple[int, ...] | None = eqx.field(static=True, default=None)

    def at_frames(self, frames: Int[np.ndarray, " chosen"]) -> Recording:
        """Select frames, with the nominal paths held; alterations need all frames."""
        chosen: PathState = jax.tree.map(lambda leaf: leaf[..., frames], _frames(self.path.nominal))
        return replace(self, path=fixed_path(chosen), frames=tuple(frames.tolist()))

    def select_trials(self, trials: Int[np.ndarray, " chosen"]) -> Recording:
        """Select cycles by their numbers, with the nominal paths held."""
        emg, nominal = jax.tree.map(lambda leaf: leaf[:, trials], (self.emg, _frames(self.path.nominal)))
        return Recording(emg, fixed_path(nominal), self.padding)


class MuscleState(eqx.Module):
    """Excitation, activation, path, fiber state and joint moments of a muscle over all cycles."""

    #: EMG after delay and scale, without the padding frames.
    excitation: Float[Array, "*muscle trial frame"]
    activation: Float[Array, "*muscle trial frame"]
    path: PathState
    fiber: FiberState
    #: Contribution of the muscle to the joint moments, N m.
    moment: Float[Array, "*muscle trial coordinate frame"]


def _frames(path: PathState) -> PathState:
    """Keep the parts of a path that are defined in every frame: length, velocity and moment arms."""
    return PathState(path.length, path.velocity, path.moment_arm)


def muscle_state_along(
    path: PathState,
    curves: AbstractCurves,
    parameters: ModelParameters,
    emg: EmgSpline,
    padding: int,
    alterations: tuple[MuscleAlteration, ...] = (),
    frames: tuple[int, ...] | None = None,
) -> MuscleState:
    """Compute the state of one muscle over all cycles, given its path.

    Without alterations, the tendon force in a frame depends on the path's length and velocity in that frame
    alone.

    Parameters
    ----------
    path, parameters, emg
        Path, parameters and EMG of one muscle.
    curves
        Normalised force curves.
    padding
        Frames of EMG before each cycle.
    alterations
        Changes of this muscle, applied in their order within each stage.
    frames
        Numbers of the frames of a cycle at which the path is given; None for all.

    Returns
    -------
    MuscleState
        State of the muscle; leaves have the axes ``trial frame`` or ``trial coordinate frame``.
    """
    law = parameters.law
    curves = curves if law is None else PersonalCurves(curves, law)
    inputs = MuscleInputs(curves, parameters, path, emg, padding)
    for alteration in alterations:
        inputs = alteration.inputs(inputs)
    own = inputs.parameters
    envelope = inputs.emg.at_delay(own.electromechanical_delay, own.synergy_weights)
    excitation = own.emg_scale * envelope
    for alteration in alterations:
        excitation = alteration.excitation(excitation, inputs)
    dynamics = (excitation, own.activation_time_constant, inputs.emg.step, inputs.deactivation_ratio)
    start = inputs.emg.start
    if law is None:
        neural = neural_activation(*dynamics, start)
    else:
        neural = personal_neural_activation(*dynamics, law, start)
    inside = padding + np.asarray(range(path.length.shape[-1]) if frames is None else frames)
    activation = muscle_activation(jnp.maximum(neural[:, inside], 0.0), own.activation_nonlinearity)
    activation = activation if law is None else personal_shape(activation, law)
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
    """Compute the states of all muscles over all cycles.

    Parameters
    ----------
    curves, parameters, recording, alterations
        See `joint_moments`.

    Returns
    -------
    MuscleState
        States; the leading axis of the leaves is ``muscle``.
    """
    path = altered_paths(recording.path.at(parameters.path_changes), alterations)
    emg = altered_emg(recording.emg, alterations)
    return jax.vmap(partial(muscle_state_along, frames=recording.frames), in_axes=(0, None, 0, 0, None, 0))(
        path, curves, parameters, emg, recording.padding, muscle_alterations(alterations)
    )


def joint_moments(
    curves: AbstractCurves,
    parameters: ModelParameters,
    recording: Recording,
    alterations: tuple[Alteration, ...] = (),
) -> Float[Array, "trial coordinate frame"]:
    """Compute the joint moments of all cycles.

    Parameters
    ----------
    curves
        Normalised force curves.
    parameters
        Parameters of all muscles.
    recording
        EMG and paths of the cycles.
    alterations
        Changes of the plain model, applied in their order within each stage.

    Returns
    -------
    Array
        Sum of the moments of all muscles, N m, with the sign of the model's coordinates.
    """
    states = muscle_states(curves, parameters, recording, alterations)
    return altered_moments(states.moment.sum(axis=0), alterations)


def apply_recording_alterations(
    recording: Recording, parameters: ModelParameters, alterations: tuple[Alteration, ...]
) -> tuple[Recording, tuple[Alteration, ...]]:
    """Apply the alterations of EMG, paths and moments to the recording.

    The model with the result computes the same moments. A compiled program then depends on the changes of
    single muscles alone, so that it serves all alterations without such changes.

    Parameters
    ----------
    recording
        EMG and paths of the cycles.
    parameters
        Parameters whose ``path_changes`` determine the paths, which are held.
    alterations
        Changes of the plain model.

    Returns
    -------
    recording, alterations
        Recording with altered EMG and held paths, and the remaining alterations: additional moments, and
        changes of single muscles.
    """
    path = altered_paths(_frames(recording.path.at(parameters.path_changes)), alterations)
    emg = altered_emg(recording.emg, alterations)
    if emg.lag is None:
        emg = replace(emg, lag=jnp.zeros(emg.step.shape))
    moment = altered_moments(jnp.zeros(path.moment_arm.shape[1:]), alterations)
    remaining = tuple(Alteration(muscle=part) for part in muscle_alterations(alterations))
    return Recording(emg, fixed_path(path), recording.padding), (Alteration(moment=moment), *remaining)
