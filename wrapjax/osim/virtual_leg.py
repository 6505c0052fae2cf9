"""Writer of an OpenSim leg model from a plain description of its parts, which does not need OpenSim."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.io.files import write_atomically
from wrapjax.osim.loading import import_opensim

Point = tuple[float, float, float]

# Directions of a joint's translations, in the order of OpenSim's spatial transform.
_TRANSLATIONS = ("x", "y", "z")


@dataclass(frozen=True)
class Body:
    """A rigid segment.

    Parameters
    ----------
    name
        OpenSim's name.
    mass
        Mass, kg.
    mass_center
        Center of mass in the body's frame, m.
    inertia
        Principal moments of inertia about the center of mass, along the body's axes, kg m^2.
    """

    name: str
    mass: float
    mass_center: Point
    inertia: Point


@dataclass(frozen=True)
class Hinge:
    """Rotation of a joint about one axis.

    Parameters
    ----------
    coordinate
        Name of the coordinate.
    axis
        Axis in the parent's frame as rotated by the joint's earlier rotations; angles follow the right-hand
        rule.
    range
        Lowest and highest angle, rad; written to the file, but not enforced.
    """

    coordinate: str
    axis: Point
    range: tuple[float, float]


@dataclass(frozen=True)
class Joint:
    """Joint of up to three rotations, whose center may move with the first angle.

    Parameters
    ----------
    name, parent, child
        OpenSim's names; the parent may be ``ground``.
    location
        Joint center in the parent's frame, m, which is the origin of the child's frame.
    hinges
        Rotations in order; none for a weld.
    shift
        Displacement of the center along ``x``, ``y`` or ``z`` of the parent (m), as coefficients of a
        polynomial of the first angle (rad), that of the highest power first.
    """

    name: str
    parent: str
    child: str
    location: Point
    hinges: tuple[Hinge, ...] = ()
    shift: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Cylinder:
    """A wrap cylinder.

    Parameters
    ----------
    name, body
        OpenSim's names of the cylinder and of the body that carries it.
    center
        Center in the body's frame, m.
    radius, length
        Radius and length, m; the axis is z of the cylinder's frame.
    quadrant
        Side of the cylinder's frame on which paths pass: ``+x``, ``-x``, ``+y``, ``-y`` or ``all``.
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
        Maximum isometric force, N.
    optimal_fiber_length, tendon_slack_length
        Lengths, m.
    pennation_angle
        Pennation angle at optimal fiber length, rad.
    points
        Path points from origin to insertion: body, and location in its frame (m).
    cylinder
        Name of the cylinder that the path wraps round; empty for none.
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
    """Parts of a leg model, its name, and the credits and publications that its file names."""

    name: str
    credits: str
    publications: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    cylinders: tuple[Cylinder, ...]
    muscles: tuple[Muscle, ...]


def write_leg_model(leg: LegModel, path: Path) -> None:
    """Write a leg model atomically as an OpenSim 4 file, reproducible to the byte.

    Parameters
    ----------
    leg
        Parts of the model.
    path
        File to write (.osim).
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
            rotation.setCoordinateNames(_name_array(opensim, joint.hinges[number].coordinate))
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
            translation.setCoordinateNames(_name_array(opensim, joint.hinges[0].coordinate))
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


def _name_array(opensim: Any, name: str) -> Any:
    names = opensim.ArrayStr()
    names.append(name)
    return names


def _three_axes(hinges: tuple[Hinge, ...]) -> list[Point]:
    """Complete the axes to three linearly independent ones, which OpenSim's spatial transform requires."""
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
