"""OpenSim models of one path from point to point round one or several surfaces that are fixed in space.

Both ends are carried by bodies that translate along x, y and z: a pose is the position of both ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

#: Coordinates of poses: positions of the path's start and end (m).
COORDINATES = tuple(f"{end}_{axis}" for end in ("start", "end") for axis in "xyz")
#: Name of the muscle.
MUSCLE = "path"


@dataclass(frozen=True)
class SurfaceDraw:
    """A wrap surface.

    Parameters
    ----------
    kind
        ``cylinder``, ``sphere``, ``ellipsoid`` or ``torus``.
    sizes
        Radius and length of a cylinder, radius of a sphere, semi-axes of an ellipsoid, ring and tube radius
        of a torus, m.
    quadrant
        OpenSim's quadrant.
    method
        OpenSim's method for ellipsoids.
    center, angles
        Position (m) and body-fixed x-y-z angles (rad) in space.
    """

    kind: str
    sizes: tuple[float, ...]
    quadrant: str = "all"
    method: str = "hybrid"
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angles: tuple[float, float, float] = (0.0, 0.0, 0.0)


def write_model(surfaces: Sequence[SurfaceDraw], file: Path) -> None:
    """Write the model of a path round surfaces."""
    import opensim

    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    model.setName("single_path")
    ends = [_translating_body(opensim, model, name) for name in ("start", "end")]
    muscle = opensim.Millard2012EquilibriumMuscle(MUSCLE, 100.0, 0.1, 0.2, 0.0)
    for name, body in zip(("start", "end"), ends, strict=True):
        muscle.addNewPathPoint(f"{name}_point", body, opensim.Vec3(0))
    for number, surface in enumerate(surfaces):
        wrap = wrap_object(opensim, surface)
        wrap.setName(f"surface_{number}")
        wrap.set_quadrant(surface.quadrant)
        wrap.set_translation(opensim.Vec3(*surface.center))
        wrap.set_xyz_body_rotation(opensim.Vec3(*surface.angles))
        model.updGround().addWrapObject(wrap)
        muscle.updGeometryPath().addPathWrap(wrap)
        muscle.updGeometryPath().updWrapSet().get(number).set_method(surface.method)
    model.addForce(muscle)
    model.finalizeConnections()
    model.printToXML(str(file))


def _translating_body(opensim: Any, model: Any, name: str) -> Any:
    """Add a body that three joints translate along x, y and z."""
    parent = model.updGround()
    # Rotations that turn the joint's axis, x, into each axis.
    turns = {"x": (0.0, 0.0, 0.0), "y": (0.0, 0.0, 0.5 * np.pi), "z": (0.0, -0.5 * np.pi, 0.0)}
    for axis, turn in turns.items():
        body = opensim.Body(f"{name}_body_{axis}", 1.0, opensim.Vec3(0), opensim.Inertia(0.1, 0.1, 0.1))
        model.addBody(body)
        frame = (opensim.Vec3(0), opensim.Vec3(*turn))
        joint = opensim.SliderJoint(f"{name}_{axis}_joint", parent, *frame, body, *frame)
        joint.updCoordinate().setName(f"{name}_{axis}")
        model.addJoint(joint)
        parent = body
    return parent


def wrap_object(opensim: Any, surface: SurfaceDraw) -> Any:
    """Make a wrap object with the sizes of a surface."""
    sizes = surface.sizes
    if surface.kind == "cylinder":
        wrap = opensim.WrapCylinder()
        wrap.set_radius(sizes[0])
        wrap.set_length(sizes[1])
    elif surface.kind == "sphere":
        wrap = opensim.WrapSphere()
        wrap.set_radius(sizes[0])
    elif surface.kind == "ellipsoid":
        wrap = opensim.WrapEllipsoid()
        wrap.set_dimensions(opensim.Vec3(*sizes))
    else:
        wrap = opensim.WrapTorus()
        wrap.set_outer_radius(sizes[0])
        wrap.set_inner_radius(sizes[1])
    return wrap


def scholz_model(
    surface: SurfaceDraw, hint: Float[np.ndarray, " 3"], pose: Float[np.ndarray, " coordinate"]
) -> tuple[Any, Any]:
    """Make a model of a path round a surface as OpenSim's ``Scholz2015GeometryPath``, and its path.

    Parameters
    ----------
    surface
        Surface.
    hint
        Point of the surface, in its frame, from which the first contact is searched, m.
    pose
        Default pose: OpenSim's first search fails in poses with ends inside the surface.
    """
    import opensim

    model, ends = _moving_ends(opensim, pose)
    none, angles = opensim.Vec3(0), opensim.Vec3(*surface.angles)
    sizes, ground = surface.sizes, model.getGround()
    if surface.kind == "cylinder":
        contact = opensim.ContactCylinder(sizes[0], none, angles, ground)
    elif surface.kind == "sphere":
        contact = opensim.ContactSphere(sizes[0], none, ground)
    elif surface.kind == "ellipsoid":
        contact = opensim.ContactEllipsoid(opensim.Vec3(*sizes), none, angles, ground)
    else:
        contact = opensim.ContactTorus(*sizes, none, angles, ground)
    contact.setName("surface")
    model.addContactGeometry(contact)
    path = opensim.Scholz2015GeometryPath()
    path.setName(MUSCLE)
    path.appendPathPoint(ends[0], none)
    path.appendObstacle(contact, opensim.Vec3(*map(float, hint)))
    path.appendPathPoint(ends[1], none)
    model.addComponent(path)
    model.finalizeConnections()
    return model, path


def _moving_ends(opensim: Any, pose: Float[np.ndarray, " coordinate"]) -> tuple[Any, list[Any]]:
    """Make a model of the bodies of both ends, in a default pose."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model()
    model.setName("single_path")
    ends = [_translating_body(opensim, model, name) for name in ("start", "end")]
    defaults = dict(zip(COORDINATES, pose, strict=True))
    for number in range(model.getJointSet().getSize()):
        coordinate = model.updJointSet().get(number).upd_coordinates(0)
        coordinate.setDefaultValue(float(defaults[coordinate.getName()]))
    return model, ends


def by_scholz(
    surface: SurfaceDraw, hint: Float[np.ndarray, " 3"], poses: Float[np.ndarray, "pose coordinate"]
) -> tuple[Float[np.ndarray, " pose"], float]:
    """Compute lengths (m) in poses one after the other by ``Scholz2015GeometryPath``.

    Each pose starts from the path of the last one. NaN where OpenSim fails, and from there on.

    Returns
    -------
    lengths, seconds
        Lengths, and the time a pose that they take beside positions, s; NaN if the first pose fails.
    """
    import opensim

    lengths = np.full(len(poses), np.nan)
    bare, _ = _moving_ends(opensim, poses[0])
    _, alone = _in_poses(bare, lambda state: 0.0, poses, np.zeros(len(poses)))
    model, path = scholz_model(surface, hint, poses[0])
    done, taken = _in_poses(model, path.getLength, poses, lengths)
    return lengths, taken / done - alone / len(poses) if done else np.nan


def _in_poses(
    model: Any,
    quantity: Callable[[Any], float],
    poses: Float[np.ndarray, "pose coordinate"],
    values: Float[np.ndarray, " pose"],
) -> tuple[int, float]:
    """Fill in values of a quantity in poses up to a failure; return their number and time, s."""
    taken, row = 0.0, 0
    try:
        state = model.initSystem()
        coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
        for row, pose in enumerate(poses):
            for coordinate, value in zip(coordinates, pose, strict=True):
                coordinate.setValue(state, float(value), False)
            began = time.perf_counter()
            model.realizePosition(state)
            values[row] = quantity(state)
            taken += time.perf_counter() - began
    except RuntimeError:
        return row, taken
    return len(poses), taken


def by_opensim(
    file: Path, poses: Float[np.ndarray, "pose coordinate"]
) -> tuple[Float[np.ndarray, " pose"], Float[np.ndarray, "pose coordinate"]]:
    """Compute the length (m) and moment arms (1) of the path in poses by OpenSim."""
    import opensim

    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(file))
    state = model.initSystem()
    path = model.getMuscles().get(0).getGeometryPath()
    coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
    lengths, arms = np.zeros(len(poses)), np.zeros(poses.shape)
    for row, pose in enumerate(poses):
        for coordinate, value in zip(coordinates, pose, strict=True):
            coordinate.setValue(state, float(value), False)
        model.realizePosition(state)
        lengths[row] = path.getLength(state)
        arms[row] = [path.computeMomentArm(state, coordinate) for coordinate in coordinates]
    return lengths, arms
