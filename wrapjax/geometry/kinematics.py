"""Forward kinematics: positions of bodies and path points in poses, and their velocities by coordinate."""

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
    """Pose of a body in ground's frame, and its velocity per unit speed of each coordinate.

    Parameters
    ----------
    rotation
        Rotation matrix, whose columns are the body's axes.
    origin
        Origin of the body, m.
    angular
        Angular velocity per unit speed of each coordinate, rad/rad (rad/m for a translation).
    linear
        Velocity of the body's origin per unit speed of each coordinate, m/rad (m/m for a translation).
    """

    rotation: Float[np.ndarray, "pose 3 3"]
    origin: Vectors
    angular: Rates
    linear: Rates

    def station(self, location: Float[np.ndarray, "*pose 3"]) -> tuple[Vectors, Rates]:
        """Compute position (m) and velocity (m/rad, m/m) in ground of a point fixed to the body.

        Parameters
        ----------
        location
            The point in the body's frame, m.
        """
        arm = np.einsum("pij,pj->pi", self.rotation, np.broadcast_to(location, self.origin.shape))
        return self.origin + arm, self.linear + np.cross(self.angular, arm[:, None])


class CoordinateValues:
    """Values of all coordinates of a model in poses, and their derivatives by the given coordinates.

    Coupled coordinates follow their couplers. Others that are not given stay at the model's defaults.

    Parameters
    ----------
    model
        Description of the model.
    names
        Names of the given coordinates.
    poses
        Values of the given coordinates, rad or m.
    """

    def __init__(
        self, model: ModelDescription, names: Sequence[str], poses: Float[np.ndarray, "pose coordinate"]
    ):
        self.model = model
        self.names = tuple(names)
        self.poses = poses

    def zeros(self) -> tuple[Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]:
        """Value and derivatives of a quantity that is zero in all poses."""
        return np.zeros(len(self.poses)), np.zeros(self.poses.shape)

    def value_and_derivative(
        self, name: str
    ) -> tuple[Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]:
        """Compute values of a coordinate (rad or m), and their derivatives by each given coordinate.

        Raises
        ------
        InputError
            If the coordinate follows another by a function of an unsupported kind.
        """
        value, derivative = self.zeros()
        if name in self.names:
            column = self.names.index(name)
            derivative[:, column] = 1.0
            return self.poses[:, column], derivative
        coordinate = self.model.coordinate(name)
        if not coordinate.coupled_to:
            return value + coordinate.default_value, derivative
        if coordinate.coupler is None:
            followed = ", ".join(coordinate.coupled_to)
            raise InputError(
                Problem(self.model.name, f"follows {followed} by a function of an unknown kind", place=name)
            )
        value, inner = self.value_and_derivative(coordinate.coupled_to[0])
        return coordinate.coupler.value(value), coordinate.coupler.derivative(value)[:, None] * inner


def body_motion(values: CoordinateValues, bodies: Iterable[str]) -> dict[str, BodyMotion]:
    """Compute the motion of bodies and of all bodies between them and ground.

    Parameters
    ----------
    values
        Values of all coordinates.
    bodies
        Names of bodies.

    Returns
    -------
    dict
        Motion by body name, ``ground`` included.

    Raises
    ------
    InputError
        If a joint between them and ground is of an unsupported kind and does not stay in its default pose.
    """
    joint_above = {joint.child_body: joint for joint in values.model.joints}
    poses, coordinates = values.poses.shape
    at_rest = np.zeros((poses, coordinates, 3))
    ground = BodyMotion(np.tile(np.eye(3), (poses, 1, 1)), np.zeros((poses, 3)), at_rest, at_rest)
    motions = {"ground": ground}

    def motion_of(body: str) -> BodyMotion:
        if body not in motions:
            joint = joint_above[body]
            motions[body] = _child_motion(joint, motion_of(joint.parent_body), values)
        return motions[body]

    for body in bodies:
        motion_of(body)
    return motions


@dataclass(frozen=True)
class PathPoints:
    """Points of one muscle path in every pose, in ground's frame.

    Parameters
    ----------
    bodies
        Name of the body that carries each point.
    position
        Position, m.
    velocity
        Velocity per unit speed of each coordinate, m/rad (m/m for a translation).
    active
        Whether a point is part of the path; conditional points are in some poses only.
    """

    bodies: tuple[str, ...]
    position: Float[np.ndarray, "pose point 3"]
    velocity: Float[np.ndarray, "pose coordinate point 3"]
    active: Bool[np.ndarray, "pose point"]


def path_points(
    points: tuple[PathPoint, ...], motion: dict[str, BodyMotion], values: CoordinateValues
) -> PathPoints:
    """Compute positions and velocities of all points of a path in every pose.

    Parameters
    ----------
    points
        Fixed, conditional or moving points.
    motion
        Motion of the bodies that carry them, by name.
    values
        Values of all coordinates.

    Raises
    ------
    InputError
        If a point moves by a function of an unsupported kind.
    """
    located = [_point(point, motion[point.body], values) for point in points]
    return PathPoints(
        bodies=tuple(point.body for point in points),
        position=np.stack([position for position, _ in located], axis=1),
        velocity=np.stack([velocity for _, velocity in located], axis=2),
        active=np.stack([_active(point, values) for point in points], axis=1),
    )


def _child_motion(joint: Joint, parent: BodyMotion, values: CoordinateValues) -> BodyMotion:
    """Compute the motion of a joint's child body from that of its parent body."""
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
        for axis, value, derivative in _movements(joint.axes, values):
            direction = np.asarray(axis.direction)
            if axis.kind == "rotation":
                angular = angular + derivative[:, :, None] * (rotation @ direction)[:, None]
                rotation = rotation @ _rotation(direction, value)
            else:
                shift = shift + value[:, None] * (base @ direction)
                rate = rate + derivative[:, :, None] * (base @ direction)[:, None]
    # The displacement rotates with the joint's frame in the parent body.
    linear = linear + np.cross(parent.angular, shift[:, None]) + rate
    origin = origin + shift
    rotation = rotation @ in_child[0].T
    arm = -(rotation @ in_child[1])
    return BodyMotion(rotation, origin + arm, angular, linear + np.cross(angular, arm[:, None]))


def _movements(
    axes: Iterable[Axis], values: CoordinateValues
) -> Iterator[tuple[Axis, Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]]:
    """Yield each axis with its displacement (rad or m) and the displacement's derivatives."""
    for axis in axes:
        name = axis.coordinate
        value, derivative = values.zeros() if name is None else values.value_and_derivative(name)
        yield axis, axis.function.value(value), axis.function.derivative(value)[:, None] * derivative


def _check_at_rest(joint: Joint, values: CoordinateValues) -> None:
    """Raise `InputError` if a given coordinate moves a joint of an unsupported kind."""
    if any(values.value_and_derivative(name)[1].any() for name in joint.coordinates):
        raise InputError(
            Problem(
                values.model.name,
                f"joint '{joint.name}' is a {joint.kind} that the path engine cannot move",
                hint="supported are pin, slider, universal, gimbal and planar joints, and custom joints with "
                "polynomials and SIMM splines",
            )
        )


def _arrays(pose: Pose) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    return np.asarray(pose.rotation), np.asarray(pose.translation)


def _rotation(
    axis: Float[np.ndarray, " 3"], angle: Float[np.ndarray, " pose"]
) -> Float[np.ndarray, "pose 3 3"]:
    """Rotation matrices about a unit vector by angles in rad (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return cosine * np.eye(3) + sine * cross + (1.0 - cosine) * np.outer(axis, axis)


def _point(
    point: PathPoint, body: BodyMotion, values: CoordinateValues
) -> tuple[Float[np.ndarray, "pose 3"], Float[np.ndarray, "pose coordinate 3"]]:
    if point.motion is None:
        return body.station(np.asarray(point.location))
    assert point.frame is not None
    displacements, rates = [], []
    for coordinate, function in point.motion:
        if function is None:
            raise InputError(
                Problem(
                    values.model.name,
                    f"point '{point.name}' moves with {coordinate} by a function of an unknown kind",
                    hint="supported are constants, polynomials, piecewise linear functions and SIMM splines",
                )
            )
        value, derivative = values.value_and_derivative(coordinate)
        displacements.append(function.value(value))
        rates.append(function.derivative(value)[:, None] * derivative)
    rotation = np.asarray(point.frame.rotation)
    location = np.stack(displacements, axis=-1) @ rotation.T + np.asarray(point.frame.translation)
    position, velocity = body.station(location)
    relative = np.einsum("pij,jk,pck->pci", body.rotation, rotation, np.stack(rates, axis=-1))
    return position, velocity + relative


def _active(point: PathPoint, values: CoordinateValues) -> Bool[np.ndarray, " pose"]:
    if point.active_range is None:
        return np.ones(len(values.poses), dtype=bool)
    name, low, high = point.active_range
    value, _ = values.value_and_derivative(name)
    # OpenSim's tolerance at both ends of the range.
    return (value >= low - 1e-5) & (value <= high + 1e-5)
