"""OpenSim model file of a leg, written as text so that it is the same on every machine."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from validation.blind.anatomy import COORDINATES, PELVIS, Body, Cylinder, Leg, Muscle

_LIMITS = {
    "hip_flexion_r": (-0.8, 2.1),
    "hip_adduction_r": (-0.9, 0.9),
    "hip_rotation_r": (-0.9, 0.9),
    "knee_angle_r": (-0.2, 2.1),
    "ankle_angle_r": (-1.0, 0.8),
    "subtalar_angle_r": (-0.7, 0.7),
}
_FRAMES = {"pelvis": "/bodyset/pelvis", "ground": "/ground"}


def number(value: float) -> str:
    """Format with nine significant digits, which suffice for 1e-9 m and are the same on every machine."""
    return f"{value + 0.0:.9g}"


def numbers(values: Iterable[float]) -> str:
    return " ".join(number(value) for value in values)


def leg_text(leg: Leg) -> str:
    """Format a leg as the text of an ``.osim`` file."""
    parts = [
        '<?xml version="1.0" encoding="UTF-8" ?>',
        '<OpenSimDocument Version="40000">',
        '<Model name="leg"><Ground name="ground" /><gravity>0 -9.80665 0</gravity>',
        "<BodySet><objects>",
        *(_body(body, [c for c in leg.cylinders if c.body == body.name]) for body in leg.bodies),
        "</objects></BodySet><JointSet><objects>",
        *_joints(leg),
        "</objects></JointSet><ForceSet><objects>",
        *(_muscle(muscle) for muscle in leg.muscles),
        "</objects></ForceSet></Model></OpenSimDocument>",
    ]
    return "\n".join(parts) + "\n"


def _body(body: Body, cylinders: Sequence[Cylinder]) -> str:
    wraps = "".join(
        f'<WrapCylinder name="{c.name}"><active>true</active>'
        f"<xyz_body_rotation>{numbers(c.rotation)}</xyz_body_rotation>"
        f"<translation>{numbers(c.translation)}</translation><quadrant>{c.quadrant}</quadrant>"
        f"<radius>{number(c.radius)}</radius><length>{number(c.length)}</length></WrapCylinder>\n"
        for c in cylinders
    )
    return (
        f'<Body name="{body.name}">'
        f'<WrapObjectSet name="wrapobjectset"><objects>{wraps}</objects></WrapObjectSet>'
        f"<mass>{number(body.mass)}</mass><mass_center>{numbers(body.center)}</mass_center>"
        f"<inertia>{numbers((*body.inertia, 0, 0, 0))}</inertia></Body>"
    )


def _joints(leg: Leg) -> list[str]:
    zero = (0.0, 0.0, 0.0)
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    hip, knee, ankle = COORDINATES[:3], COORDINATES[3:4], COORDINATES[4:5]
    return [
        _joint("ground_pelvis", "ground", "pelvis", zero, (z, x, y), PELVIS),
        _joint("hip_r", "pelvis", "femur_r", leg.hip_center, (z, x, y), hip),
        _joint("knee_r", "femur_r", "tibia_r", (0.0, -leg.thigh, 0.0), (leg.knee_axis, y, x), knee),
        _joint("ankle_r", "tibia_r", "talus_r", (0.0, -leg.shank, 0.0), (leg.ankle_axis, y, x), ankle),
        _joint("subtalar_r", "talus_r", "calcn_r", leg.subtalar, (leg.subtalar_axis, y, z), COORDINATES[5:]),
    ]


def _joint(name, parent, child, place, axes, coordinates) -> str:
    free = len(coordinates) == 6
    directions = [*axes, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    transform = ""
    for index in range(6):
        kind = f"{'rotation' if index < 3 else 'translation'}{index % 3 + 1}"
        named = coordinates[index] if index < len(coordinates) else ""
        function = (
            '<LinearFunction name="function"><coefficients> 1 0</coefficients></LinearFunction>'
            if named
            else '<Constant name="function"><value>0</value></Constant>'
        )
        transform += (
            f'<TransformAxis name="{kind}"><coordinates>{named}</coordinates>'
            f"<axis>{numbers(directions[index])}</axis>{function}</TransformAxis>\n"
        )
    wide = (-10.0, 10.0) if free else (-2.0, 2.0)
    listed = "".join(
        f'<Coordinate name="{c}"><default_value>{"0.95" if c == "pelvis_ty" else "0"}</default_value>'
        f"<range>{numbers(_LIMITS.get(c, wide))}</range></Coordinate>\n"
        for c in coordinates
    )
    frames = (
        f'<PhysicalOffsetFrame name="{parent}_offset"><socket_parent>{_path(parent)}</socket_parent>'
        f"<translation>{numbers(place)}</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame>\n"
        f'<PhysicalOffsetFrame name="{child}_offset"><socket_parent>{_path(child)}</socket_parent>'
        "<translation>0 0 0</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame>\n"
    )
    return (
        f'<CustomJoint name="{name}"><socket_parent_frame>{parent}_offset</socket_parent_frame>'
        f"<socket_child_frame>{child}_offset</socket_child_frame><coordinates>{listed}</coordinates>"
        f"<frames>{frames}</frames><SpatialTransform>{transform}</SpatialTransform></CustomJoint>"
    )


def _path(body: str) -> str:
    return _FRAMES.get(body, f"/bodyset/{body}")


def _muscle(muscle: Muscle) -> str:
    points = "".join(
        f'<PathPoint name="{muscle.name}-P{order}"><socket_parent_frame>{_path(body)}</socket_parent_frame>'
        f"<location>{numbers(place)}</location></PathPoint>\n"
        for order, (body, place) in enumerate(muscle.points, 1)
    )
    wraps = "".join(
        f'<PathWrap name="pathwrap_{name}"><wrap_object>{name}</wrap_object><range>-1 -1</range>'
        "<method>hybrid</method></PathWrap>\n"
        for name in muscle.cylinders
    )
    return (
        f'<Millard2012EquilibriumMuscle name="{muscle.name}"><GeometryPath name="geometrypath">'
        f"<PathPointSet><objects>{points}</objects></PathPointSet>"
        f"<PathWrapSet><objects>{wraps}</objects></PathWrapSet></GeometryPath>"
        f"<max_isometric_force>{number(muscle.max_isometric_force)}</max_isometric_force>"
        f"<optimal_fiber_length>{number(muscle.optimal_fiber_length)}</optimal_fiber_length>"
        f"<tendon_slack_length>{number(muscle.tendon_slack_length)}</tendon_slack_length>"
        f"<pennation_angle_at_optimal>{number(muscle.pennation)}</pennation_angle_at_optimal>"
        "<max_contraction_velocity>10</max_contraction_velocity>"
        "</Millard2012EquilibriumMuscle>"
    )
