"""OpenSim model of the virtual leg: muscles from published data, and the left leg as mirror image.

In the mirror image, points change the sign of z. A rotation about an axis becomes a rotation by the same
angle about the mirrored axis with its sign changed, so that flexion, adduction and internal rotation stay
positive and equal angles are mirrored poses.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

from wrapjax.datasets.virtual_person.anatomy import BODIES, CYLINDERS, JOINTS
from wrapjax.osim.virtual_leg import (
    Body,
    Cylinder,
    Hinge,
    Joint,
    LegModel,
    Muscle,
    Point,
    write_leg_model,
)


def on_side(name: str, side: str) -> str:
    """Return the name of a part of the right leg for a side, ``l`` or ``r``; the pelvis keeps its name."""
    return re.sub(r"_r$", f"_{side}", name)


# Max isometric force (N), optimal fiber length (m) and pennation (degrees): Delp et al. 1990,
# doi:10.1109/10.102791, as published in the gait2392 model, like the paths below. Tendon slack length (m,
# third column): chosen here, see `FIBER_LENGTH_CENTER`.
_ARCHITECTURE = {
    "addbrev_r": (429.0, 0.1330, 0.0241, 0.0),
    "addlong_r": (627.0, 0.1380, 0.0966, 6.0),
    "addmagProx_r": (381.0, 0.0870, 0.0461, 5.0),
    "addmagMid_r": (343.0, 0.1210, 0.0992, 3.0),
    "addmagIsch_r": (488.0, 0.1310, 0.2440, 5.0),
    "bflh_r": (896.0, 0.1090, 0.3324, 0.0),
    "bfsh_r": (804.0, 0.1730, 0.0969, 23.0),
    "gaslat_r": (683.0, 0.0640, 0.4221, 8.0),
    "gasmed_r": (1558.0, 0.0600, 0.4273, 17.0),
    "glmax1_r": (573.0, 0.1420, 0.0906, 5.0),
    "glmax2_r": (819.0, 0.1470, 0.0984, 0.0),
    "glmax3_r": (552.0, 0.1440, 0.1239, 5.0),
    "glmed1_r": (819.0, 0.0535, 0.0796, 8.0),
    "glmed2_r": (573.0, 0.0845, 0.0655, 0.0),
    "glmed3_r": (653.0, 0.0646, 0.0639, 19.0),
    "glmin1_r": (270.0, 0.0680, 0.0278, 10.0),
    "glmin2_r": (285.0, 0.0560, 0.0375, 0.0),
    "glmin3_r": (323.0, 0.0380, 0.0568, 1.0),
    "iliacus_r": (1073.0, 0.1000, 0.1145, 7.0),
    "perbrev_r": (435.0, 0.0500, 0.1703, 5.0),
    "perlong_r": (943.0, 0.0490, 0.3566, 10.0),
    "psoas_r": (1113.0, 0.1000, 0.1704, 8.0),
    "recfem_r": (1169.0, 0.1140, 0.4273, 5.0),
    "semimem_r": (1288.0, 0.0800, 0.3508, 15.0),
    "semiten_r": (410.0, 0.2010, 0.2953, 5.0),
    "soleus_r": (3549.0, 0.0500, 0.2515, 25.0),
    "tibant_r": (905.0, 0.0980, 0.2246, 5.0),
    "tibpost_r": (1588.0, 0.0310, 0.3190, 12.0),
    "vasint_r": (1365.0, 0.0870, 0.2415, 3.0),
    "vaslat_r": (1871.0, 0.0840, 0.2564, 5.0),
    "vasmed_r": (1294.0, 0.0890, 0.2260, 5.0),
}

#: Rule for the tendon slack lengths: over the mean gait cycle at 1.2 m/s the range of the normalised fiber
#: length is centered on this value, so that the fibers operate on the plateau and the upper ascending limb of
#: their force-length curve (Arnold and Delp 2011, doi:10.1098/rstb.2010.0345). Published slack lengths are
#: for other paths.
FIBER_LENGTH_CENTER = 0.82

_PELVIS, _FEMUR, _TIBIA, _CALCN = "pelvis", "femur_r", "tibia_r", "calcn_r"

# The knee extensors run over the cylinder of the trochlea straight to the tibial tuberosity. Patella and
# patellar ligament are part of the tendon.
_TUBEROSITY = (_TIBIA, (0.0390, -0.0820, 0.0))
_HEEL = (_CALCN, (0.0, 0.0310, -0.0053))
_FIBULAR_HEAD = (_TIBIA, (-0.0234, -0.0563, 0.0343))

# Attachments and via points from origin to insertion, m: Delp et al. 1990, doi:10.1109/10.102791, as
# published in the gait2392 model. Via points that a cylinder replaces are left out.
_PATHS: dict[str, tuple[tuple[str, Point], ...]] = {
    "addbrev_r": ((_PELVIS, (-0.0587, -0.0915, 0.0164)), (_FEMUR, (0.0009, -0.1196, 0.0294))),
    "addlong_r": ((_PELVIS, (-0.0316, -0.0836, 0.0169)), (_FEMUR, (0.0050, -0.2111, 0.0234))),
    "addmagProx_r": ((_PELVIS, (-0.0732, -0.1174, 0.0255)), (_FEMUR, (-0.0045, -0.1211, 0.0339))),
    "addmagMid_r": ((_PELVIS, (-0.0831, -0.1192, 0.0308)), (_FEMUR, (0.0054, -0.2285, 0.0227))),
    "addmagIsch_r": ((_PELVIS, (-0.1111, -0.1141, 0.0488)), (_FEMUR, (0.0070, -0.3837, -0.0266))),
    "bflh_r": ((_PELVIS, (-0.1260, -0.1026, 0.0694)), _FIBULAR_HEAD),
    "bfsh_r": ((_FEMUR, (0.0050, -0.2111, 0.0234)), _FIBULAR_HEAD),
    # Chosen here: both origins, more proximal than Delp's, so that they lie outside the condyles.
    "gaslat_r": ((_FEMUR, (0.0060, -0.3700, 0.0272)), _HEEL),
    "gasmed_r": ((_FEMUR, (0.0060, -0.3700, -0.0235)), _HEEL),
    "glmax1_r": (
        (_PELVIS, (-0.1195, 0.0612, 0.0700)),
        (_FEMUR, (-0.0457, -0.0248, 0.0392)),
        (_FEMUR, (-0.0277, -0.0566, 0.0470)),
    ),
    "glmax2_r": (
        (_PELVIS, (-0.1349, 0.0176, 0.0563)),
        (_FEMUR, (-0.0426, -0.0530, 0.0293)),
        (_FEMUR, (-0.0156, -0.1016, 0.0419)),
    ),
    "glmax3_r": (
        (_PELVIS, (-0.1556, -0.0314, 0.0058)),
        (_FEMUR, (-0.0299, -0.1041, 0.0135)),
        (_FEMUR, (-0.0060, -0.1419, 0.0411)),
    ),
    "glmed1_r": ((_PELVIS, (-0.0408, 0.0304, 0.1209)), (_FEMUR, (-0.0218, -0.0117, 0.0555))),
    "glmed2_r": ((_PELVIS, (-0.0855, 0.0445, 0.0766)), (_FEMUR, (-0.0258, -0.0058, 0.0527))),
    "glmed3_r": ((_PELVIS, (-0.1223, 0.0105, 0.0648)), (_FEMUR, (-0.0309, -0.0047, 0.0518))),
    "glmin1_r": ((_PELVIS, (-0.0467, -0.0080, 0.1056)), (_FEMUR, (-0.0072, -0.0104, 0.0560))),
    "glmin2_r": ((_PELVIS, (-0.0633, -0.0065, 0.0991)), (_FEMUR, (-0.0096, -0.0104, 0.0560))),
    "glmin3_r": ((_PELVIS, (-0.0834, -0.0063, 0.0856)), (_FEMUR, (-0.0135, -0.0083, 0.0550))),
    "iliacus_r": ((_PELVIS, (-0.0674, 0.0365, 0.0854)), (_FEMUR, (-0.0193, -0.0621, 0.0129))),
    "perbrev_r": (
        (_TIBIA, (-0.0070, -0.2646, 0.0325)),
        (_TIBIA, (-0.0198, -0.4184, 0.0283)),
        (_TIBIA, (-0.0144, -0.4295, 0.0289)),
        (_CALCN, (0.0471, 0.0270, 0.0233)),
        (_CALCN, (0.0677, 0.0219, 0.0343)),
    ),
    "perlong_r": (
        (_TIBIA, (0.0005, -0.1568, 0.0362)),
        (_TIBIA, (-0.0207, -0.4205, 0.0286)),
        (_TIBIA, (-0.0162, -0.4319, 0.0289)),
        (_CALCN, (0.0438, 0.0230, 0.0221)),
        (_CALCN, (0.0681, 0.0106, 0.0284)),
        (_CALCN, (0.0852, 0.0069, 0.0118)),
        (_CALCN, (0.1203, 0.0085, -0.0184)),
    ),
    "psoas_r": ((_PELVIS, (-0.0647, 0.0887, 0.0289)), (_FEMUR, (-0.0188, -0.0597, 0.0104))),
    "recfem_r": ((_PELVIS, (-0.0295, -0.0311, 0.0968)), _TUBEROSITY),
    "semimem_r": (
        (_PELVIS, (-0.1192, -0.0975, 0.0715)),
        (_TIBIA, (-0.0348, -0.0352, -0.0189)),
        (_TIBIA, (-0.0270, -0.0477, -0.0196)),
    ),
    "semiten_r": ((_PELVIS, (-0.1264, -0.1099, 0.0604)), (_TIBIA, (0.0027, -0.0956, -0.0193))),
    "soleus_r": ((_TIBIA, (-0.0024, -0.1533, 0.0071)), _HEEL),
    "tibant_r": (
        (_TIBIA, (0.0179, -0.1624, 0.0115)),
        (_TIBIA, (0.0329, -0.3951, -0.0177)),
        (_CALCN, (0.1166, 0.0178, -0.0305)),
    ),
    "tibpost_r": (
        (_TIBIA, (-0.0094, -0.1348, 0.0019)),
        (_TIBIA, (-0.0144, -0.4051, -0.0229)),
        (_CALCN, (0.0417, 0.0334, -0.0286)),
        (_CALCN, (0.0772, 0.0159, -0.0281)),
    ),
    "vasint_r": (
        (_FEMUR, (0.0290, -0.1924, 0.0310)),
        (_FEMUR, (0.0335, -0.2084, 0.0285)),
        _TUBEROSITY,
    ),
    "vaslat_r": (
        (_FEMUR, (0.0048, -0.1854, 0.0349)),
        (_FEMUR, (0.0269, -0.2591, 0.0409)),
        _TUBEROSITY,
    ),
    "vasmed_r": (
        (_FEMUR, (0.0140, -0.2099, 0.0188)),
        (_FEMUR, (0.0356, -0.2769, 0.0009)),
        _TUBEROSITY,
    ),
}

_CYLINDER_OF = {
    "bflh_r": "BF_at_condyles_r",
    "bfsh_r": "BF_at_condyles_r",
    "gaslat_r": "Gastroc_at_condyles_r",
    "gasmed_r": "Gastroc_at_condyles_r",
    "glmax1_r": "Gmax1_at_pelvis_r",
    "glmax2_r": "Gmax2_at_pelvis_r",
    "glmax3_r": "Gmax3_at_pelvis_r",
    "iliacus_r": "IL_at_brim_r",
    "psoas_r": "PS_at_brim_r",
    "recfem_r": "RF_at_femur_r",
    "semiten_r": "ST_at_tibia_r",
    "vasint_r": "Vasti_at_femur_r",
    "vaslat_r": "Vasti_at_femur_r",
    "vasmed_r": "Vasti_at_femur_r",
}

MUSCLES = tuple(
    Muscle(
        name=name,
        max_isometric_force=force,
        optimal_fiber_length=fiber,
        tendon_slack_length=tendon,
        pennation_angle=round(math.radians(pennation), 4),
        points=_PATHS[name],
        cylinder=_CYLINDER_OF.get(name, ""),
    )
    for name, (force, fiber, tendon, pennation) in _ARCHITECTURE.items()
)


LEG = LegModel(
    name="virtual_leg",
    credits="Built by wrapjax from published figures; no person's leg.",
    publications=(
        "Attachments, architecture, joints: Delp et al. 1990, doi:10.1109/10.102791. "
        "Knee: Yamaguchi and Zajac 1989, doi:10.1016/0021-9290(89)90179-6. "
        "Inertia: de Leva 1996, doi:10.1016/0021-9290(95)00178-6. "
        "Wrapping after Arnold et al. 2010, doi:10.1007/s10439-009-9852-5."
    ),
    bodies=BODIES,
    joints=JOINTS,
    cylinders=CYLINDERS,
    muscles=MUSCLES,
)


def mirrored(leg: LegModel) -> LegModel:
    """Mirror a right leg to a left one with the same muscle lengths and moment arms at the same angles."""
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
    return (x, y, 0.0 - z)  # 0.0 - z, because -z would write negative zeros.


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
    # Rotations about body-fixed axes are mirrored one by one. The wrapping sides along x and y do not change.
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


def build_leg_model(path: Path, side: str = "r") -> None:
    """Write the OpenSim model of the virtual leg (``.osim``), always with the same bytes.

    The leg has 6 degrees of freedom, 31 muscles and 10 wrapping cylinders; the pelvis is welded to the ground
    at standing height.

    Parameters
    ----------
    path
        File to write.
    side
        Side of the leg: ``r``, or ``l`` for its mirror image.
    """
    write_leg_model({"r": LEG, "l": mirrored(LEG)}[side], Path(path))
