"""From a subject and its fitted paths to what the model takes in."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from wrapjax.geometry import PathState, PathSurrogate
from wrapjax.model import ModelParameters, Recording, initial_parameters
from wrapjax.muscle import fit_emg_spline
from wrapjax.subject import Subject, Trials


def model_parameters(subject: Subject) -> ModelParameters:
    """Build the parameter tree that a subject's calibration starts from."""
    muscles = subject.muscles
    return initial_parameters(
        muscles.max_isometric_force,
        muscles.optimal_fiber_length,
        muscles.tendon_slack_length,
        muscles.pennation_angle,
    )


def surrogate_paths(surrogate: PathSurrogate, subject: Subject, trials: Trials) -> PathState:
    """Evaluate the fitted paths of the subject's muscles over its cycles.

    Moment arms are given about the coordinates whose moments are matched, in their order.
    """
    columns = [trials.coordinates.index(name) for name in surrogate.coordinates]
    path = surrogate(
        jnp.asarray(trials.angles[:, columns]), jnp.asarray(trials.angular_velocities[:, columns])
    )
    rows = np.array([surrogate.muscles.index(name) for name in subject.muscles.names])
    path = jax.tree.map(lambda leaf: leaf[rows], path)
    shape = (*path.length.shape[:2], len(trials.moment_coordinates), path.length.shape[-1])
    moment_arm = jnp.zeros(shape)
    for place, name in enumerate(trials.moment_coordinates):
        if name in surrogate.coordinates:
            own = path.moment_arm[:, :, surrogate.coordinates.index(name)]
            moment_arm = moment_arm.at[:, :, place].set(own)
    return PathState(path.length, path.velocity, moment_arm)


def recording(subject: Subject, trials: Trials, path: PathState) -> Recording:
    """Join the EMG of each muscle's channel with its path."""
    splines = fit_emg_spline(trials.emg_time, trials.emg)
    channels = np.array(subject.muscle_channels)
    return Recording(
        emg=jax.tree.map(lambda leaf: leaf[channels], splines), path=path, padding=trials.padding
    )


def group_indices(
    groups: tuple[tuple[str, ...], ...], muscles: tuple[str, ...]
) -> tuple[tuple[int, ...], ...]:
    """Turn groups of names into groups of positions."""
    return tuple(tuple(muscles.index(name) for name in group) for group in groups)
