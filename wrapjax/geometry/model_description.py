"""The plain frozen data that describe a model, and which coordinates a muscle spans.

Functions of one coordinate, as models use them: for joint axes, couplers and moving points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline


@dataclass(frozen=True)
class Polynomial:
    """A polynomial; a constant or a straight line, too.

    Parameters
    ----------
    coefficients
        Highest power first.
    """

    coefficients: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate it."""
        return np.polyval(self.coefficients, at)

    def slope(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate its derivative."""
        return np.polyval(np.polyder(np.asarray(self.coefficients)), at)

    def scaled(self, factor: float) -> Polynomial:
        """Multiply it by a number."""
        return Polynomial(tuple(factor * coefficient for coefficient in self.coefficients))


@dataclass(frozen=True)
class Spline:
    """A piecewise cubic through knots, straight beyond the first and the last one.

    Parameters
    ----------
    knots, values, slopes
        A cubic between two knots is known from its values and slopes at both.
    """

    knots: tuple[float, ...]
    values: tuple[float, ...]
    slopes: tuple[float, ...]

    def value(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate it."""
        inside = np.clip(at, self.knots[0], self.knots[-1])
        end_slope = np.where(at < self.knots[0], self.slopes[0], self.slopes[-1])
        return self._cubics()(inside) + end_slope * (at - inside)

    def slope(self, at: Float[np.ndarray, " pose"]) -> Float[np.ndarray, " pose"]:
        """Evaluate its derivative."""
        return self._cubics()(np.clip(at, self.knots[0], self.knots[-1]), 1)

    def scaled(self, factor: float) -> Spline:
        """Multiply it by a number."""
        values, slopes = (tuple(factor * value for value in row) for row in (self.values, self.slopes))
        return replace(self, values=values, slopes=slopes)

    def _cubics(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.knots, self.values, self.slopes)


#: What an axis, a coupler or a moving point may follow.
Function = Polynomial | Spline

CONSTANT_ZERO = Polynomial((0.0,))
IDENTITY = Polynomial((1.0, 0.0))


Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]


@dataclass(frozen=True)
class Pose:
    """Where a frame is in another: rotation matrix (columns are its axes) and origin (m)."""

    rotation: Matrix
    translation: Triple


@dataclass(frozen=True)
class PathPoint:
    """A point that a muscle runs through.

    Parameters
    ----------
    kind
        OpenSim's class: ``PathPoint``, ``ConditionalPathPoint`` or ``MovingPathPoint``.
    body, location
        The body that carries it and where it is there (m). A moving point is given where it is in
        the model's default pose.
    motion
        What moves it along x, y and z of ``frame``: coordinates and functions (m) of them, None where
        a function is of no known kind. None at all but for a ``MovingPathPoint``.
    frame
        Where the frame that it was given in is in its body.
    active_range
        The coordinate and its range (rad or m) in which it is part of the path. None but for a
        ``ConditionalPathPoint``.
    """

    name: str
    kind: str
    body: str
    location: Triple
    motion: tuple[tuple[str, Function | None], ...] | None = None
    frame: Pose | None = None
    active_range: tuple[str, float, float] | None = None

    @property
    def moved_by(self) -> tuple[str, ...]:
        """The coordinates that move it along its body."""
        return tuple(dict.fromkeys(name for name, _ in self.motion or ()))


@dataclass(frozen=True)
class PathWrap:
    """A wrap object in a muscle's path.

    Parameters
    ----------
    wrap
        Name of the wrap object.
    method
        ``hybrid``, ``midpoint`` or ``axial``; matters for ellipsoids only.
    first_point, last_point
        The stretch of path that may wrap, as 1-based point numbers; -1 stands for the path's end.
    """

    wrap: str
    method: str
    first_point: int
    last_point: int


@dataclass(frozen=True)
class Muscle:
    """A muscle's path. ``path_kind`` other than ``GeometryPath`` has neither points nor wraps."""

    name: str
    path_kind: str
    points: tuple[PathPoint, ...]
    wraps: tuple[PathWrap, ...]


@dataclass(frozen=True)
class Coordinate:
    """A generalized coordinate; values in rad, or m where it is translational.

    Parameters
    ----------
    motion
        ``rotational``, ``translational`` or ``coupled`` (its joint both turns and slides with it).
    prescribed
        Driven by a function of time instead of being free.
    coupled_to
        Coordinates that an enforced coupler computes this one from; empty if it is independent.
    coupler
        How, if it follows a single other coordinate by a function that is known here.
    """

    name: str
    motion: str
    default_value: float
    range: tuple[float, float]
    locked: bool
    clamped: bool
    prescribed: bool
    coupled_to: tuple[str, ...]
    coupler: Function | None = None


@dataclass(frozen=True)
class Axis:
    """One of the movements that a joint is made of.

    Parameters
    ----------
    kind
        ``rotation`` or ``translation``.
    direction
        Unit vector. Rotations follow one another, each about an axis of the frame that those before
        have turned; translations are along axes of the joint's frame in the parent.
    coordinate
        What it follows; None for one that stays at ``function`` of zero.
    function
        From the coordinate to rad or m.
    """

    kind: str
    direction: Triple
    coordinate: str | None
    function: Function


@dataclass(frozen=True)
class Joint:
    """A joint of the body tree.

    Parameters
    ----------
    coordinates
        Those it owns; none if it is welded.
    in_parent, in_child
        The joint's two frames, each in its body.
    axes
        What it does; None if this is no sequence of known movements.
    default
        Where the child's frame is in the parent's one in the model's default pose.
    """

    name: str
    kind: str
    parent_body: str
    child_body: str
    coordinates: tuple[str, ...]
    in_parent: Pose
    in_child: Pose
    axes: tuple[Axis, ...] | None
    default: Pose


@dataclass(frozen=True)
class WrapObject:
    """A surface that muscles wrap over.

    Parameters
    ----------
    kind
        OpenSim's class, ``WrapCylinder`` for one.
    body, translation, xyz_body_rotation
        Pose in the body that carries it: m, and body-fixed x-y-z angles in rad.
    radius, length
        Of a cylinder, in m; None for any other kind.
    quadrant
        The side that paths must pass: ``all``, ``x``, ``-x``, ``y`` ...
    active
        An inactive object is not wrapped.
    """

    name: str
    kind: str
    body: str
    translation: Triple
    xyz_body_rotation: Triple
    radius: float | None
    length: float | None
    quadrant: str
    active: bool


@dataclass(frozen=True)
class ModelDescription:
    """Everything that decides muscle lengths and moment arms, as names and numbers.

    Parameters
    ----------
    constraints
        Names and kinds of enforced constraints other than coordinate couplers.
    """

    name: str
    muscles: tuple[Muscle, ...]
    coordinates: tuple[Coordinate, ...]
    joints: tuple[Joint, ...]
    wraps: tuple[WrapObject, ...]
    constraints: tuple[tuple[str, str], ...]

    def muscle(self, name: str) -> Muscle:
        """Look a muscle up by name."""
        return next(muscle for muscle in self.muscles if muscle.name == name)

    def coordinate(self, name: str) -> Coordinate:
        """Look a coordinate up by name."""
        return next(coordinate for coordinate in self.coordinates if coordinate.name == name)

    def wrap(self, name: str) -> WrapObject:
        """Look a wrap object up by name."""
        return next(wrap for wrap in self.wraps if wrap.name == name)

    @property
    def unusual(self) -> tuple[str, ...]:
        """One sentence for each thing beyond fixed points, cylinders and coupled coordinates."""
        return tuple(self._unusual())

    def _unusual(self) -> Iterator[str]:
        for wrap in self.wraps:
            if wrap.kind != "WrapCylinder":
                yield f"wrap object '{wrap.name}' on {wrap.body} is a {wrap.kind}"
        for muscle in self.muscles:
            if muscle.path_kind != "GeometryPath":
                yield f"muscle '{muscle.name}' has a {muscle.path_kind}"
            for point in muscle.points:
                if point.kind != "PathPoint":
                    yield f"muscle '{muscle.name}': point '{point.name}' is a {point.kind}"
        for name, kind in self.constraints:
            yield f"constraint '{name}' is a {kind}"

    def spanned_by(self, muscle: str) -> tuple[str, ...]:
        """Name the independent coordinates that a muscle's length depends on, in model order.

        By structure alone: the joints between the bodies that its points and wrap objects are on,
        coupled coordinates counted as those they follow, locked and prescribed ones left out.
        """
        path = self.muscle(muscle)
        carrier = {wrap.name: wrap.body for wrap in self.wraps}
        bodies = {point.body for point in path.points} | {carrier[wrap.wrap] for wrap in path.wraps}
        chains = [set(self._joints_to_ground(body)) for body in bodies]
        # A joint below which all of the path lies, or none of it, moves the path as a whole.
        between = {
            joint for chain in chains for joint in chain if not all(joint in other for other in chains)
        }
        moving = {name for joint in self.joints if joint.name in between for name in joint.coordinates}
        moving |= {name for point in path.points for name in point.moved_by}
        independent = self._independent(moving)
        return tuple(
            coordinate.name
            for coordinate in self.coordinates
            if coordinate.name in independent and not (coordinate.locked or coordinate.prescribed)
        )

    def coordinates_above(self, body: str) -> tuple[str, ...]:
        """Name the coordinates of the joints between a body and ground, the nearest joint first."""
        joints = {joint.name: joint for joint in self.joints}
        return tuple(
            coordinate for name in self._joints_to_ground(body) for coordinate in joints[name].coordinates
        )

    def _joints_to_ground(self, body: str) -> Iterator[str]:
        above = {joint.child_body: joint for joint in self.joints}
        while body in above:
            yield above[body].name
            body = above[body].parent_body

    def _independent(self, names: Iterable[str]) -> set[str]:
        """Replace coupled coordinates by those they follow, through couplers of couplers."""
        found: set[str] = set()
        for name in names:
            follows = self.coordinate(name).coupled_to
            found |= self._independent(follows) if follows else {name}
        return found
