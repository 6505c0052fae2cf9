"""Positions of all parts of a model over a motion: bodies, joint axes, muscle paths and wrapping surfaces.

Lengths are in m and angles in rad; the page converts them. Of the path engine only public results are used:
the vertices of a path, the ends of its contacts, lengths and moment arms.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.routed_path import RoutedPath, route_paths
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS
from wrapjax.geometry.skeleton.kinematics import BodyMotion, CoordinateValues, body_motion
from wrapjax.geometry.skeleton.model_description import Joint, ModelDescription, Pose
from wrapjax.path_sources.muscle_paths import MusclePaths
from wrapjax.report.model_view.wrap_shapes import WrapShape, wrap_shape

# Every so many-th vertex of a contact is drawn: arcs of 6 degrees, off a circle of 50 mm by less than 0.1 mm.
_ARC_STRIDE = 12
# Shorter lines (m) do not stand for a bone.
_LEAST_STICK = 0.005

Parameters = Float[np.ndarray, " wrap_parameter"]


@dataclass(frozen=True)
class Placement:
    """Wraps in one state of the model, such as before or after calibration.

    Parameters
    ----------
    name
        Name for the page.
    parameters
        Wrap parameters (`PARAMETERS`, at least the first six) by wrap; others are nominal.
    """

    name: str
    parameters: Mapping[str, Parameters] = field(default_factory=dict)

    def of(self, wraps: Sequence[str]) -> Float[np.ndarray, "wrap wrap_parameter"]:
        """Wrap parameters of the given wraps."""
        rows = np.tile(NOMINAL_PARAMETERS, (len(wraps), 1))
        for row, name in enumerate(wraps):
            own = self.parameters.get(name, ())
            rows[row, : len(own)] = own
        return rows


@dataclass(frozen=True)
class Motion:
    """Stretch of a motion, such as a gait cycle.

    Parameters
    ----------
    name
        Name for the page.
    poses
        Values of the coordinates, rad or m.
    progress
        Phase (%), time (s) or angle (degrees) of each frame.
    unit
        Words for ``progress``, such as ``% of the gait cycle``.
    time
        Time of each frame, s.
    """

    name: str
    poses: Float[np.ndarray, "frame coordinate"]
    progress: Float[np.ndarray, " frame"]
    unit: str
    time: Float[np.ndarray, " frame"]


@dataclass(frozen=True)
class MusclePath:
    """A muscle's path in all frames of all motions, for one placement of the wraps.

    Parameters
    ----------
    counts
        Number of vertices in each frame.
    vertices
        Vertices from origin to insertion, frame after frame, in the ground frame, m.
    contact
        Place, in ``wraps``, of the surface on which the segment that begins at a vertex lies; -1 if none.
    is_point
        Whether a vertex is a path point of the model.
    wraps
        Wraps that the path may touch.
    length
        Length, m.
    moment_arm
        -dL/dq, m (m/rad).
    """

    counts: Int[np.ndarray, " frame"]
    vertices: Float[np.ndarray, "vertex 3"]
    contact: Int[np.ndarray, " vertex"]
    is_point: Bool[np.ndarray, " vertex"]
    wraps: tuple[str, ...]
    length: Float[np.ndarray, " frame"]
    moment_arm: Float[np.ndarray, "coordinate frame"]

    def frame(self, number: int) -> Float[np.ndarray, "vertex 3"]:
        """Vertices in one frame, m."""
        first = int(self.counts[:number].sum())
        return self.vertices[first : first + int(self.counts[number])]


@dataclass(frozen=True)
class JointAxis:
    """Axis about which a coordinate turns the body below a joint, in all frames, in the ground frame.

    Parameters
    ----------
    coordinate, joint
        Names.
    center
        Origin of the joint's frame in the child body, m.
    direction
        Unit vector; the angular velocity for a positive speed of the coordinate.
    before
        Whether it is that before joints were personalised.
    """

    coordinate: str
    joint: str
    center: Float[np.ndarray, "frame 3"]
    direction: Float[np.ndarray, "frame 3"]
    before: bool = False


@dataclass(frozen=True)
class Scene:
    """A model in motion.

    Parameters
    ----------
    coordinates
        Coordinates of the poses.
    motions
        Stretches of motion; frames of all arrays are those of all motions one after the other.
    bodies
        Motion of each body by name, ``ground`` excluded.
    root
        Name of the body nearest to ground that carries all others shown.
    axes
        Joint axes of the coordinates that muscles span.
    placements
        States of the wraps, the model's own first.
    wraps
        Shape of each wrap in each placement, by name; one entry where all placements agree.
    paths
        Path of each muscle in each placement, by name; one entry where all placements agree.
    sticks
        Straight lines that stand for bones: ends in the body's frame (m), by body.
    notes
        Sentences on what is not shown, or shown in a simplified way.
    """

    coordinates: tuple[str, ...]
    motions: tuple[Motion, ...]
    bodies: dict[str, BodyMotion]
    root: str
    axes: tuple[JointAxis, ...]
    placements: tuple[Placement, ...]
    wraps: dict[str, tuple[WrapShape, ...]]
    paths: dict[str, tuple[MusclePath, ...]]
    sticks: dict[str, list[Float[np.ndarray, "2 3"]]]
    notes: tuple[str, ...]

    @property
    def frames(self) -> int:
        """Number of frames of all motions."""
        return sum(len(motion.poses) for motion in self.motions)


def build_scene(
    model: ModelDescription,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    motions: Sequence[Motion],
    placements: Sequence[Placement] = (Placement("model"),),
    joints_before: Mapping[str, Pose] = MappingProxyType({}),
) -> Scene:
    """Compute the positions of all parts of a model.

    Parameters
    ----------
    model
        Description of the model, from `wrapjax.osim.model.describe_model`.
    muscles
        Names of the muscles to show.
    coordinates
        Names of the coordinates of the motions' poses.
    motions
        Motions.
    placements
        States of the wraps.
    joints_before
        Pose of joints in their parent bodies before they were personalised, by name: their axes are shown,
        too.

    Raises
    ------
    InputError
        If a joint, coupler or path point moves by a function of an unsupported kind.
    """
    poses = np.concatenate([motion.poses for motion in motions])
    model, notes = _simplified(model, muscles, coordinates)
    muscles = [name for name in muscles if model.muscle(name).points]
    values = CoordinateValues(model, coordinates, poses)
    bodies = body_motion(values, [joint.child_body for joint in model.joints])
    bodies.pop("ground")
    engine = ExactPaths(model, muscles, coordinates)
    names = list(dict.fromkeys(wrap for muscle in muscles for wrap in engine.wraps_of(muscle)))
    shapes = {name: _wrap_shapes(model, name, placements) for name in names}
    return Scene(
        coordinates=tuple(coordinates),
        motions=tuple(motions),
        bodies=bodies,
        root=_root(model, muscles),
        axes=tuple(_joint_axes(model, muscles, coordinates, bodies, joints_before)),
        placements=tuple(placements),
        wraps={name: shape for name, shape in shapes.items() if shape},
        paths=_muscle_paths(engine, poses, placements),
        sticks=stick_bones(model, muscles, bodies),
        notes=tuple(notes),
    )


def _simplified(
    model: ModelDescription, muscles: Sequence[str], coordinates: Sequence[str]
) -> tuple[ModelDescription, list[str]]:
    """Take the wraps from muscles that the path engine does not support, with a sentence for each."""
    notes, changed = [], {}
    for name in muscles:
        muscle = model.muscle(name)
        try:
            ExactPaths(model, (name,), coordinates)
            reason = ""
        except InputError as error:
            reason = error.problems[0].message.partition(":")[0]
        if reason:
            shown = "is not shown" if not muscle.points else "is drawn straight from point to point"
            notes.append(f"{name} {shown}: {reason}.")
            changed[name] = replace(muscle, path_kind="GeometryPath", wraps=())
    owned = tuple(changed.get(muscle.name, muscle) for muscle in model.muscles)
    return replace(model, muscles=owned), notes


def _wrap_shapes(
    model: ModelDescription, name: str, placements: Sequence[Placement]
) -> tuple[WrapShape, ...]:
    wrap = model.wrap(name)
    moved = any(name in placement.parameters for placement in placements)
    shapes = [wrap_shape(wrap, one.of((name,))[0]) for one in placements[: None if moved else 1]]
    return tuple(shape for shape in shapes if shape is not None)


def _muscle_paths(
    engine: ExactPaths, poses: Float[np.ndarray, "frame coordinate"], placements: Sequence[Placement]
) -> dict[str, tuple[MusclePath, ...]]:
    """Compute all paths in the first placement, and in the others those of muscles with moved wraps."""
    wraps_of = {name: engine.wraps_of(name) for name in engine.muscles}
    moved = {wrap for placement in placements for wrap in placement.parameters}
    own: dict[str, list[MusclePath]] = {name: [] for name in engine.muscles}
    # From a point inside its one surface, a path is drawn from the place above the point on both sides, and
    # is only on the side that wraps in calibrations.
    single = [name for name in engine.muscles if len(wraps_of[name]) == 1]
    paths = MusclePaths(ExactPaths(engine.model, single, engine.coordinates), "geodesic", {})
    for number, placement in enumerate(placements):
        engines: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        if single:
            values = paths(poses, placement.of(paths.wraps))
            length, arm = np.asarray(values.length), np.asarray(values.moment_arm)
            engines = {name: (length[:, column], arm[:, :, column].T) for column, name in enumerate(single)}
        shown = [name for name in engine.muscles if not number or moved.intersection(wraps_of[name])]
        parameters = {name: placement.of(wraps_of[name]) for name in shown}
        routes = route_paths(engine.model, shown, engine.coordinates, poses, parameters)
        for name in shown:
            path = _muscle_path(routes[name], wraps_of[name])
            if name in engines:
                path = replace(path, length=engines[name][0], moment_arm=engines[name][1])
            own[name].append(path)
    return {name: tuple(found) for name, found in own.items()}


def _muscle_path(routes: Sequence[RoutedPath], wraps: tuple[str, ...]) -> MusclePath:
    parts = [_drawn(route, wraps) for route in routes]
    vertices, contact, is_point = (np.concatenate(column) for column in zip(*parts, strict=True))
    counts = np.array([len(part[0]) for part in parts])
    length = np.array([route.length for route in routes])
    moment_arm = np.stack([route.moment_arm for route in routes], axis=1)
    return MusclePath(counts, vertices, contact, is_point, wraps, length, moment_arm)


def _drawn(
    route: RoutedPath, wraps: tuple[str, ...]
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, " vertex"], Bool[np.ndarray, " vertex"]]:
    """Select the vertices to draw, with the surface that each segment lies on."""
    contact = np.full(len(route.line), -1)
    keep = np.ones(len(route.line), dtype=bool)
    for name, ends in route.contacts.items():
        first, last = (int(np.abs(route.line - end).sum(axis=1).argmin()) for end in ends)
        contact[first:last] = wraps.index(name)
        keep[first : last + 1] = False
        keep[np.arange(first, last + 1, _ARC_STRIDE)] = True
        keep[[first, last]] = True
    vertices = route.line[keep]
    distance = np.abs(vertices[:, None] - route.points[None]).sum(axis=2)
    return vertices, contact[keep], distance.min(axis=1) < 1e-9


def _joint_axes(
    model: ModelDescription,
    muscles: Sequence[str],
    coordinates: Sequence[str],
    bodies: Mapping[str, BodyMotion],
    before: Mapping[str, Pose],
) -> Iterable[JointAxis]:
    """Compute the axes of the coordinates that the muscles span, as they are and as they were."""
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)}
    for joint in model.joints:
        child = bodies[joint.child_body]
        # Ground does not turn.
        angular = child.angular
        if joint.parent_body != "ground":
            angular = angular - bodies[joint.parent_body].angular
        center, _ = child.station(np.asarray(joint.in_child.translation))
        for name in joint.coordinates:
            if name not in coordinates or name not in spanned:
                continue
            rate = angular[:, tuple(coordinates).index(name)]
            size = np.linalg.norm(rate, axis=1, keepdims=True)
            if size.max() < 1e-9:
                continue  # a sliding coordinate
            axis = JointAxis(name, joint.name, center, rate / np.maximum(size, 1e-12))
            yield axis
            if joint.name in before:
                parent = None if joint.parent_body == "ground" else bodies[joint.parent_body]
                yield _axis_before(axis, joint.in_parent, before[joint.name], parent)


def _axis_before(axis: JointAxis, after: Pose, before: Pose, parent: BodyMotion | None) -> JointAxis:
    """Carry an axis with its joint's frame to where that was in the parent body; None: in ground."""
    count = len(axis.center)
    origin = np.zeros((count, 3)) if parent is None else parent.origin
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3)) if parent is None else parent.rotation
    # From the parent body's axes through the joint's frame as it is to the axes where it was.
    turn = np.asarray(before.rotation) @ np.asarray(after.rotation).T
    local = np.einsum("fji,fj->fi", rotation, axis.center - origin) - np.asarray(after.translation)
    center = np.asarray(before.translation) + local @ turn.T
    direction = np.einsum("fji,fj->fi", rotation, axis.direction) @ turn.T
    return replace(
        axis,
        center=origin + np.einsum("fij,fj->fi", rotation, center),
        direction=np.einsum("fij,fj->fi", rotation, direction),
        before=True,
    )


def carrying_bodies(model: ModelDescription, muscles: Sequence[str]) -> set[str]:
    """Name the bodies that carry points or wraps of muscles, and those between these bodies and ground."""
    above = {joint.child_body: joint.parent_body for joint in model.joints}
    carrying = {point.body for name in muscles for point in model.muscle(name).points}
    carrying |= {model.wrap(entry.wrap).body for name in muscles for entry in model.muscle(name).wraps}
    for body in tuple(carrying):
        while body in above:
            body = above[body]
            carrying.add(body)
    return carrying - {"ground"}


def _root(model: ModelDescription, muscles: Sequence[str]) -> str:
    """Name the body on ground that carries the muscles, or the model's first body."""
    carrying = carrying_bodies(model, muscles)
    on_ground = [joint.child_body for joint in model.joints if joint.parent_body == "ground"]
    return next((body for body in on_ground if body in carrying), model.joints[0].child_body)


def stick_bones(
    model: ModelDescription, muscles: Sequence[str], bodies: Mapping[str, BodyMotion]
) -> dict[str, list[Float[np.ndarray, "2 3"]]]:
    """Draw lines between the joint centers of each body that carries the muscles.

    A body without a joint below it has a line to its path point farthest from its joint. Joint centers that
    move in a body are taken in the first frame.

    Parameters
    ----------
    model, muscles
        Model, and names of the muscles.
    bodies
        Motion of the model's bodies.

    Returns
    -------
    dict
        Ends of the lines in the body's frame (m), by body.
    """
    carrying = carrying_bodies(model, muscles)
    points = [point for name in muscles for point in model.muscle(name).points]
    sticks = {}
    for joint in model.joints:
        body = joint.child_body
        if body not in carrying:
            continue
        start = np.asarray(joint.in_child.translation)
        ends = [
            _center_in(bodies[body], below, bodies) for below in model.joints if below.parent_body == body
        ]
        if not ends:
            ends = [np.asarray(point.location) for point in points if point.body == body]
            ends = sorted(ends, key=lambda end: float(np.linalg.norm(end - start)))[-1:]
        sticks[body] = [np.stack([start, end]) for end in ends if np.linalg.norm(end - start) > _LEAST_STICK]
    return sticks


def _center_in(body: BodyMotion, joint: Joint, bodies: Mapping[str, BodyMotion]) -> Float[np.ndarray, " 3"]:
    """Center of a joint below a body in that body's frame, in the first frame, m."""
    center, _ = bodies[joint.child_body].station(np.asarray(joint.in_child.translation))
    return body.rotation[0].T @ (center[0] - body.origin[0])
