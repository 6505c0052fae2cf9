"""Lines of action of muscles across joints, computed by the exact engine without OpenSim or ground forces.

Each joint gets translational coordinates. The derivative of a muscle's length with respect to these is its
line of action across the joint, just as its moment arm is the derivative with respect to a rotation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.engine import GEODESIC, ExactPaths, Wrapping
from wrapjax.geometry.joint_changes import sliding_coordinates, with_sliding_joints
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.wrapped_paths import wrapped_paths


def lines_of_action(
    model: ModelDescription,
    muscles: Sequence[str],
    joints: Sequence[str],
    coordinates: Sequence[str],
    angles: Float[np.ndarray, "trial coordinate frame"],
    wrapping: Wrapping = GEODESIC,
) -> Float[np.ndarray, "muscle joint 3 trial frame"]:
    """Compute the force on each joint per unit force of each muscle.

    Parameters
    ----------
    model
        Model from `wrapjax.osim.model.describe_model`.
    muscles, joints
        Names of muscles and joints.
    coordinates
        Names of the recorded coordinates.
    angles
        Recorded angles, rad (m for translations).
    wrapping
        Wrapping of the exact engine: shortest paths, or parity with OpenSim.

    Returns
    -------
    array
        Force of the distal on the proximal body per unit muscle force (N/N), along x, y and z of the proximal
        body. Zero for a muscle that does not cross the joint; otherwise the sum of one unit vector for each
        crossing.

    Raises
    ------
    InputError
        If a path or a joint has a feature that the exact engine does not support.
    """
    slides = tuple(name for joint in joints for name in sliding_coordinates(joint))
    engine = ExactPaths(with_sliding_joints(model, joints), muscles, (*coordinates, *slides))
    trials, _, frames = angles.shape
    zeros = np.zeros((trials, len(slides), frames))
    poses = np.concatenate([angles, zeros], axis=1)
    path = wrapped_paths(engine, poses, np.zeros_like(poses), slides, (), wrapping)[0].nominal
    lines = np.asarray(path.moment_arm).reshape(len(muscles), trials, len(joints), 3, frames)
    return np.moveaxis(lines, 1, 3)


def sum_muscle_forces(
    lines: Float[np.ndarray, "muscle joint 3 trial frame"], force: Float[np.ndarray, "muscle trial frame"]
) -> Float[np.ndarray, "trial joint 3 frame"]:
    """Sum the forces of all muscles on each joint.

    This would be the joint's contact force if bodies had no mass and no external forces.

    Parameters
    ----------
    lines
        Lines of action from `lines_of_action`, N/N.
    force
        Tendon forces, N.

    Returns
    -------
    array
        Force of the distal on the proximal body by muscles, N, along x, y and z of the proximal body.
    """
    return np.einsum("mjxtf,mtf->tjxf", lines, force)
