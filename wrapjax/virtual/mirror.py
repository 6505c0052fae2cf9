"""The left leg: the right one in a mirror.

Points change the sign of z. A turn by an angle about an axis becomes a turn by the same angle about the
mirrored axis with its sign changed, so that flexion, adduction and internal rotation stay positive and
equal angles are mirrored poses.
"""

from __future__ import annotations

import re
from dataclasses import replace

from wrapjax.osim.virtual_leg import Body, Cylinder, Hinge, Joint, LegModel, Muscle, Point


def on_side(name: str, side: str) -> str:
    """Name a part of the right leg as that of a side, ``l`` or ``r``; the pelvis is on both."""
    return re.sub(r"_r$", f"_{side}", name)


def mirrored(leg: LegModel) -> LegModel:
    """Turn a right leg into a left one of the same lengths and moment arms at the same angles."""
    return replace(
        leg,
        bodies=tuple(map(_body, leg.bodies)),
        joints=tuple(map(_joint, leg.joints)),
        cylinders=tuple(map(_cylinder, leg.cylinders)),
        muscles=tuple(map(_muscle, leg.muscles)),
    )


def _left(name: str) -> str:
    return on_side(name, "l")


def _point(point: Point) -> Point:
    x, y, z = point
    return (x, y, 0.0 - z)  # no negative zeros


def _axis(axis: Point) -> Point:
    x, y, z = axis
    return (0.0 - x, 0.0 - y, z)


def _body(body: Body) -> Body:
    return replace(body, name=_left(body.name), mass_center=_point(body.mass_center))


def _joint(joint: Joint) -> Joint:
    shift = dict(joint.shift)
    if "z" in shift:
        shift["z"] = tuple(0.0 - coefficient for coefficient in shift["z"])
    return replace(
        joint,
        name=_left(joint.name),
        parent=_left(joint.parent),
        child=_left(joint.child),
        location=_point(joint.location),
        hinges=tuple(map(_hinge, joint.hinges)),
        shift=shift,
    )


def _hinge(hinge: Hinge) -> Hinge:
    return replace(hinge, coordinate=_left(hinge.coordinate), axis=_axis(hinge.axis))


def _cylinder(cylinder: Cylinder) -> Cylinder:
    # Turned about its body-fixed axes one after the other: each turn is mirrored by itself. The sides x
    # and y that paths keep to stay where they are.
    return replace(
        cylinder,
        name=_left(cylinder.name),
        body=_left(cylinder.body),
        center=_point(cylinder.center),
        rotation=_axis(cylinder.rotation),
    )


def _muscle(muscle: Muscle) -> Muscle:
    return replace(
        muscle,
        name=_left(muscle.name),
        points=tuple((_left(body), _point(location)) for body, location in muscle.points),
        cylinder=_left(muscle.cylinder),
    )
