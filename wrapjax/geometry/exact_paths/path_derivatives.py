"""Nominal paths of the exact engine, and first derivatives of paths by angles, wraps, muscle ends and joints.

Derivatives of the engine's paths are central differences, because derivative programs of paths round several
cylinders take minutes to compile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.exact_paths.engine import ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.skeleton.joint_changes import with_moved_ends
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.threads import map_in_threads

# Step of central differences: ends (m), joints (m, rad) and wrap parameters (m, rad, 1).
_STEP = 1e-4

Kinematics = Float[np.ndarray, "trial coordinate frame"]


def compute_nominal_paths(
    engine: ExactPaths, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Compute shortest paths round nominal wraps over recorded cycles.

    Parameters
    ----------
    engine
        Engine of the muscles.
    angles, velocities
        Values (rad) and rates (rad/s) of the engine's coordinates.
    moment_coordinates
        Coordinates of the moment arms.
    """
    path = wrapped_paths(engine, angles, velocities, moment_coordinates, ())[0].nominal
    return PathState(path.length, path.velocity, path.moment_arm)


def derivatives_by_angles(
    surrogate: PathSurrogate, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Compute derivatives of polynomial paths by joint angles at constant angular velocities.

    Parameters
    ----------
    surrogate
        Polynomials of the muscles.
    angles, velocities
        Values (rad) and rates (rad/s) of the surrogate's coordinates.
    moment_coordinates
        Coordinates to differentiate by, which are also those of the moment arms.

    Returns
    -------
    PathState
        Derivatives per rad; the first axes of all leaves are ``muscle coordinate``.
    """
    at = [surrogate.coordinates.index(name) for name in moment_coordinates]
    second = surrogate.second_derivatives(jnp.asarray(angles))
    first = -surrogate(jnp.asarray(angles), jnp.asarray(velocities)).moment_arm
    return PathState(
        length=jnp.moveaxis(first, 1, 2)[:, at],
        velocity=jnp.moveaxis(jnp.einsum("mtijf,tjf->mtif", second, velocities), 1, 2)[:, at],
        moment_arm=-jnp.moveaxis(second, 1, 2)[:, at][:, :, :, at],
    )


def derivatives_by_model_changes(
    engine: ExactPaths,
    changed: Sequence[Callable[[float], ModelDescription]],
    angles: Kinematics,
    velocities: Kinematics,
    moment_coordinates: Sequence[str],
) -> PathState:
    """Compute derivatives of shortest paths by changes of the model.

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As for `compute_nominal_paths`.
    changed
        One function for each change, from its size (m or rad) to the changed model.

    Returns
    -------
    PathState
        Derivatives per m or rad; the first axes of all leaves are ``muscle mode``, one mode for each change.
    """

    def paths_of(model: ModelDescription) -> PathState:
        changed_engine = ExactPaths(model, engine.muscles, engine.coordinates)
        return compute_nominal_paths(changed_engine, angles, velocities, moment_coordinates)

    def derivative(model_at: Callable[[float], ModelDescription]) -> PathState:
        above, below = paths_of(model_at(_STEP)), paths_of(model_at(-_STEP))
        return jax.tree.map(lambda more, less: (more - less) / (2.0 * _STEP), above, below)

    derivatives = map_in_threads(derivative, changed)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=1), *derivatives)


def derivatives_by_ends(
    engine: ExactPaths, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Compute derivatives of shortest paths by the positions of origin and insertion.

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As for `compute_nominal_paths`.

    Returns
    -------
    PathState
        Derivatives per m; the first axes of all leaves are ``muscle mode``. Modes are x, y and z of the
        origin, then of the insertion, each in the frame of its body.
    """
    ends = [
        partial(with_moved_ends, engine.model, engine.muscles, end, axis)
        for end in (0, -1)
        for axis in range(3)
    ]
    return derivatives_by_model_changes(engine, ends, angles, velocities, moment_coordinates)


def derivatives_by_wrap_parameters(
    engine: ExactPaths,
    angles: Kinematics,
    velocities: Kinematics,
    moment_coordinates: Sequence[str],
    moving: Bool[np.ndarray, " muscle"],
) -> PathState:
    """Compute derivatives of shortest paths by the parameters of their wraps.

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As for `compute_nominal_paths`.
    moving
        Muscles to differentiate; derivatives of others are zero.

    Returns
    -------
    PathState
        Derivatives per unit of each parameter (`ExactPaths.parameters`); the first axes of all leaves are
        ``muscle mode``. Modes are the parameters of a muscle's wraps, one wrap after the other in the order
        of its path.
    """
    parameters = len(engine.parameters)
    nominal = NOMINAL_PARAMETERS[:parameters]
    trials, _, frames = angles.shape
    most = max((len(engine.wraps_of(name)) for name in engine.muscles), default=0)
    posed = engine.posed(np.moveaxis(angles, 1, -1).reshape(-1, len(engine.coordinates)))
    about = np.array(
        [[name == one for name in engine.coordinates] for one in moment_coordinates], dtype=float
    )
    shape = (len(engine.muscles), most * parameters, trials)
    length, velocity = np.zeros((*shape, frames)), np.zeros((*shape, frames))
    moment_arm = np.zeros((*shape, len(about), frames))
    for row in np.flatnonzero(moving):
        name = engine.muscles[row]
        count = len(engine.wraps_of(name)) * parameters
        steps = _STEP * np.eye(count).reshape(count, -1, parameters)
        found = wrap_at_samples(posed[name], nominal + np.concatenate([steps, -steps]))

        def difference(values: Array | np.ndarray, count: int = count) -> np.ndarray:
            by_pose = np.asarray(values[:count] - values[count:]) / (2.0 * _STEP)
            return by_pose.reshape(count, trials, frames, *values.shape[2:])

        arm = np.moveaxis(difference(found.moment_arm), -1, 2)
        length[row, :count] = difference(found.length)
        velocity[row, :count] = -np.sum(arm * velocities, axis=2)
        moment_arm[row, :count] = np.einsum("cp,ktpf->ktcf", about, arm)
    return PathState(jnp.asarray(length), jnp.asarray(velocity), jnp.asarray(moment_arm))
