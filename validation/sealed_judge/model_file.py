"""Write the lab's model as an OpenSim 4 file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from . import anatomy
from .leg import Leg
from .muscle import Constants


def _text(values: np.ndarray | tuple | list | float) -> str:
    """Return numbers as OpenSim writes them."""
    return " ".join(f"{float(v):.10g}" for v in np.atleast_1d(np.asarray(values, float)))


def _add(parent: ET.Element, tag: str, text: str | None = None, name: str | None = None) -> ET.Element:
    """Append a child with optional text and name."""
    child = ET.SubElement(parent, tag, {} if name is None else {"name": name})
    if text is not None:
        child.text = text
    return child


def mirror(point: np.ndarray, side: str) -> np.ndarray:
    """Return a position of the right side as one of the given side."""
    return np.asarray(point, float) * (np.array([1, 1, -1]) if side == "l" else 1.0)


def mirror_axis(axis: np.ndarray, side: str) -> np.ndarray:
    """Return a rotation axis of the right side as one of the given side (a mirrored pseudovector)."""
    return np.asarray(axis, float) * (np.array([-1, -1, 1]) if side == "l" else 1.0)


def body_name(index: int, side: str) -> str:
    """Return the name of a body."""
    return "pelvis" if index == 0 else f"{anatomy.BODIES[index]}_{side}"


def _frame(joint: ET.Element, parent: str, offset: np.ndarray, child: str) -> None:
    """Add the two offset frames of a joint."""
    _add(joint, "socket_parent_frame", f"{parent}_offset")
    _add(joint, "socket_child_frame", f"{child}_offset")
    frames = _add(joint, "frames")
    for body, place in ((parent, offset), (child, np.zeros(3))):
        f = _add(frames, "PhysicalOffsetFrame", name=f"{body}_offset")
        _add(f, "socket_parent", "/ground" if body == "ground" else f"/bodyset/{body}")
        _add(f, "translation", _text(place))
        _add(f, "orientation", "0 0 0")


def _joint(
    parent: ET.Element, name: str, bodies: tuple[str, str], offset: np.ndarray, axes: list, moves: list
) -> None:
    """Add a CustomJoint: rotations (coordinate, axis) and translations (coordinate) in order."""
    joint = _add(parent, "CustomJoint", name=name)
    _frame(joint, bodies[0], offset, bodies[1])
    coordinates = _add(joint, "coordinates")
    for label, rotational in [(a, True) for a, _ in axes] + [(m, False) for m in moves]:
        c = _add(coordinates, "Coordinate", name=label)
        _add(c, "default_value", "0" if label != "pelvis_ty" else "0.9")
        _add(c, "range", "-3.1416 3.1416" if rotational else "-5 5")
        _add(c, "clamped", "false")
        _add(c, "locked", "false")
    transform = _add(joint, "SpatialTransform")
    unit = np.eye(3)
    # Axes of missing rotations only complete an independent set.
    vectors = [np.asarray(a) for _, a in axes]
    while len(vectors) < 3:
        spare = min(unit, key=lambda u: max(abs(u @ v) / np.linalg.norm(v) for v in vectors))
        normal = spare - vectors[0] * (spare @ vectors[0]) / (vectors[0] @ vectors[0])
        if len(vectors) == 2:
            normal = np.cross(vectors[0], vectors[1])
        vectors.append(normal / np.linalg.norm(normal))
    for i in range(6):
        rot = i < 3
        axis = _add(transform, "TransformAxis", name=f"{'rotation' if rot else 'translation'}{i % 3 + 1}")
        used = axes[i][0] if rot and i < len(axes) else (moves[i - 3] if not rot and moves else None)
        _add(axis, "coordinates", used or "")
        _add(axis, "axis", _text(vectors[i] if rot else unit[i - 3]))
        function = _add(axis, "LinearFunction" if used else "Constant", name="function")
        if used:
            _add(function, "coefficients", " 1 0")
        else:
            _add(function, "value", "0")


def write_model(path: Path, leg: Leg, muscles: Constants, side: str, name: str) -> None:
    """Write the model.

    Parameters
    ----------
    path : Path
        File to write.
    leg : Leg
        Geometry and inertia, as a right leg.
    muscles : Constants
        Muscle constants.
    side : str
        ``l`` or ``r``.
    name : str
        Model name.
    """
    root = ET.Element("OpenSimDocument", Version="40000")
    model = _add(root, "Model", name=name)
    _add(model, "gravity", "0 -9.80665 0")
    _add(model, "length_units", "meters")
    _add(model, "force_units", "N")
    bodies = _add(_add(model, "BodySet", name="bodyset"), "objects")
    for i, key in enumerate(anatomy.BODIES):
        mass, com, inertia = leg.segments[key]
        body = _add(bodies, "Body", name=body_name(i, side))
        wraps = [(n, c) for n, c in leg.cylinders.items() if c.body == i]
        if wraps:
            objects = _add(_add(body, "WrapObjectSet", name="wrapobjectset"), "objects")
            for n, c in wraps:
                w = _add(objects, "WrapCylinder", name=f"{n}_{side}")
                _add(w, "active", "true")
                _add(w, "xyz_body_rotation", "0 0 0")
                _add(w, "translation", _text(mirror(c.centre, side)))
                _add(w, "quadrant", "+x" if c.side > 0 else "-x")
                _add(w, "radius", _text(c.radius))
                _add(w, "length", "0.4")
        _add(body, "mass", _text(mass))
        _add(body, "mass_center", _text(mirror(com, side)))
        _add(body, "inertia", _text(list(inertia) + [0, 0, 0]))
    joints = _add(_add(model, "JointSet", name="jointset"), "objects")
    ex, ey, ez = np.eye(3)
    pelvis = list(zip(anatomy.PELVIS_COORDS[:3], (ez, ex, ey), strict=True))
    _joint(
        joints, "ground_pelvis", ("ground", "pelvis"), np.zeros(3), pelvis, list(anatomy.PELVIS_COORDS[3:])
    )
    hip = [
        (f"{c}_{side}", mirror_axis(a, side)) for c, a in zip(anatomy.COORDS[:3], (ez, ex, ey), strict=True)
    ]
    for i, joint in enumerate(leg.joints):
        axes = (
            hip
            if joint == "hip"
            else [(f"{anatomy.COORDS[2 + i]}_{side}", mirror_axis(leg.axes[joint], side))]
        )
        pair = (body_name(i, side), body_name(i + 1, side))
        _joint(joints, f"{joint}_{side}", pair, mirror(leg.joints[joint], side), axes, [])
    forces = _add(_add(model, "ForceSet", name="forceset"), "objects")
    for i, key in enumerate(anatomy.NAMES):
        m = _add(forces, "Millard2012EquilibriumMuscle", name=f"{key}_{side}")
        geometry = _add(m, "GeometryPath", name="path")
        points = _add(_add(geometry, "PathPointSet"), "objects")
        for j, (body, place) in enumerate(zip(*leg.paths[key], strict=True)):
            p = _add(points, "PathPoint", name=f"{key}_{side}-P{j + 1}")
            _add(p, "socket_parent_frame", f"/bodyset/{body_name(int(body), side)}")
            _add(p, "location", _text(mirror(place, side)))
        wrap = leg.wraps[key]
        if wrap is not None:
            w = _add(_add(_add(geometry, "PathWrapSet"), "objects"), "PathWrap", name="pathwrap")
            _add(w, "wrap_object", f"{wrap[0]}_{side}")
            _add(w, "method", "hybrid")
            _add(w, "range", f"{wrap[1] + 1} {wrap[1] + 2}")
        _add(m, "max_isometric_force", _text(muscles.fmax[i]))
        _add(m, "optimal_fiber_length", _text(muscles.lo[i]))
        _add(m, "tendon_slack_length", _text(muscles.ls[i]))
        _add(m, "pennation_angle_at_optimal", _text(muscles.pennation[i]))
        _add(m, "max_contraction_velocity", "10")
        _add(m, "ignore_tendon_compliance", "true")
    ET.indent(root, "\t")
    ET.ElementTree(root).write(path, encoding="UTF-8", xml_declaration=True)
