"""Description of a musculoskeletal model as plain immutable data: joints, coordinates, muscle paths, wraps.

It holds all that determines muscle lengths and moment arms, and needs neither OpenSim nor JAX.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from wrapjax.geometry.skeleton.functions import Function

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]


@dataclass(frozen=True)
class Pose:
    """Pose of a frame in another frame: rotation matrix (columns are the frame's axes) and origin (m)."""

    rotation: Matrix
    translation: Triple


@dataclass(frozen=True)
class PathPoint:
    """Path point of a muscle.

    Parameters
    ----------
    name
        OpenSim's name.
    kind
        OpenSim's class: ``PathPoint``, ``ConditionalPathPoint`` or ``MovingPathPoint``.
    body
        Name of the body that carries the point.
    location
        Location in that body's frame (m); for a moving point in the model's default pose.
    motion
        Of a ``MovingPathPoint``: a coordinate and its function (m) for each of x, y and z of ``frame``; the
        function is None if its kind is unsupported. None for other points.
    frame
        Pose, in the body, of the frame that ``motion`` refers to.
    active_range
        Of a ``ConditionalPathPoint``: the coordinate, and the range (rad or m) in which the point is part of
        the path. None for other points.
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
        """Names of the coordinates that move the point relative to its body."""
        return tuple(dict.fromkeys(name for name, _ in self.motion or ()))


@dataclass(frozen=True)
class PathWrap:
    """Wrap object as listed in a muscle's path.

    Parameters
    ----------
    wrap
        Name of the wrap object.
    method
        ``hybrid``, ``midpoint`` or ``axial``; relevant to ellipsoids only.
    first_point, last_point
        First and last point of the part of the path that may wrap, 1-based; -1 is the path's first or last
        point.
    """

    wrap: str
    method: str
    first_point: int
    last_point: int


@dataclass(frozen=True)
class Muscle:
    """Path of a muscle.

    Parameters
    ----------
    name
        OpenSim's name.
    path_kind
        OpenSim's class of the path. Only a ``GeometryPath`` has points and wraps.
    points
        Path points from origin to insertion.
    wraps
        Wrap objects of the path, in its order.
    """

    name: str
    path_kind: str
    points: tuple[PathPoint, ...]
    wraps: tuple[PathWrap, ...]


@dataclass(frozen=True)
class Coordinate:
    """Generalized coordinate; values are in rad, or in m for a translational coordinate.

    Parameters
    ----------
    name
        OpenSim's name.
    motion
        ``rotational``, ``translational`` or ``coupled`` (the joint rotates and translates with it).
    default_value, range
        Default value; lowest and highest value.
    locked, clamped
        Whether the model holds the coordinate at its default, or within its range.
    prescribed
        Whether the coordinate is a function of time.
    coupled_to
        Coordinates from which an enforced coupler computes this one; empty for an independent coordinate.
    coupler
        Function of the single coordinate in ``coupled_to``; None if independent or of an unsupported kind.
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
    """Rotation or translation axis of a joint.

    Parameters
    ----------
    kind
        ``rotation`` or ``translation``.
    direction
        Unit vector. Rotations are successive: each is about an axis of the frame rotated by those before.
        Translations are along axes of the joint's frame in the parent body.
    coordinate
        Name of the coordinate; None for a constant displacement, ``function`` of zero.
    function
        Function from the coordinate to the displacement, rad or m.
    """

    kind: str
    direction: Triple
    coordinate: str | None
    function: Function


@dataclass(frozen=True)
class Joint:
    """Joint between a parent and a child body.

    Parameters
    ----------
    name
        OpenSim's name.
    kind
        OpenSim's class.
    parent_body, child_body
        Names of the bodies.
    coordinates
        Names of the joint's coordinates; none for a weld.
    in_parent, in_child
        Poses of the joint's frames in the parent and the child body.
    axes
        Axes of the joint in order; None if the joint's class or a function is unsupported.
    default
        Pose of the joint's child frame in its parent frame, in the model's default pose.
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
    """Wrap object, a surface that muscle paths wrap round.

    Parameters
    ----------
    name
        OpenSim's name.
    kind
        OpenSim's class, such as ``WrapCylinder``.
    body
        Name of the body that carries the surface.
    translation, xyz_body_rotation
        Pose in that body: origin (m), and body-fixed x-y-z angles (rad).
    radius
        Radius of a cylinder or a sphere, m; None for other surfaces.
    length
        Length of a cylinder, m; None for other surfaces.
    quadrant
        Side on which paths pass: ``all``, ``x``, ``-x``, ``y`` ...
    active
        Whether paths wrap round the surface at all.
    sizes
        Semi-axes of an ellipsoid, or radii of a torus' ring and tube, m; empty for other surfaces.
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
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True)
class Marker:
    """Marker of a model, which stands for one on the skin.

    Parameters
    ----------
    name
        OpenSim's name.
    body
        Name of the body that carries the marker.
    location
        Location in that body's frame, m.
    fixed
        Whether the location is taken from anatomy, so that OpenSim's scale tool does not move the marker.
    """

    name: str
    body: str
    location: Triple
    fixed: bool


@dataclass(frozen=True)
class ModelDescription:
    """Description of a model: all that determines muscle lengths, moment arms and markers' positions.

    Parameters
    ----------
    name
        OpenSim's name.
    muscles, coordinates, joints, wraps
        Parts of the model, in its order.
    constraints
        Names and OpenSim's classes of enforced constraints other than coordinate couplers.
    markers
        Markers, in the model's order.
    """

    name: str
    muscles: tuple[Muscle, ...]
    coordinates: tuple[Coordinate, ...]
    joints: tuple[Joint, ...]
    wraps: tuple[WrapObject, ...]
    constraints: tuple[tuple[str, str], ...]
    markers: tuple[Marker, ...] = ()

    def muscle(self, name: str) -> Muscle:
        """Muscle of a given name."""
        return next(muscle for muscle in self.muscles if muscle.name == name)

    def coordinate(self, name: str) -> Coordinate:
        """Coordinate of a given name."""
        return next(coordinate for coordinate in self.coordinates if coordinate.name == name)

    def wrap(self, name: str) -> WrapObject:
        """Wrap object of a given name."""
        return next(wrap for wrap in self.wraps if wrap.name == name)

    @property
    def uncommon_parts(self) -> tuple[str, ...]:
        """One sentence for each part other than fixed path points, cylinders and coordinate couplers."""
        return tuple(self._uncommon_parts())

    def _uncommon_parts(self) -> Iterator[str]:
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
        """Name the independent coordinates that a muscle's length depends on, in the model's order.

        These are the coordinates of the joints between the bodies that carry the muscle's points and wraps.
        Coupled coordinates are replaced by those that they follow; locked and prescribed ones are left out.
        """
        path = self.muscle(muscle)
        carrier = {wrap.name: wrap.body for wrap in self.wraps}
        bodies = {point.body for point in path.points} | {carrier[wrap.wrap] for wrap in path.wraps}
        chains = [set(self._joints_to_ground(body)) for body in bodies]
        # A joint below which all of the path lies, or none of it, does not deform the path.
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
        """Replace coupled coordinates by those that they follow, directly or through other couplers."""
        independent: set[str] = set()
        for name in names:
            follows = self.coordinate(name).coupled_to
            independent |= self._independent(follows) if follows else {name}
        return independent
