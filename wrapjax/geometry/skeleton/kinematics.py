"""Forward kinematics: positions of bodies and path points in poses, and their velocities by coordinate."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.skeleton.bodies import body_poses, build_skeleton
from wrapjax.geometry.skeleton.model_description import ModelDescription, PathPoint

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
    structure, skeleton = build_skeleton(values.model, values.names, bodies)
    poses = body_poses(structure, skeleton, values.poses)
    # Whether a mover's joint moves a body, and its coordinate is a certain one.
    movers = np.array(structure.movers, dtype=int).reshape(-1, 2)
    moves = structure.ancestors[:, movers[:, 0]]
    by_coordinate = movers[:, 1] == np.arange(len(values.names))[:, None]
    motions = {}
    for index, body in enumerate(structure.bodies):
        chosen = (moves[index] & by_coordinate).astype(float)
        angular = chosen @ poses.angular
        linear = chosen @ poses.linear
        origin = poses.origin[:, index]
        motions[body] = BodyMotion(
            poses.rotation[:, index], origin, angular, linear + np.cross(angular, origin[:, None])
        )
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
