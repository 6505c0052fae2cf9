"""Changed copies of a model description: moved muscle ends, moved or rotated joints, sliding joints."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.functions import IDENTITY
from wrapjax.geometry.skeleton.model_description import (
    Axis,
    Coordinate,
    Joint,
    ModelDescription,
    Muscle,
    Pose,
    Triple,
)


def with_moved_ends(
    model: ModelDescription, muscles: Collection[str], end: int, axis: int, step: float
) -> ModelDescription:
    """Move the origin or insertion of muscles along an axis of the body that it is on.

    Parameters
    ----------
    model
        Model to change.
    muscles
        Names of the muscles.
    end
        0 for the origin, -1 for the insertion.
    axis
        0, 1 or 2 for x, y or z of the body that carries the point.
    step
        Displacement, m.
    """

    def moved(muscle: Muscle) -> Muscle:
        if muscle.name not in muscles:
            return muscle
        points = list(muscle.points)
        location = list(points[end].location)
        location[axis] += step
        points[end] = replace(points[end], location=(location[0], location[1], location[2]))
        return replace(muscle, points=tuple(points))

    return replace(model, muscles=tuple(moved(muscle) for muscle in model.muscles))


def with_moved_joint(model: ModelDescription, coordinate: str, axis: int, step: float) -> ModelDescription:
    """Move the joint of a coordinate, and all bodies below it, along an axis of the joint's parent body.

    Parameters
    ----------
    model
        Model to change.
    coordinate
        Name of a coordinate of the joint.
    axis
        0, 1 or 2 for x, y or z of the parent body, which stays.
    step
        Displacement, m.
    """

    def moved(joint: Joint) -> Joint:
        if coordinate not in joint.coordinates:
            return joint
        translation = _triple(np.asarray(joint.in_parent.translation) + step * np.eye(3)[axis])
        return replace(joint, in_parent=replace(joint.in_parent, translation=translation))

    return replace(model, joints=tuple(moved(joint) for joint in model.joints))


def with_rotated_joint_axes(
    model: ModelDescription, coordinate: str, axis: int, step: float
) -> ModelDescription:
    """Rotate the axes of the joint of a coordinate about its center, without moving bodies at zero angles.

    Joints on the same parent body whose coordinates are coupled to this coordinate, such as the patella's,
    are rotated too.

    Parameters
    ----------
    model
        Model to change.
    coordinate
        Name of a coordinate of the joint.
    axis
        0, 1 or 2 for x, y or z of the parent body.
    step
        Angle, rad.
    """
    parent_body = next(joint.parent_body for joint in model.joints if coordinate in joint.coordinates)
    coupled = {entry.name for entry in model.coordinates if coordinate in entry.coupled_to} | {coordinate}
    rotation = _rotation(axis, step)

    def rotated(joint: Joint) -> Joint:
        if joint.parent_body != parent_body or coupled.isdisjoint(joint.coordinates):
            return joint
        parent, child = (np.asarray(frame.rotation) for frame in (joint.in_parent, joint.in_child))
        return replace(
            joint,
            in_parent=_with_rotation(joint.in_parent, rotation @ parent),
            # The same rotation in the child's axes cancels it where the joint is at zero.
            in_child=_with_rotation(joint.in_child, child @ parent.T @ rotation @ parent),
        )

    return replace(model, joints=tuple(rotated(joint) for joint in model.joints))


def with_sliding_joints(model: ModelDescription, joints: Sequence[str]) -> ModelDescription:
    """Add coordinates by which joints translate along x, y and z of their parent body.

    At zero of these coordinates the model is unchanged. A muscle's moment arm about one of them is the
    component of the muscle's line of action across the joint along that axis (dimensionless).

    Parameters
    ----------
    model
        Description of the model, from `wrapjax.osim.model.describe_model`.
    joints
        Names of the joints.

    Returns
    -------
    ModelDescription
        The model with the coordinates named by `sliding_coordinates` (m).

    Raises
    ------
    InputError
        If the model has no such joint, or the joint moves by a function of an unsupported kind.
    """
    by_name = {joint.name: joint for joint in model.joints}
    problems = [
        Problem(
            model.name, "the model has no such joint", place=name, hint=nearest_name(name, tuple(by_name))
        )
        for name in joints
        if name not in by_name
    ]
    problems += [
        Problem(model.name, f"is a {by_name[name].kind} that the path engine cannot move", place=name)
        for name in joints
        if name in by_name and by_name[name].axes is None
    ]
    if problems:
        raise InputError(problems)
    added = tuple(
        Coordinate(name, "translational", 0.0, (-np.inf, np.inf), False, False, False, ())
        for joint in joints
        for name in sliding_coordinates(joint)
    )
    return replace(
        model,
        joints=tuple(_sliding(joint) if joint.name in joints else joint for joint in model.joints),
        coordinates=(*model.coordinates, *added),
    )


def sliding_coordinates(joint: str) -> tuple[str, str, str]:
    """Names of the coordinates by which a joint of `with_sliding_joints` translates along x, y and z."""
    return f"{joint}/slide_x", f"{joint}/slide_y", f"{joint}/slide_z"


def _sliding(joint: Joint) -> Joint:
    assert joint.axes is not None
    names = sliding_coordinates(joint.name)
    # Translations are given in the joint's frame: the rows of its rotation are the parent body's axes there.
    directions = joint.in_parent.rotation
    slides = tuple(
        Axis("translation", direction, name, IDENTITY)
        for direction, name in zip(directions, names, strict=True)
    )
    return replace(joint, axes=(*joint.axes, *slides), coordinates=(*joint.coordinates, *names))


def _rotation(axis: int, angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix about x, y or z by an angle in rad (Rodrigues' formula)."""
    x, y, z = np.eye(3)[axis]
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * across + (1.0 - np.cos(angle)) * across @ across


def _with_rotation(frame: Pose, rotation: Float[np.ndarray, "3 3"]) -> Pose:
    x, y, z = (_triple(row) for row in rotation)
    return replace(frame, rotation=(x, y, z))


def _triple(values: Float[np.ndarray, "3"]) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
