"""Build a leg model through the OpenSim API from a plain description of its parts.

The description is data without OpenSim, so that whoever holds the figures need not import it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.io.files import write_atomically
from wrapjax.osim.loading import import_opensim

Point = tuple[float, float, float]

#: The coordinate a translation of a joint follows is the joint's first one.
_TRANSLATIONS = ("x", "y", "z")


@dataclass(frozen=True)
class Body:
    """A rigid segment.

    Parameters
    ----------
    name
        OpenSim's name.
    mass
        kg.
    mass_center
        In the body's frame, m.
    inertia
        Principal moments about the mass center, along the body's axes, kg m^2.
    """

    name: str
    mass: float
    mass_center: Point
    inertia: Point


@dataclass(frozen=True)
class Hinge:
    """One rotation of a joint.

    Parameters
    ----------
    coordinate
        Name of the angle.
    axis
        In the parent's frame, after the joint's earlier rotations. Positive by the right-hand rule.
    range
        Lowest and highest angle in rad; a remark to readers, not enforced.
    """

    coordinate: str
    axis: Point
    range: tuple[float, float]


@dataclass(frozen=True)
class Joint:
    """A joint of up to three rotations, whose center may shift with the first angle.

    Parameters
    ----------
    name, parent, child
        OpenSim's names; the parent may be ``ground``.
    location
        Joint center in the parent's frame, m. The child's frame sits on the joint.
    hinges
        Rotations in order; none: the child is welded on.
    shift
        Along ``x``, ``y`` or ``z`` of the parent, m: polynomials in the first angle (rad), highest power
        first.
    """

    name: str
    parent: str
    child: str
    location: Point
    hinges: tuple[Hinge, ...] = ()
    shift: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Cylinder:
    """A wrapping surface.

    Parameters
    ----------
    name, body
        OpenSim's name, and that of the segment it is fixed to.
    center
        In the body's frame, m.
    radius, length
        m; the axis is z of the cylinder's frame.
    quadrant
        Side that paths keep to, in the cylinder's frame: ``+x``, ``-x``, ``+y``, ``-y`` or ``all``.
    rotation
        Body-fixed x-y-z angles of the cylinder's frame, rad.
    """

    name: str
    body: str
    center: Point
    radius: float
    length: float
    quadrant: str
    rotation: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Muscle:
    """A muscle-tendon unit.

    Parameters
    ----------
    name
        OpenSim's name.
    max_isometric_force
        N.
    optimal_fiber_length, tendon_slack_length
        m.
    pennation_angle
        At optimal fiber length, rad.
    points
        The path from origin to insertion: body and location in its frame (m).
    cylinder
        Name of the surface the path wraps over; empty: none.
    """

    name: str
    max_isometric_force: float
    optimal_fiber_length: float
    tendon_slack_length: float
    pennation_angle: float
    points: tuple[tuple[str, Point], ...]
    cylinder: str = ""


@dataclass(frozen=True)
class LegModel:
    """Everything a leg model is made of."""

    name: str
    credits: str
    publications: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    cylinders: tuple[Cylinder, ...]
    muscles: tuple[Muscle, ...]


def write_leg_model(leg: LegModel, path: Path) -> None:
    """Write the model as an OpenSim 4 document, whole or not at all, the same bytes every time.

    Parameters
    ----------
    leg
        Its parts.
    path
        The ``.osim`` file.
    """
    opensim = import_opensim()
    model = opensim.Model()
    model.setName(leg.name)
    model.set_credits(leg.credits)
    model.set_publications(leg.publications)
    bodies = {"ground": model.getGround()}
    for body in leg.bodies:
        bodies[body.name] = _body(opensim, body)
        model.addBody(bodies[body.name])
    for joint in leg.joints:
        model.addJoint(_joint(opensim, joint, bodies))
    surfaces = {}
    for cylinder in leg.cylinders:
        surfaces[cylinder.name] = _cylinder(opensim, cylinder)
        bodies[cylinder.body].addWrapObject(surfaces[cylinder.name])
    for muscle in leg.muscles:
        model.addForce(_muscle(opensim, muscle, bodies, surfaces))
    model.finalizeConnections()
    write_atomically(path, lambda temporary: model.printToXML(str(temporary)) and None)


def _vector(opensim: Any, values: Point) -> Any:
    return opensim.Vec3(*map(float, values))


def _body(opensim: Any, body: Body) -> Any:
    inertia = opensim.Inertia(*body.inertia, 0.0, 0.0, 0.0)
    return opensim.Body(body.name, body.mass, _vector(opensim, body.mass_center), inertia)


def _joint(opensim: Any, joint: Joint, bodies: dict[str, Any]) -> Any:
    zero = opensim.Vec3(0)
    frames = (bodies[joint.parent], _vector(opensim, joint.location), zero, bodies[joint.child], zero, zero)
    if not joint.hinges:
        return opensim.WeldJoint(joint.name, *frames)
    transform = opensim.SpatialTransform()
    for number, axis in enumerate(_three_axes(joint.hinges)):
        rotation = transform.updTransformAxis(number)
        rotation.setAxis(_vector(opensim, axis))
        if number < len(joint.hinges):
            rotation.setCoordinateNames(_names(opensim, joint.hinges[number].coordinate))
            rotation.set_function(opensim.LinearFunction(1.0, 0.0))
        else:
            rotation.set_function(opensim.Constant(0.0))
    for number, direction in enumerate(_TRANSLATIONS):
        translation = transform.updTransformAxis(3 + number)
        if direction in joint.shift:
            coefficients = joint.shift[direction]
            vector = opensim.Vector(len(coefficients), 0.0)
            for place, coefficient in enumerate(coefficients):
                vector.set(place, coefficient)
            translation.setCoordinateNames(_names(opensim, joint.hinges[0].coordinate))
            translation.set_function(opensim.PolynomialFunction(vector))
        else:
            translation.set_function(opensim.Constant(0.0))
    built = opensim.CustomJoint(joint.name, *frames, transform)
    built.finalizeFromProperties()
    for number, hinge in enumerate(joint.hinges):
        coordinate = built.upd_coordinates(number)
        coordinate.setName(hinge.coordinate)
        coordinate.setRangeMin(hinge.range[0])
        coordinate.setRangeMax(hinge.range[1])
        coordinate.setDefaultClamped(False)
    return built


def _names(opensim: Any, name: str) -> Any:
    names = opensim.ArrayStr()
    names.append(name)
    return names


def _three_axes(hinges: tuple[Hinge, ...]) -> list[Point]:
    """Complete the axes to three independent ones, as OpenSim's spatial transform asks for."""
    axes: list[Point] = [hinge.axis for hinge in hinges]
    for candidate in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        if len(axes) < 3 and np.linalg.matrix_rank([*axes, candidate], tol=0.3) > len(axes):
            axes.append(candidate)
    return axes


def _cylinder(opensim: Any, cylinder: Cylinder) -> Any:
    surface = opensim.WrapCylinder()
    surface.setName(cylinder.name)
    surface.set_translation(_vector(opensim, cylinder.center))
    surface.set_xyz_body_rotation(_vector(opensim, cylinder.rotation))
    surface.set_radius(cylinder.radius)
    surface.set_length(cylinder.length)
    surface.set_quadrant(cylinder.quadrant)
    return surface


def _muscle(opensim: Any, muscle: Muscle, bodies: dict[str, Any], surfaces: dict[str, Any]) -> Any:
    built = opensim.Millard2012EquilibriumMuscle(
        muscle.name,
        muscle.max_isometric_force,
        muscle.optimal_fiber_length,
        muscle.tendon_slack_length,
        muscle.pennation_angle,
    )
    for number, (body, location) in enumerate(muscle.points, start=1):
        built.addNewPathPoint(f"{muscle.name}-P{number}", bodies[body], _vector(opensim, location))
    if muscle.cylinder:
        built.updGeometryPath().addPathWrap(surfaces[muscle.cylinder])
    return built
