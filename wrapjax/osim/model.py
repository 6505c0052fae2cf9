"""What an OpenSim model holds, as plain frozen data: muscle paths, coordinates, joints, wrap objects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.osim.loading import import_opensim, load_model

Triple = tuple[float, float, float]


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
    moved_by
        Coordinates that move it along its body: empty but for a ``MovingPathPoint``.
    """

    name: str
    kind: str
    body: str
    location: Triple
    moved_by: tuple[str, ...] = ()


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
    """

    name: str
    motion: str
    default_value: float
    range: tuple[float, float]
    locked: bool
    clamped: bool
    prescribed: bool
    coupled_to: tuple[str, ...]


@dataclass(frozen=True)
class Joint:
    """A joint of the body tree, with the coordinates it owns (none if it is welded)."""

    name: str
    kind: str
    parent_body: str
    child_body: str
    coordinates: tuple[str, ...]


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


def describe_model(model_file: Path | str) -> ModelDescription:
    """Read what a model holds.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).

    Raises
    ------
    InputError
        If OpenSim cannot load the file as a model.

    Examples
    --------
    >>> describe_model("model.osim").muscle("soleus_l").points  # doctest: +SKIP
    """
    opensim = import_opensim()
    model, state = load_model(model_file)
    couplers, constraints = _constraints(opensim, model)
    return ModelDescription(
        name=model.getName(),
        muscles=tuple(_muscle(opensim, muscle, state) for muscle in elements(model.getMuscles())),
        coordinates=tuple(_coordinate(entry, couplers) for entry in elements(model.getCoordinateSet())),
        joints=tuple(_joint(joint) for joint in elements(model.getJointSet())),
        wraps=tuple(_wraps(opensim, model)),
        constraints=constraints,
    )


def spanned_coordinates(model_file: Path | str, muscles: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Name the independent coordinates that each muscle's length depends on.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    muscles
        Names of muscles of the model.

    Returns
    -------
    dict
        Muscle name to coordinate names, in the model's order; see `ModelDescription.spanned_by`.

    Raises
    ------
    InputError
        If the model cannot be loaded or has no such muscle.
    """
    description = describe_model(model_file)
    known = [muscle.name for muscle in description.muscles]
    problems = unknown_names(model_file, "muscle", muscles, known)
    if problems:
        raise InputError(problems)
    return {name: description.spanned_by(name) for name in muscles}


def unknown_names(
    model_file: Path | str, what: str, names: Iterable[str], known: Sequence[str]
) -> list[Problem]:
    """List a problem for each name that the model does not know."""
    return [
        Problem(str(model_file), f"the model has no such {what}", place=name, hint=nearest_name(name, known))
        for name in names
        if name not in known
    ]


def elements(opensim_set: Any) -> Iterator[Any]:
    """Iterate over an OpenSim ``Set``, which Python cannot do by itself."""
    for index in range(opensim_set.getSize()):
        yield opensim_set.get(index)


def couplers_of(opensim: Any, model: Any) -> Iterator[Any]:
    """Iterate over the enforced couplers, those that compute another's input first."""
    waiting = []
    for constraint in elements(model.getConstraintSet()):
        coupler = opensim.CoordinateCouplerConstraint.safeDownCast(constraint)
        if coupler is not None and coupler.get_isEnforced():
            waiting.append(coupler)
    while waiting:
        dependent = {coupler.getDependentCoordinateName() for coupler in waiting}
        ready = [coupler for coupler in waiting if not dependent.intersection(independent_names(coupler))]
        if not ready:
            raise InputError(
                Problem(
                    model.getInputFileName(),
                    f"coupled coordinates follow each other in a circle: {', '.join(sorted(dependent))}",
                )
            )
        yield from ready
        waiting = [coupler for coupler in waiting if coupler not in ready]


def independent_names(coupler: Any) -> tuple[str, ...]:
    """Name the coordinates that a coupler computes another from."""
    names = coupler.getIndependentCoordinateNames()
    return tuple(names.get(index) for index in range(names.getSize()))


def _constraints(opensim: Any, model: Any) -> tuple[dict[str, tuple[str, ...]], tuple[tuple[str, str], ...]]:
    couplers = {
        coupler.getDependentCoordinateName(): independent_names(coupler)
        for coupler in couplers_of(opensim, model)
    }
    others = tuple(
        (constraint.getName(), constraint.getConcreteClassName())
        for constraint in elements(model.getConstraintSet())
        if constraint.get_isEnforced() and constraint.getConcreteClassName() != "CoordinateCouplerConstraint"
    )
    return couplers, others


def _triple(vector: Any) -> Triple:
    return (float(vector.get(0)), float(vector.get(1)), float(vector.get(2)))


def _muscle(opensim: Any, muscle: Any, state: Any) -> Muscle:
    kind = muscle.getPath().getConcreteClassName()
    if kind != "GeometryPath":
        return Muscle(muscle.getName(), kind, (), ())
    path = muscle.getGeometryPath()
    return Muscle(
        name=muscle.getName(),
        path_kind=kind,
        points=tuple(_point(opensim, point, state) for point in elements(path.getPathPointSet())),
        wraps=tuple(
            PathWrap(wrap.getWrapObjectName(), wrap.getMethodName(), wrap.getStartPoint(), wrap.getEndPoint())
            for wrap in elements(path.getWrapSet())
        ),
    )


def _point(opensim: Any, point: Any, state: Any) -> PathPoint:
    frame = point.getParentFrame()
    in_body = frame.findTransformInBaseFrame().shiftFrameStationToBase(point.getLocation(state))
    moving = opensim.MovingPathPoint.safeDownCast(point)
    moved_by = []
    if moving is not None:
        for axis in "XYZ":
            if getattr(moving, f"has{axis}Coordinate")():
                moved_by.append(getattr(moving, f"get{axis}Coordinate")().getName())
    return PathPoint(
        name=point.getName(),
        kind=point.getConcreteClassName(),
        body=frame.findBaseFrame().getName(),
        location=_triple(in_body),
        moved_by=tuple(dict.fromkeys(moved_by)),
    )


def _coordinate(coordinate: Any, couplers: dict[str, tuple[str, ...]]) -> Coordinate:
    motions = ("undefined", "rotational", "translational", "coupled")
    return Coordinate(
        name=coordinate.getName(),
        motion=motions[coordinate.getMotionType()],
        default_value=coordinate.getDefaultValue(),
        range=(coordinate.getRangeMin(), coordinate.getRangeMax()),
        locked=coordinate.get_locked(),
        clamped=coordinate.get_clamped(),
        prescribed=coordinate.get_prescribed(),
        coupled_to=couplers.get(coordinate.getName(), ()),
    )


def _joint(joint: Any) -> Joint:
    return Joint(
        name=joint.getName(),
        kind=joint.getConcreteClassName(),
        parent_body=joint.getParentFrame().findBaseFrame().getName(),
        child_body=joint.getChildFrame().findBaseFrame().getName(),
        coordinates=tuple(joint.get_coordinates(i).getName() for i in range(joint.numCoordinates())),
    )


def _wraps(opensim: Any, model: Any) -> Iterator[WrapObject]:
    for component in model.getComponentsList():
        wrap = opensim.WrapObject.safeDownCast(component)
        if wrap is None:
            continue
        frame = wrap.getFrame()
        pose = frame.findTransformInBaseFrame().compose(wrap.getTransform())
        cylinder = opensim.WrapCylinder.safeDownCast(wrap)
        yield WrapObject(
            name=wrap.getName(),
            kind=wrap.getConcreteClassName(),
            body=frame.findBaseFrame().getName(),
            translation=_triple(pose.p()),
            xyz_body_rotation=_triple(pose.R().convertRotationToBodyFixedXYZ()),
            radius=None if cylinder is None else cylinder.get_radius(),
            length=None if cylinder is None else cylinder.get_length(),
            quadrant=wrap.get_quadrant(),
            active=wrap.get_active(),
        )
