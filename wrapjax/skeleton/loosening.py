"""A model whose joints may be pulled apart, to ask what holds them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.skeleton.description import Axis, Coordinate, Joint, ModelDescription
from wrapjax.skeleton.functions import IDENTITY


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
