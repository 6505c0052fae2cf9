"""Where the points of a muscle's path are in a pose, and how they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.skeleton.description import PathPoint
from wrapjax.skeleton.kinematics import BodyMotion, CoordinateValues


@dataclass(frozen=True)
class PathPoints:
    """The points of one path in every pose, in ground's frame.

    Parameters
    ----------
    bodies
        What carries each point.
    position
        m.
    velocity
        By unit speed of each coordinate: m/rad, or m/m.
    active
        Whether a point is part of the path; conditional points are so in some poses only.
    """

    bodies: tuple[str, ...]
    position: Float[np.ndarray, "pose point 3"]
    velocity: Float[np.ndarray, "pose coordinate point 3"]
    active: Bool[np.ndarray, "pose point"]


def path_points(
    points: tuple[PathPoint, ...], motion: dict[str, BodyMotion], values: CoordinateValues
) -> PathPoints:
    """Find all points of a path in every pose.

    Parameters
    ----------
    points
        Fixed, conditional or moving ones.
    motion
        Of the bodies that carry them.
    values
        Of the coordinates.

    Raises
    ------
    InputError
        If a point moves by a function that is not known here.
    """
    found = [_point(point, motion[point.body], values) for point in points]
    return PathPoints(
        bodies=tuple(point.body for point in points),
        position=np.stack([position for position, _ in found], axis=1),
        velocity=np.stack([velocity for _, velocity in found], axis=2),
        active=np.stack([_active(point, values) for point in points], axis=1),
    )


def _point(
    point: PathPoint, body: BodyMotion, values: CoordinateValues
) -> tuple[Float[np.ndarray, "pose 3"], Float[np.ndarray, "pose coordinate 3"]]:
    if point.motion is None:
        return body.station(np.asarray(point.location))
    assert point.frame is not None
    along, rates = [], []
    for coordinate, function in point.motion:
        if function is None:
            raise InputError(
                Problem(
                    values.model.name,
                    f"point '{point.name}' moves with {coordinate} by a function of an unknown kind",
                    hint="constants, lines, polynomials and SIMM splines are known",
                )
            )
        value, slope = values.value_and_slope(coordinate)
        along.append(function.value(value))
        rates.append(function.slope(value)[:, None] * slope)
    turn = np.asarray(point.frame.rotation)
    location = np.stack(along, axis=-1) @ turn.T + np.asarray(point.frame.translation)
    position, velocity = body.station(location)
    gliding = np.einsum("pij,jk,pck->pci", body.rotation, turn, np.stack(rates, axis=-1))
    return position, velocity + gliding


def _active(point: PathPoint, values: CoordinateValues) -> Bool[np.ndarray, " pose"]:
    if point.active_range is None:
        return np.ones(len(values.poses), dtype=bool)
    name, low, high = point.active_range
    value, _ = values.value_and_slope(name)
    # OpenSim's tolerance at the ends of the range.
    return (value >= low - 1e-5) & (value <= high + 1e-5)
