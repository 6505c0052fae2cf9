"""Reader of OpenSim models: muscle paths, coordinates, joints, functions and wrap objects as plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from math import factorial
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.functions import (
    CONSTANT_ZERO,
    IDENTITY,
    Function,
    Piece,
    PiecewisePolynomial,
    Polynomial,
    Spline,
)
from wrapjax.geometry.skeleton.model_description import (
    Axis,
    Coordinate,
    Joint,
    Marker,
    Matrix,
    ModelDescription,
    Muscle,
    PathPoint,
    PathWrap,
    Pose,
    Triple,
    WrapObject,
)
from wrapjax.io.xml import read_xml_file
from wrapjax.osim.loading import check_is_file, failure_reason, import_opensim, initial_state, load_model

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

# Axes of joints that are determined by the joint's class, in the order of its coordinates.
_MOVEMENTS: dict[str, tuple[tuple[str, Triple], ...]] = {
    "WeldJoint": (),
    "PinJoint": (("rotation", _Z),),
    "SliderJoint": (("translation", _X),),
    "UniversalJoint": (("rotation", _X), ("rotation", _Y)),
    "GimbalJoint": (("rotation", _X), ("rotation", _Y), ("rotation", _Z)),
    # OpenSim gives Simbody's ball and free joints as angles about x, y and z in place of quaternions.
    "BallJoint": (("rotation", _X), ("rotation", _Y), ("rotation", _Z)),
    "FreeJoint": (
        *(("rotation", _X), ("rotation", _Y), ("rotation", _Z)),
        *(("translation", _X), ("translation", _Y), ("translation", _Z)),
    ),
    "PlanarJoint": (("rotation", _Z), ("translation", _X), ("translation", _Y)),
}


#: Independent coordinates, and function of them if supported, by the name of the dependent coordinate.
Couplers = dict[str, tuple[tuple[str, ...], Function | None]]


def describe_model(model_file: Path | str, marker_set: Path | str | None = None) -> ModelDescription:
    """Read the description of a model from its file.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    marker_set
        OpenSim's marker set (.xml), whose markers are added, or replace those of their names.

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
    if marker_set is not None:
        state = add_marker_set(model, marker_set)
    model.realizePosition(state)
    couplers, constraints = _constraints(opensim, model)
    return ModelDescription(
        name=model.getName(),
        muscles=tuple(_muscle(opensim, muscle, state) for muscle in elements(model.getMuscles())),
        coordinates=tuple(_coordinate(entry, couplers) for entry in elements(model.getCoordinateSet())),
        joints=tuple(_read_joint(opensim, joint, state) for joint in elements(model.getJointSet())),
        wraps=tuple(_wraps(opensim, model)),
        constraints=constraints,
        markers=tuple(_marker(marker) for marker in elements(model.getMarkerSet())),
    )


def add_marker_set(model: Any, marker_set: Path | str) -> Any:
    """Add the markers of a file to OpenSim's model, and return the state of its new system.

    Parameters
    ----------
    model
        OpenSim's model.
    marker_set
        OpenSim's marker set (.xml). Its markers replace those of their names.

    Raises
    ------
    InputError
        If the file is not a marker set, or names a body that the model lacks.
    """
    path = check_is_file(marker_set)
    root = read_xml_file(path)
    if next(root.iter("Marker"), None) is None:
        raise InputError(Problem(str(path), "expected a marker set of OpenSim with markers, found none"))
    bodies = [body.getName() for body in elements(model.getBodySet())] + ["ground"]
    problems = []
    for marker in root.iter("Marker"):
        frame = marker.findtext("body") or marker.findtext("socket_parent_frame") or ""
        body = frame.strip().rsplit("/", 1)[-1]
        if body not in bodies:
            message = f"is on the body '{body}', which the model lacks"
            problems.append(
                Problem(str(path), message, f"marker {marker.get('name')}", nearest_name(body, bodies))
            )
    if problems:
        raise InputError(problems)
    try:
        model.updateMarkerSet(import_opensim().MarkerSet(str(path)))
        model.finalizeConnections()
        return initial_state(model)
    except RuntimeError as error:
        message = f"OpenSim cannot add it to the model ({failure_reason(error)})"
        raise InputError(Problem(str(path), message)) from error


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
        frame=read_pose(frame.findTransformInBaseFrame()),
        active_range=_active_range(opensim, point),
    )


def _marker(marker: Any) -> Marker:
    frame = marker.getParentFrame()
    in_body = frame.findTransformInBaseFrame().shiftFrameStationToBase(marker.get_location())
    return Marker(marker.getName(), frame.findBaseFrame().getName(), _triple(in_body), marker.get_fixed())


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
        in_parent=read_pose(parent.findTransformInBaseFrame()),
        in_child=read_pose(child.findTransformInBaseFrame()),
        axes=_axes(opensim, joint, coordinates),
        default=read_pose(child.findTransformBetween(state, parent)),
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

    Supported are Constant, LinearFunction, PolynomialFunction, SimmSpline, PiecewiseLinearFunction,
    PiecewiseConstantFunction, GCVSpline, and a MultiplierFunction of any of these.
    """
    kind = function.getConcreteClassName()
    read = _READERS.get(kind)
    return None if read is None else read(opensim, getattr(opensim, kind).safeDownCast(function))


def _multiplied(opensim: Any, multiplier: Any) -> Function | None:
    inner = _read_function(opensim, multiplier.getFunction())
    return None if inner is None else inner.scaled(multiplier.getScale())


def _polynomial(opensim: Any, function: Any) -> Polynomial:
    coefficients = function.getCoefficients()
    return Polynomial(tuple(coefficients.get(index) for index in range(coefficients.size())))


def _piecewise_linear(opensim: Any, function: Any) -> PiecewisePolynomial:
    points = [(function.getX(index), function.getY(index)) for index in range(function.getSize())]
    if len(points) == 1:
        return PiecewisePolynomial((), (Piece(0.0, (points[0][1],)),))
    lines = [Piece(x, (y, (y2 - y) / (x2 - x))) for (x, y), (x2, y2) in pairwise(points)]
    # The first and the last line are extended.
    return PiecewisePolynomial(tuple(x for x, _ in points[1:-1]), tuple(lines))


def _piecewise_constant(opensim: Any, function: Any) -> PiecewisePolynomial:
    points = [(function.getX(index), function.getY(index)) for index in range(function.getSize())]
    knots = tuple(float(np.nextafter(x, np.inf)) for x, _ in points[1:])
    return PiecewisePolynomial(knots, tuple(Piece(0.0, (y,)) for _, y in points))


def _gcv_spline(opensim: Any, spline: Any) -> PiecewisePolynomial:
    """Read a natural spline of any odd degree from its derivatives at the knots; it ends in lower degrees."""
    degree = spline.getDegree()
    knots = [spline.getX(index) for index in range(spline.getSize())]

    def piece(x: float, count: int) -> Piece:
        at = opensim.Vector(1, float(x))
        derivatives = [spline.calcValue(at)]
        derivatives += [
            spline.calcDerivative(opensim.StdVectorInt([0] * order), at) for order in range(1, count + 1)
        ]
        return Piece(x, tuple(value / factorial(order) for order, value in enumerate(derivatives)))

    outer = (degree - 1) // 2
    # Derivatives of the highest order jump at the knots, so that each piece is expanded about its middle.
    inner = (piece(0.5 * (x + end), degree) for x, end in pairwise(knots))
    return PiecewisePolynomial(tuple(knots), (piece(knots[0], outer), *inner, piece(knots[-1], outer)))


def _spline(opensim: Any, spline: Any) -> Spline:
    knots = [spline.getX(index) for index in range(spline.getSize())]
    first = opensim.StdVectorInt([0])
    slopes = []
    for knot in knots:
        at = opensim.Vector(1, float(knot))
        slopes.append(spline.calcDerivative(first, at))
    return Spline(tuple(knots), tuple(spline.getY(index) for index in range(len(knots))), tuple(slopes))


#: Reader of each class of functions of one variable.
_READERS: dict[str, Callable[[Any, Any], Function | None]] = {
    "Constant": lambda opensim, constant: Polynomial((constant.getValue(),)),
    "LinearFunction": lambda opensim, line: Polynomial((line.getSlope(), line.getIntercept())),
    "PolynomialFunction": _polynomial,
    "SimmSpline": _spline,
    "PiecewiseLinearFunction": _piecewise_linear,
    "PiecewiseConstantFunction": _piecewise_constant,
    "GCVSpline": _gcv_spline,
    "MultiplierFunction": _multiplied,
}


def read_pose(transform: Any) -> Pose:
    """Convert an OpenSim ``Transform``."""
    rotation = transform.R().asMat33()
    rows: Matrix = tuple(tuple(rotation.get(i, j) for j in range(3)) for i in range(3))  # type: ignore[assignment]
    origin = transform.p()
    return Pose(rows, (origin.get(0), origin.get(1), origin.get(2)))


def _triple(vector: Any) -> Triple:
    return (float(vector.get(0)), float(vector.get(1)), float(vector.get(2)))
