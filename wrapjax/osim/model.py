"""Reader of OpenSim models: muscle paths, coordinates, joints, functions and wrap objects as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.model_description import (
    CONSTANT_ZERO,
    IDENTITY,
    Axis,
    Coordinate,
    Function,
    Joint,
    Matrix,
    ModelDescription,
    Muscle,
    PathPoint,
    PathWrap,
    PiecewiseLinear,
    Polynomial,
    Pose,
    Spline,
    Triple,
    WrapObject,
)
from wrapjax.osim.loading import import_opensim, load_model

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

# Axes of joints that are determined by the joint's class, in the order of its coordinates.
_MOVEMENTS: dict[str, tuple[tuple[str, Triple], ...]] = {
    "WeldJoint": (),
    "PinJoint": (("rotation", _Z),),
    "SliderJoint": (("translation", _X),),
    "UniversalJoint": (("rotation", _X), ("rotation", _Y)),
    "GimbalJoint": (("rotation", _X), ("rotation", _Y), ("rotation", _Z)),
    "PlanarJoint": (("rotation", _Z), ("translation", _X), ("translation", _Y)),
}


#: Independent coordinates, and function of them if supported, by the name of the dependent coordinate.
Couplers = dict[str, tuple[tuple[str, ...], Function | None]]


def describe_model(model_file: Path | str) -> ModelDescription:
    """Read the description of a model from its file.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).

    Returns
    -------
    ModelDescription
        Muscle paths, coordinates, joints, wrap objects and constraints, in SI units and radians.

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
    model.realizePosition(state)
    couplers, constraints = _constraints(opensim, model)
    return ModelDescription(
        name=model.getName(),
        muscles=tuple(_muscle(opensim, muscle, state) for muscle in elements(model.getMuscles())),
        coordinates=tuple(_coordinate(entry, couplers) for entry in elements(model.getCoordinateSet())),
        joints=tuple(_read_joint(opensim, joint, state) for joint in elements(model.getJointSet())),
        wraps=tuple(_wraps(opensim, model)),
        constraints=constraints,
    )


def spanned_coordinates(model_file: Path | str, muscles: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Find the independent coordinates that each muscle's length depends on.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    muscles
        Names of muscles of the model.

    Returns
    -------
    dict
        Coordinate names in the model's order, by muscle name; see `ModelDescription.spanned_by`.

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
    """Return a problem for each name that is not in the model.

    Parameters
    ----------
    model_file
        OpenSim model (.osim), named in the problems.
    what
        Kind of the named parts, such as ``muscle``.
    names
        Names to check.
    known
        Names in the model.
    """
    return [
        Problem(str(model_file), f"the model has no such {what}", place=name, hint=nearest_name(name, known))
        for name in names
        if name not in known
    ]


def elements(opensim_set: Any) -> Iterator[Any]:
    """Iterate over an OpenSim ``Set``, which is not iterable in Python."""
    for index in range(opensim_set.getSize()):
        yield opensim_set.get(index)


def couplers_of(opensim: Any, model: Any) -> Iterator[Any]:
    """Iterate over enforced couplers, those first whose dependent coordinate is another's input."""
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
                    f"coupled coordinates depend on each other in a circle: {', '.join(sorted(dependent))}",
                )
            )
        yield from ready
        waiting = [coupler for coupler in waiting if coupler not in ready]


def independent_names(coupler: Any) -> tuple[str, ...]:
    """Names of the independent coordinates of a coupler."""
    names = coupler.getIndependentCoordinateNames()
    return tuple(names.get(index) for index in range(names.getSize()))


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
    return PathPoint(
        name=point.getName(),
        kind=point.getConcreteClassName(),
        body=frame.findBaseFrame().getName(),
        location=_triple(in_body),
        motion=_motion(opensim, point),
        frame=_read_pose(frame.findTransformInBaseFrame()),
        active_range=_active_range(opensim, point),
    )


def _motion(opensim: Any, point: Any) -> tuple[tuple[str, Function | None], ...] | None:
    moving = opensim.MovingPathPoint.safeDownCast(point)
    if moving is None:
        return None
    motion = []
    for axis in "XYZ":
        name = getattr(moving, f"get{axis}Coordinate")().getName()
        motion.append((name, _read_function(opensim, getattr(moving, f"get_{axis.lower()}_location")())))
    return tuple(motion)


def _active_range(opensim: Any, point: Any) -> tuple[str, float, float] | None:
    conditional = opensim.ConditionalPathPoint.safeDownCast(point)
    if conditional is None:
        return None
    name = conditional.getCoordinate().getName()
    return name, conditional.get_range(0), conditional.get_range(1)


def _coordinate(coordinate: Any, couplers: Couplers) -> Coordinate:
    motions = ("undefined", "rotational", "translational", "coupled")
    coupled_to, coupler = couplers.get(coordinate.getName(), ((), None))
    return Coordinate(
        name=coordinate.getName(),
        motion=motions[coordinate.getMotionType()],
        default_value=coordinate.getDefaultValue(),
        range=(coordinate.getRangeMin(), coordinate.getRangeMax()),
        locked=coordinate.get_locked(),
        clamped=coordinate.get_clamped(),
        prescribed=coordinate.get_prescribed(),
        coupled_to=coupled_to,
        coupler=coupler,
    )


def _constraints(opensim: Any, model: Any) -> tuple[Couplers, tuple[tuple[str, str], ...]]:
    """Read the enforced couplers, and the names and classes of other enforced constraints."""
    couplers: Couplers = {}
    for coupler in couplers_of(opensim, model):
        names = independent_names(coupler)
        function = _read_function(opensim, coupler.getFunction()) if len(names) == 1 else None
        scale = float(coupler.getPropertyByName("scale_factor").toString())
        known = None if function is None else function.scaled(scale)
        couplers[coupler.getDependentCoordinateName()] = (names, known)
    others = tuple(
        (constraint.getName(), constraint.getConcreteClassName())
        for constraint in elements(model.getConstraintSet())
        if constraint.get_isEnforced() and constraint.getConcreteClassName() != "CoordinateCouplerConstraint"
    )
    return couplers, others


def _read_joint(opensim: Any, joint: Any, state: Any) -> Joint:
    """Read a joint; ``state`` is the model's default state, realized to positions."""
    parent, child = joint.getParentFrame(), joint.getChildFrame()
    coordinates = tuple(joint.get_coordinates(i).getName() for i in range(joint.numCoordinates()))
    return Joint(
        name=joint.getName(),
        kind=joint.getConcreteClassName(),
        parent_body=parent.findBaseFrame().getName(),
        child_body=child.findBaseFrame().getName(),
        coordinates=coordinates,
        in_parent=_read_pose(parent.findTransformInBaseFrame()),
        in_child=_read_pose(child.findTransformInBaseFrame()),
        axes=_axes(opensim, joint, coordinates),
        default=_read_pose(child.findTransformBetween(state, parent)),
    )


def _axes(opensim: Any, joint: Any, coordinates: tuple[str, ...]) -> tuple[Axis, ...] | None:
    """Read the axes of a joint, or return None if its class or a function of it is unsupported."""
    kind = joint.getConcreteClassName()
    if kind in _MOVEMENTS:
        return tuple(
            Axis(movement, direction, coordinate, IDENTITY)
            for (movement, direction), coordinate in zip(_MOVEMENTS[kind], coordinates, strict=True)
        )
    if kind != "CustomJoint":
        return None
    transform = opensim.CustomJoint.safeDownCast(joint).getSpatialTransform()
    axes = []
    for movement in ("rotation", "translation"):
        for number in (1, 2, 3):
            axis = _custom_axis(opensim, movement, getattr(transform, f"get_{movement}{number}")())
            if axis is None:
                return None
            axes.append(axis)
    return tuple(axes)


def _custom_axis(opensim: Any, movement: str, axis: Any) -> Axis | None:
    names = axis.getCoordinateNamesInArray()
    if names.getSize() > 1:
        return None
    function = _read_function(opensim, axis.getFunction()) if axis.hasFunction() else CONSTANT_ZERO
    if function is None:
        return None
    direction = axis.getAxis()
    # OpenSim normalizes the direction given in the file.
    parts = [direction.get(index) for index in range(3)]
    norm = sum(part * part for part in parts) ** 0.5
    unit = (parts[0] / norm, parts[1] / norm, parts[2] / norm)
    return Axis(movement, unit, names.get(0) if names.getSize() else None, function)


def _wraps(opensim: Any, model: Any) -> Iterator[WrapObject]:
    for component in model.getComponentsList():
        wrap = opensim.WrapObject.safeDownCast(component)
        if wrap is None:
            continue
        frame = wrap.getFrame()
        pose = frame.findTransformInBaseFrame().compose(wrap.getTransform())
        radius, length, sizes = _extents(opensim, wrap)
        yield WrapObject(
            name=wrap.getName(),
            kind=wrap.getConcreteClassName(),
            body=frame.findBaseFrame().getName(),
            translation=_triple(pose.p()),
            xyz_body_rotation=_triple(pose.R().convertRotationToBodyFixedXYZ()),
            radius=radius,
            length=length,
            quadrant=wrap.get_quadrant(),
            active=wrap.get_active(),
            sizes=sizes,
        )


def _extents(opensim: Any, wrap: Any) -> tuple[float | None, float | None, tuple[float, ...]]:
    """Radius, length and other sizes of a wrap object (m), as in `WrapObject`."""
    cylinder = opensim.WrapCylinder.safeDownCast(wrap)
    if cylinder is not None:
        return cylinder.get_radius(), cylinder.get_length(), ()
    sphere = opensim.WrapSphere.safeDownCast(wrap)
    if sphere is not None:
        return sphere.get_radius(), None, ()
    ellipsoid = opensim.WrapEllipsoid.safeDownCast(wrap)
    if ellipsoid is not None:
        return None, None, _triple(ellipsoid.get_dimensions())
    torus = opensim.WrapTorus.safeDownCast(wrap)
    if torus is not None:
        return None, None, (torus.get_outer_radius(), torus.get_inner_radius())
    return None, None, ()


def _read_function(opensim: Any, function: Any) -> Function | None:
    """Read a function of one variable, or return None for an unsupported kind.

    Supported are Constant, LinearFunction, PolynomialFunction, PiecewiseLinearFunction, SimmSpline, and a
    MultiplierFunction of any of these.
    """
    kind = function.getConcreteClassName()
    if kind == "MultiplierFunction":
        multiplier = opensim.MultiplierFunction.safeDownCast(function)
        inner = _read_function(opensim, multiplier.getFunction())
        return None if inner is None else inner.scaled(multiplier.getScale())
    if kind == "Constant":
        return Polynomial((opensim.Constant.safeDownCast(function).getValue(),))
    if kind == "LinearFunction":
        line = opensim.LinearFunction.safeDownCast(function)
        return Polynomial((line.getSlope(), line.getIntercept()))
    if kind == "PolynomialFunction":
        coefficients = opensim.PolynomialFunction.safeDownCast(function).getCoefficients()
        return Polynomial(tuple(coefficients.get(index) for index in range(coefficients.size())))
    if kind == "PiecewiseLinearFunction":
        lines = opensim.PiecewiseLinearFunction.safeDownCast(function)
        places = range(lines.getSize())
        knots, values = (tuple(get(place) for place in places) for get in (lines.getX, lines.getY))
        return PiecewiseLinear(knots, values) if len(knots) > 1 else None
    if kind == "SimmSpline":
        return _spline(opensim, opensim.SimmSpline.safeDownCast(function))
    return None


def _spline(opensim: Any, spline: Any) -> Spline:
    knots = [spline.getX(index) for index in range(spline.getSize())]
    first = opensim.StdVectorInt([0])
    slopes = []
    for knot in knots:
        at = opensim.Vector(1, float(knot))
        slopes.append(spline.calcDerivative(first, at))
    return Spline(tuple(knots), tuple(spline.getY(index) for index in range(len(knots))), tuple(slopes))


def _read_pose(transform: Any) -> Pose:
    """Convert an OpenSim ``Transform``."""
    rotation = transform.R().asMat33()
    rows: Matrix = tuple(tuple(rotation.get(i, j) for j in range(3)) for i in range(3))  # type: ignore[assignment]
    origin = transform.p()
    return Pose(rows, (origin.get(0), origin.get(1), origin.get(2)))


def _triple(vector: Any) -> Triple:
    return (float(vector.get(0)), float(vector.get(1)), float(vector.get(2)))
