"""Along what lines muscles press a joint together: no OpenSim, no ground forces.

A joint is let slide, and the exact engine says what each muscle's length loses by that: its line of action
across the joint, whatever it runs through or wraps round, as its moment arm is what it loses by turning.
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
    """Find the direction in which unit force of each muscle presses on each joint.

    Parameters
    ----------
    model
        From `wrapjax.osim.model.describe_model`.
    muscles, joints
        Names.
    coordinates, angles
        Of the recorded cycles, rad (m for translations).
    wrapping
        How paths are laid.

    Returns
    -------
    array
        What the distal body presses on the proximal one with, by unit force of the muscle (N/N), along x, y
        and z of the proximal body. Zero for a muscle that does not cross the joint;
        otherwise the sum of unit vectors, one for each time that it crosses.

    Raises
    ------
    InputError
        If a path or a joint has something that the exact engine does not know.
    """
    slides = tuple(name for joint in joints for name in sliding_coordinates(joint))
    engine = ExactPaths(with_sliding_joints(model, joints), muscles, (*coordinates, *slides))
    trials, _, frames = angles.shape
    still = np.zeros((trials, len(slides), frames))
    poses = np.concatenate([angles, still], axis=1)
    path = wrapped_paths(engine, poses, np.zeros_like(poses), slides, (), wrapping)[0].nominal
    lost = np.asarray(path.moment_arm).reshape(len(muscles), trials, len(joints), 3, frames)
    return np.moveaxis(lost, 1, 3)


def sum_muscle_forces(
    lines: Float[np.ndarray, "muscle joint 3 trial frame"], force: Float[np.ndarray, "muscle trial frame"]
) -> Float[np.ndarray, "trial joint 3 frame"]:
    """Sum up what muscles press each joint together with, N.

    This is the joint's contact force if bodies had no mass and nothing touched them from outside.
    """
    return np.einsum("mjxtf,mtf->tjxf", lines, force)
