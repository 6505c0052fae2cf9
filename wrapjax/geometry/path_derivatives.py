"""How paths follow angles, and the exact engine's paths their cylinders, ends and joints, to first order.

The engine's by differences: to compile derivatives of paths round several cylinders takes minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.geometry.engine import ExactPaths, wrap_at_samples
from wrapjax.geometry.joint_changes import with_moved_ends
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.paths import PathState
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.geometry.wrapped_paths import wrapped_paths
from wrapjax.geometry.wrapping import NOMINAL

#: By how much ends (m), joints (m, rad) and cylinders (m, rad, 1) are moved.
_STEP = 1e-4

Kinematics = Float[np.ndarray, "trial coordinate frame"]


def laid_paths(
    engine: ExactPaths, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Lay paths through recorded cycles the shortest way, as the model has them.

    Parameters
    ----------
    engine
        Of the muscles.
    angles, velocities
        Of the engine's coordinates: rad and rad/s.
    moment_coordinates
        What moment arms are wanted about.
    """
    path = wrapped_paths(engine, angles, velocities, moment_coordinates, ())[0].nominal
    return PathState(path.length, path.velocity, path.moment_arm)


def slopes_by_angles(
    surrogate: PathSurrogate, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Differentiate polynomial paths by joint angles; rates of angles stay what they are.

    Parameters
    ----------
    surrogate
        The polynomials.
    angles, velocities
        Of its coordinates: rad and rad/s.
    moment_coordinates
        The angles, and what moment arms are wanted about.

    Returns
    -------
    PathState
        Leaves lead with ``muscle coordinate``; a change of one radian.
    """
    at = [surrogate.coordinates.index(name) for name in moment_coordinates]
    bend = surrogate.second_derivatives(jnp.asarray(angles))
    slope = -surrogate(jnp.asarray(angles), jnp.asarray(velocities)).moment_arm
    return PathState(
        length=jnp.moveaxis(slope, 1, 2)[:, at],
        velocity=jnp.moveaxis(jnp.einsum("mtijf,tjf->mtif", bend, velocities), 1, 2)[:, at],
        moment_arm=-jnp.moveaxis(bend, 1, 2)[:, at][:, :, :, at],
    )


def slopes_by_model(
    engine: ExactPaths,
    changed: Sequence[Callable[[float], ModelDescription]],
    angles: Kinematics,
    velocities: Kinematics,
    moment_coordinates: Sequence[str],
) -> PathState:
    """Differentiate paths by what the model may have elsewhere.

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As of `laid_paths`.
    changed
        For each way in which it may differ, from by how much (m or rad) to the model.

    Returns
    -------
    PathState
        Leaves lead with ``muscle mode``; a change of one metre or radian.
    """

    def laid(model: ModelDescription) -> PathState:
        moved = ExactPaths(model, engine.muscles, engine.coordinates)
        return laid_paths(moved, angles, velocities, moment_coordinates)

    slopes = [
        jax.tree.map(
            lambda above, below: (above - below) / (2.0 * _STEP),
            laid(model_at(_STEP)),
            laid(model_at(-_STEP)),
        )
        for model_at in changed
    ]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=1), *slopes)


def slopes_by_ends(
    engine: ExactPaths, angles: Kinematics, velocities: Kinematics, moment_coordinates: Sequence[str]
) -> PathState:
    """Differentiate paths by the places of their first and last points.

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As of `laid_paths`.

    Returns
    -------
    PathState
        Leaves lead with ``muscle mode``: x, y and z of the origin, then of the insertion, in the frame of the
        body that each is on; a change of one metre.
    """
    ends = [
        partial(with_moved_ends, engine.model, engine.muscles, end, axis)
        for end in (0, -1)
        for axis in range(3)
    ]
    return slopes_by_model(engine, ends, angles, velocities, moment_coordinates)


def slopes_by_wraps(
    engine: ExactPaths,
    angles: Kinematics,
    velocities: Kinematics,
    moment_coordinates: Sequence[str],
    moving: Bool[np.ndarray, " muscle"],
) -> PathState:
    """Differentiate paths by the parameters of their cylinders (`WRAP_PARAMETERS`).

    Parameters
    ----------
    engine, angles, velocities, moment_coordinates
        As of `laid_paths`.
    moving
        Whose paths; the others' slopes are zero.

    Returns
    -------
    PathState
        Leaves lead with ``muscle mode``: a muscle's cylinders one after the other, in the order of its path.
    """
    quantities = len(NOMINAL)
    trials, _, frames = angles.shape
    most = max((len(engine.wraps_of(name)) for name in engine.muscles), default=0)
    posed = engine.posed(np.moveaxis(angles, 1, -1).reshape(-1, len(engine.coordinates)))
    about = np.array(
        [[name == one for name in engine.coordinates] for one in moment_coordinates], dtype=float
    )
    shape = (len(engine.muscles), most * quantities, trials)
    length, velocity = np.zeros((*shape, frames)), np.zeros((*shape, frames))
    moment_arm = np.zeros((*shape, len(about), frames))
    for row in np.flatnonzero(moving):
        name = engine.muscles[row]
        count = len(engine.wraps_of(name)) * quantities
        steps = _STEP * np.eye(count).reshape(count, -1, quantities)
        found = wrap_at_samples(posed[name], NOMINAL + np.concatenate([steps, -steps]))

        def slope(values: Array | np.ndarray, count: int = count) -> np.ndarray:
            by_pose = np.asarray(values[:count] - values[count:]) / (2.0 * _STEP)
            return by_pose.reshape(count, trials, frames, *values.shape[2:])

        arm = np.moveaxis(slope(found.moment_arm), -1, 2)
        length[row, :count] = slope(found.length)
        velocity[row, :count] = -np.sum(arm * velocities, axis=2)
        moment_arm[row, :count] = np.einsum("cp,ktpf->ktcf", about, arm)
    return PathState(jnp.asarray(length), jnp.asarray(velocity), jnp.asarray(moment_arm))
