"""Segments, joints and wrapping cylinders of the virtual leg, from published data.

A right leg of the size of Delp's model: segment frames, joint centers and axes are those of Delp et al. 1990
(An interactive graphics-based model of the lower extremity, doi:10.1109/10.102791) as published in the
gait2392 model; x points forward, y up, z to the right when standing. The pelvis frame sits midway between
the anterior superior iliac spines, the femur's in the hip, the tibia's in the knee.

Values marked *chosen here* are assumptions, not measurements.
"""

from __future__ import annotations

import math

import numpy as np

from wrapjax.osim.virtual_leg import Body, Cylinder, Hinge, Joint

#: Chosen here: about the mean of the men in the sources below.
BODY_MASS_KG = 75.0

_THIGH_LENGTH = 0.396
_SHANK_LENGTH = 0.430

# Fraction of body mass; mass center as fraction of segment length from its upper end (the heel for the foot);
# radii of gyration about x, y, z as fractions of the length. De Leva 1996 (Adjustments to
# Zatsiorsky-Seluyanov's segment inertia parameters, doi:10.1016/0021-9290(95)00178-6), table 4, men.
_THIGH = (0.1416, 0.4095, (0.329, 0.149, 0.329))
_SHANK = (0.0433, 0.4459, (0.255, 0.103, 0.249))
_FOOT = (0.0137, 0.4415, (0.124, 0.245, 0.257))
_LOWER_TRUNK = (0.1117, 0.6115, (0.615, 0.587, 0.551))

#: Chosen here: lengths that de Leva's fractions refer to, for segments whose length the model does not
#: define.
_FOOT_LENGTH, _LOWER_TRUNK_LENGTH = 0.25, 0.146
#: Chosen here: mass (kg) of the talus, split off from the foot so that the two ankle joints are separate.
_TALUS_MASS = 0.1


def _segment(
    name: str,
    shares: tuple[float, float, tuple[float, float, float]],
    length: float,
    direction: tuple[float, float, float],
    *,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    without: float = 0.0,
) -> Body:
    """Build a body from fractions of body mass and length, measured from ``start`` along ``direction``."""
    mass_share, center_share, gyration = shares
    mass = mass_share * BODY_MASS_KG - without
    x, y, z = (round(s + d * center_share * length, 5) for s, d in zip(start, direction, strict=True))
    inertia = tuple(round(mass * (share * length) ** 2, 6) for share in gyration)
    return Body(name, round(mass, 4), (x, y, z), (inertia[0], inertia[1], inertia[2]))


BODIES = (
    _segment("pelvis", _LOWER_TRUNK, _LOWER_TRUNK_LENGTH, (0, -1, 0), start=(-0.0707, 0.03, 0.0)),
    _segment("femur_r", _THIGH, _THIGH_LENGTH, (0, -1, 0)),
    _segment("tibia_r", _SHANK, _SHANK_LENGTH, (0, -1, 0)),
    Body("talus_r", _TALUS_MASS, (0.0, 0.0, 0.0), (0.001, 0.001, 0.001)),
    _segment("calcn_r", _FOOT, _FOOT_LENGTH, (1, 0, 0), start=(0.0, 0.02, 0.0), without=_TALUS_MASS),
)


def _radians(lower: float, upper: float) -> tuple[float, float]:
    return (math.radians(lower), math.radians(upper))


# How the tibia's frame shifts on the femur (m) with knee flexion (rad), as in gait2392: Yamaguchi and Zajac
# 1989 (A planar model of the knee joint, doi:10.1016/0021-9290(89)90179-6).
_KNEE_FLEXION_X = (-0.197344, 0.174533, 0.349066, 0.698132, 1.0472, 1.39626, 1.74533, 2.0944)
_KNEE_SHIFT_X = (-0.005227, -0.0031, -0.001, 0.00212, 0.0041, 0.00411, 0.00179, -0.0032)
_KNEE_FLEXION_Y = (-0.159149, 0.174533, 0.349066, 0.523599, 1.22173, 2.0944)
_KNEE_SHIFT_Y = (-0.395264, -0.3966, -0.3976, -0.399, -0.4082, -0.4226)


def _polynomial(flexion: tuple[float, ...], shift: tuple[float, ...]) -> tuple[float, ...]:
    """Fit a cubic, highest power first; the sources' cubic splines have a discontinuous third derivative."""
    return tuple(
        round(float(c), 6) for c in np.polynomial.Polynomial.fit(flexion, shift, 3).convert().coef[::-1]
    )


JOINTS = (
    # Chosen here: the pelvis is welded to the ground at standing height. The recorded angles are those of the
    # leg relative to the pelvis, and muscle paths depend on these alone.
    Joint("ground_pelvis", "ground", "pelvis", (0.0, 0.95, 0.0)),
    Joint(
        "hip_r",
        "pelvis",
        "femur_r",
        (-0.0707, -0.0661, 0.0835),
        (
            Hinge("hip_flexion_r", (0.0, 0.0, 1.0), _radians(-30, 120)),
            Hinge("hip_adduction_r", (1.0, 0.0, 0.0), _radians(-50, 30)),
            Hinge("hip_rotation_r", (0.0, 1.0, 0.0), _radians(-40, 40)),
        ),
    ),
    Joint(
        "knee_r",
        "femur_r",
        "tibia_r",
        (0.0, 0.0, 0.0),
        # Flexion is positive, as in Rajagopal et al. 2016, doi:10.1109/TBME.2016.2586891.
        (Hinge("knee_angle_r", (0.0, 0.0, -1.0), _radians(-10, 120)),),
        {"x": _polynomial(_KNEE_FLEXION_X, _KNEE_SHIFT_X), "y": _polynomial(_KNEE_FLEXION_Y, _KNEE_SHIFT_Y)},
    ),
    # Axes of both ankle joints: Inman 1976 (The joints of the ankle), by way of Delp et al. 1990.
    Joint(
        "ankle_r",
        "tibia_r",
        "talus_r",
        (0.0, -0.430, 0.0),
        (Hinge("ankle_angle_r", (-0.10501355, -0.17402245, 0.97912632), _radians(-40, 30)),),
    ),
    Joint(
        "subtalar_r",
        "talus_r",
        "calcn_r",
        (-0.04877, -0.04195, 0.00792),
        (Hinge("subtalar_angle_r", (0.78717961, 0.60474746, -0.12094949), _radians(-20, 20)),),
    ),
)

#: The coordinates whose moments are matched, proximal to distal.
COORDINATES = tuple(hinge.coordinate for joint in JOINTS for hinge in joint.hinges)

# Which bone a muscle wraps over follows Arnold et al. 2010 (A model of the lower limb for analysis of human
# movement, doi:10.1007/s10439-009-9852-5). Chosen here: all centers and radii, so that the surface passes
# near the via points of the same muscle in Delp et al. 1990, or (knee) so that moment arms resemble those
# measured by Buford et al. 1997 (IEEE Trans Rehabil Eng 5:367), and so that in walking no path point lies
# inside a cylinder and no path is discontinuous.
#
# The cylinders avoid two defects of OpenSim's wrapping (4.6). Its path is not quite the shortest where it
# runs along the axis, so cylinders are rotated about x to lie across their muscles. It misplaces a tangent
# point if the wrapped segment ends in the cylinder's middle plane, so cylinders at the knee are moved
# sideways.
CYLINDERS = (
    Cylinder("Gmax1_at_pelvis_r", "pelvis", (-0.085, -0.050, 0.083), 0.040, 0.30, "-x", (-0.33, 0.0, 0.0)),
    Cylinder("Gmax2_at_pelvis_r", "pelvis", (-0.095, -0.060, 0.083), 0.042, 0.30, "-x", (-0.39, 0.0, 0.0)),
    Cylinder("Gmax3_at_pelvis_r", "pelvis", (-0.102, -0.095, 0.060), 0.032, 0.30, "-x", (-0.58, 0.0, 0.0)),
    Cylinder("IL_at_brim_r", "pelvis", (-0.060, -0.060, 0.083), 0.035, 0.20, "+x", (-0.07, 0.0, 0.0)),
    Cylinder("PS_at_brim_r", "pelvis", (-0.058, -0.060, 0.075), 0.034, 0.20, "+x", (-0.30, 0.0, 0.0)),
    Cylinder("RF_at_femur_r", "femur_r", (0.004, -0.397, -0.03), 0.039, 0.30, "+x"),
    Cylinder("Vasti_at_femur_r", "femur_r", (0.003, -0.397, -0.03), 0.038, 0.30, "+x"),
    Cylinder("BF_at_condyles_r", "femur_r", (-0.005, -0.400, -0.03), 0.032, 0.30, "-x"),
    Cylinder("ST_at_tibia_r", "tibia_r", (-0.005, -0.020, 0.03), 0.033, 0.30, "-x"),
    Cylinder("Gastroc_at_condyles_r", "femur_r", (-0.003, -0.398, 0.05), 0.026, 0.30, "-x"),
)
