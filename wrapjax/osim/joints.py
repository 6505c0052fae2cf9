"""Read the joints of an OpenSim model as plain data."""

from __future__ import annotations

from typing import Any

from wrapjax.osim.functions import read_function
from wrapjax.skeleton.description import Axis, Joint, Matrix, Pose, Triple
from wrapjax.skeleton.functions import CONSTANT_ZERO, IDENTITY

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

#: Joints whose movements are fixed by their kind, in the order of their coordinates.
_MOVEMENTS: dict[str, tuple[tuple[str, Triple], ...]] = {
    "WeldJoint": (),
    "PinJoint": (("rotation", _Z),),
    "SliderJoint": (("translation", _X),),
    "UniversalJoint": (("rotation", _X), ("rotation", _Y)),
    "GimbalJoint": (("rotation", _X), ("rotation", _Y), ("rotation", _Z)),
    "PlanarJoint": (("rotation", _Z), ("translation", _X), ("translation", _Y)),
}


def read_joint(opensim: Any, joint: Any, state: Any) -> Joint:
    """Read a joint; ``state`` is the model's default one, realized to positions."""
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


def read_pose(transform: Any) -> Pose:
    """Read a transform."""
    rotation = transform.R().asMat33()
    rows: Matrix = tuple(tuple(rotation.get(i, j) for j in range(3)) for i in range(3))  # type: ignore[assignment]
    origin = transform.p()
    return Pose(rows, (origin.get(0), origin.get(1), origin.get(2)))


def _axes(opensim: Any, joint: Any, coordinates: tuple[str, ...]) -> tuple[Axis, ...] | None:
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
    function = read_function(opensim, axis.getFunction()) if axis.hasFunction() else CONSTANT_ZERO
    if function is None:
        return None
    direction = axis.getAxis()
    # OpenSim takes the direction as a unit vector, whatever length the file gives it.
    parts = [direction.get(index) for index in range(3)]
    norm = sum(part * part for part in parts) ** 0.5
    unit = (parts[0] / norm, parts[1] / norm, parts[2] / norm)
    return Axis(movement, unit, names.get(0) if names.getSize() else None, function)
