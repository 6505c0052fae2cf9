"""Where bodies are in a pose, and how they move with each coordinate.

Where the points of a muscle's path are in a pose, and how they move.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.model_description import Axis, Joint, ModelDescription, PathPoint, Pose

Vectors = Float[np.ndarray, "pose 3"]
Rates = Float[np.ndarray, "pose coordinate 3"]


@dataclass(frozen=True)
class BodyMotion:
    """A body in every pose, in ground's frame, and its motion by unit speed of each coordinate.

    Parameters
    ----------
    rotation
        Columns are the body's axes.
    origin
        m.
    angular
        Angular velocity by each coordinate: rad/rad, or rad/m by a translational one.
    linear
        Velocity of the body's origin by each coordinate: m/rad, or m/m.
    """

    rotation: Float[np.ndarray, "pose 3 3"]
    origin: Vectors
    angular: Rates
    linear: Rates

    def station(self, location: Float[np.ndarray, "*pose 3"]) -> tuple[Vectors, Rates]:
        """Locate a point of the body (given in its frame, m) in ground, with its velocities."""
        arm = np.einsum("pij,pj->pi", self.rotation, np.broadcast_to(location, self.origin.shape))
        return self.origin + arm, self.linear + np.cross(self.angular, arm[:, None])


class CoordinateValues:
    """Every coordinate of a model in every pose, and its slope by each of the given ones.

    Coordinates that are neither given nor coupled stay at the model's defaults.
    """

    def __init__(
        self, model: ModelDescription, names: Sequence[str], poses: Float[np.ndarray, "pose coordinate"]
    ):
        self.model = model
        self.names = tuple(names)
        self.poses = poses

    def at_rest(self) -> tuple[Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]:
        """Give the value and slope of something that no coordinate moves."""
        return np.zeros(len(self.poses)), np.zeros(self.poses.shape)

    def value_and_slope(
        self, name: str
    ) -> tuple[Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]:
        """Give one coordinate's values (rad or m), and slopes by each given coordinate."""
        value, slope = self.at_rest()
        if name in self.names:
            column = self.names.index(name)
            slope[:, column] = 1.0
            return self.poses[:, column], slope
        coordinate = self.model.coordinate(name)
        if not coordinate.coupled_to:
            return value + coordinate.default_value, slope
        if coordinate.coupler is None:
            followed = ", ".join(coordinate.coupled_to)
            raise InputError(
                Problem(self.model.name, f"follows {followed} by a function of an unknown kind", place=name)
            )
        value, inner = self.value_and_slope(coordinate.coupled_to[0])
        return coordinate.coupler.value(value), coordinate.coupler.slope(value)[:, None] * inner


def body_motion(values: CoordinateValues, bodies: Iterable[str]) -> dict[str, BodyMotion]:
    """Find bodies, and those between them and ground, in every pose.

    Raises
    ------
    InputError
        If a joint on the way moves in a way that is not known here.
    """
    above = {joint.child_body: joint for joint in values.model.joints}
    poses, coordinates = values.poses.shape
    still = np.zeros((poses, coordinates, 3))
    ground = BodyMotion(np.tile(np.eye(3), (poses, 1, 1)), np.zeros((poses, 3)), still, still)
    found = {"ground": ground}

    def find(body: str) -> BodyMotion:
        if body not in found:
            joint = above[body]
            found[body] = _across(joint, find(joint.parent_body), values)
        return found[body]

    for body in bodies:
        find(body)
    return found


def _across(joint: Joint, parent: BodyMotion, values: CoordinateValues) -> BodyMotion:
    """Go across a joint, from the parent body to the child."""
    in_parent, in_child = _arrays(joint.in_parent), _arrays(joint.in_child)
    rotation = parent.rotation @ in_parent[0]
    origin, linear = parent.station(in_parent[1])
    angular = parent.angular
    base = rotation
    if joint.axes is None:
        _check_at_rest(joint, values)
        turned, moved = _arrays(joint.default)
        rotation, shift, rate = base @ turned, base @ moved, np.zeros_like(linear)
    else:
        shift, rate = np.zeros_like(origin), np.zeros_like(linear)
        for axis, value, slope in _movements(joint.axes, values):
            direction = np.asarray(axis.direction)
            if axis.kind == "rotation":
                angular = angular + slope[:, :, None] * (rotation @ direction)[:, None]
                rotation = rotation @ _turn(direction, value)
            else:
                shift = shift + value[:, None] * (base @ direction)
                rate = rate + slope[:, :, None] * (base @ direction)[:, None]
    # The joint's frame in the parent carries the shift along as it turns.
    linear = linear + np.cross(parent.angular, shift[:, None]) + rate
    origin = origin + shift
    rotation = rotation @ in_child[0].T
    arm = -(rotation @ in_child[1])
    return BodyMotion(rotation, origin + arm, angular, linear + np.cross(angular, arm[:, None]))


def _movements(
    axes: Iterable[Axis], values: CoordinateValues
) -> Iterator[tuple[Axis, Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]]:
    for axis in axes:
        name = axis.coordinate
        value, slope = values.at_rest() if name is None else values.value_and_slope(name)
        yield axis, axis.function.value(value), axis.function.slope(value)[:, None] * slope


def _check_at_rest(joint: Joint, values: CoordinateValues) -> None:
    """Refuse to move a joint of a kind that is not known here; in its default pose any will do."""
    if any(values.value_and_slope(name)[1].any() for name in joint.coordinates):
        raise InputError(
            Problem(
                values.model.name,
                f"joint '{joint.name}' is a {joint.kind} that the path engine cannot move",
                hint="it can pins, slides, universal, gimbal and planar joints, and custom joints of "
                "polynomials and SIMM splines",
            )
        )


def _arrays(pose: Pose) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    return np.asarray(pose.rotation), np.asarray(pose.translation)


def _turn(axis: Float[np.ndarray, " 3"], angle: Float[np.ndarray, " pose"]) -> Float[np.ndarray, "pose 3 3"]:
    """Turn about a unit vector by angles in rad (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return cosine * np.eye(3) + sine * cross + (1.0 - cosine) * np.outer(axis, axis)


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
