"""A model whose joints may be pulled apart, to ask what holds them together.

A model with a part of it elsewhere: a muscle's end, a joint's center, a joint's axis.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.model_description import (
    IDENTITY,
    Axis,
    Coordinate,
    Joint,
    ModelDescription,
    Muscle,
    Pose,
    Triple,
)


def loosened(model: ModelDescription, joints: Sequence[str]) -> ModelDescription:
    """Let joints slide along x, y and z of the parent body, by coordinates of their own.

    Where those are zero, everything is as before. What a muscle's length loses by unit speed of one is the
    part of its line of action across the joint along that axis.

    Parameters
    ----------
    model
        From `wrapjax.osim.describe_model`.
    joints
        Names.

    Returns
    -------
    ModelDescription
        With the coordinates that `sliding_coordinates` names, m.

    Raises
    ------
    InputError
        If there is no such joint, or it moves in a way that is not known here.
    """
    known = {joint.name: joint for joint in model.joints}
    problems = [
        Problem(model.name, "the model has no such joint", place=name, hint=nearest_name(name, tuple(known)))
        for name in joints
        if name not in known
    ]
    problems += [
        Problem(model.name, f"is a {known[name].kind} that the path engine cannot move", place=name)
        for name in joints
        if name in known and known[name].axes is None
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
    """Name the coordinates by which a loosened joint slides along x, y and z."""
    return f"{joint}/slide_x", f"{joint}/slide_y", f"{joint}/slide_z"


def _sliding(joint: Joint) -> Joint:
    assert joint.axes is not None
    names = sliding_coordinates(joint.name)
    # Translations are given in the joint's frame: its rows are the body's axes there.
    directions = joint.in_parent.rotation
    slides = tuple(
        Axis("translation", direction, name, IDENTITY)
        for direction, name in zip(directions, names, strict=True)
    )
    return replace(joint, axes=(*joint.axes, *slides), coordinates=(*joint.coordinates, *names))


def with_moved_ends(
    model: ModelDescription, muscles: Collection[str], end: int, axis: int, step: float
) -> ModelDescription:
    """Move one end of these muscles (0 or -1) by a step (m) along an axis of the body that it is on."""

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
    """Move the joint that owns a coordinate, with all that hangs on it, by a step (m).

    Along an axis of the body that carries the joint; what carries it stays.
    """

    def moved(joint: Joint) -> Joint:
        if coordinate not in joint.coordinates:
            return joint
        moved_to = _triple(np.asarray(joint.in_parent.translation) + step * np.eye(3)[axis])
        return replace(joint, in_parent=replace(joint.in_parent, translation=moved_to))

    return replace(model, joints=tuple(moved(joint) for joint in model.joints))


def with_turned_joint(model: ModelDescription, coordinate: str, axis: int, step: float) -> ModelDescription:
    """Turn the axes of the joint that owns a coordinate by a step (rad), without moving what is at zero.

    About an axis of the body that carries the joint, through the joint's center. Joints on the same body
    whose coordinates follow this one, as the patella's, are turned alike.
    """
    carrier = next(joint.parent_body for joint in model.joints if coordinate in joint.coordinates)
    following = {entry.name for entry in model.coordinates if coordinate in entry.coupled_to} | {coordinate}
    turn = _rotation(axis, step)

    def turned(joint: Joint) -> Joint:
        if joint.parent_body != carrier or following.isdisjoint(joint.coordinates):
            return joint
        parent, child = (np.asarray(frame.rotation) for frame in (joint.in_parent, joint.in_child))
        return replace(
            joint,
            in_parent=_with_rotation(joint.in_parent, turn @ parent),
            # The same turn as the child sees it, which undoes it where the joint is at zero.
            in_child=_with_rotation(joint.in_child, child @ parent.T @ turn @ parent),
        )

    return replace(model, joints=tuple(turned(joint) for joint in model.joints))


def _rotation(axis: int, angle: float) -> Float[np.ndarray, "3 3"]:
    x, y, z = np.eye(3)[axis]
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * across + (1.0 - np.cos(angle)) * across @ across


def _with_rotation(frame: Pose, rotation: Float[np.ndarray, "3 3"]) -> Pose:
    x, y, z = (_triple(row) for row in rotation)
    return replace(frame, rotation=(x, y, z))


def _triple(values: Float[np.ndarray, "3"]) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
