"""Right leg from published data, scaled to a person: bodies, joints, muscles and cylinders.

Lengths in m, masses in kg, x forward, y up, z to the right. Pelvis points are relative to the hip center.
Segment shares of length and mass: Winter 2009, de Leva 1996 (doi:10.1016/0021-9290(95)00178-6). Fiber
lengths and forces: rounded from Ward 2009 (doi:10.1007/s11999-008-0594-8), small muscles combined with their
neighbours. Axes of ankle and subtalar joint: Isman and Inman 1969. Points were placed by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# Tables are easier to read in one line.
# ruff: noqa: E501


COORDINATES = (
    "hip_flexion_r",
    "hip_adduction_r",
    "hip_rotation_r",
    "knee_angle_r",
    "ankle_angle_r",
    "subtalar_angle_r",
)
PELVIS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")

#: Height (m) of the person in whose size the numbers below are given.
REFERENCE_HEIGHT = 1.72
THIGH, SHANK = 0.421, 0.423
HIP_CENTER = (-0.058, -0.080, 0.080)
SUBTALAR = (-0.035, -0.030, 0.006)
ANKLE_AXIS = (-0.10, -0.17, 0.98)
SUBTALAR_AXIS = (0.69, 0.67, -0.28)

Point = tuple[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Body:
    """Rigid body: mass (kg), mass center (m) and moments of inertia (kg m^2) in its frame."""

    name: str
    mass: float
    center: tuple[float, float, float]
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """Wrapping cylinder with its axis along z of its frame; body-fixed rotations x, y, z in rad."""

    name: str
    body: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float]
    radius: float
    length: float
    quadrant: str


@dataclass(frozen=True)
class Muscle:
    """Muscle in the numbers of a model file: N, m, rad, points in their bodies' frames."""

    name: str
    max_isometric_force: float
    optimal_fiber_length: float
    tendon_slack_length: float
    pennation: float
    points: tuple[Point, ...]
    cylinders: tuple[str, ...] = ()


@dataclass(frozen=True)
class Leg:
    """Leg of a person: mass (kg), height (m), joint centers and axes, bodies, cylinders, muscles."""

    mass: float
    height: float
    hip_center: tuple[float, float, float]
    thigh: float
    shank: float
    subtalar: tuple[float, float, float]
    knee_axis: tuple[float, float, float]
    ankle_axis: tuple[float, float, float]
    subtalar_axis: tuple[float, float, float]
    bodies: tuple[Body, ...]
    cylinders: tuple[Cylinder, ...]
    muscles: tuple[Muscle, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(muscle.name for muscle in self.muscles)


P, F, T, C = "pelvis", "femur_r", "tibia_r", "calcn_r"

# name: max force N, fiber length m, pennation deg, points, cylinders
_MUSCLES: dict[str, tuple[float, float, float, list[Point], tuple[str, ...]]] = {
    "iliacus": (1150, 0.107, 14, [(P, (-0.005, 0.095, 0.004)), (P, (0.038, 0.016, -0.003)), (F, (-0.012, -0.060, 0.011))], ("hip_front",)),
    "psoas": (1500, 0.117, 11, [(P, (0.000, 0.170, -0.050)), (P, (0.036, 0.014, -0.006)), (F, (-0.012, -0.063, 0.009))], ("hip_front",)),
    "recfem": (1500, 0.080, 13, [(P, (0.036, 0.034, 0.012)), (F, (0.034, -0.300, 0.010)), (T, (0.042, -0.055, 0.000))], ("knee_front",)),
    "glmax1": (1300, 0.155, 20, [(P, (-0.072, 0.055, -0.030)), (P, (-0.074, 0.000, 0.004)), (F, (-0.044, -0.050, 0.032)), (F, (-0.024, -0.095, 0.040))], ()),
    "glmax2": (1400, 0.165, 22, [(P, (-0.074, -0.005, -0.045)), (P, (-0.078, -0.050, -0.012)), (F, (-0.036, -0.098, 0.022)), (F, (-0.018, -0.135, 0.034))], ()),
    "glmed1": (1700, 0.073, 18, [(P, (0.034, 0.095, 0.030)), (F, (-0.004, -0.010, 0.057))], ()),
    "glmed2": (1700, 0.075, 18, [(P, (-0.040, 0.095, 0.002)), (F, (-0.015, -0.010, 0.056))], ()),
    "addlong": (950, 0.108, 8, [(P, (0.022, -0.036, -0.062)), (F, (0.006, -0.210, 0.022))], ()),
    "addmag": (2100, 0.160, 10, [(P, (-0.038, -0.066, -0.050)), (F, (0.004, -0.250, 0.022))], ()),
    "bflh": (1350, 0.098, 11, [(P, (-0.056, -0.052, -0.010)), (T, (-0.026, -0.036, 0.034)), (T, (-0.020, -0.058, 0.036))], ()),
    "bfsh": (560, 0.110, 12, [(F, (0.004, -0.210, 0.023)), (T, (-0.026, -0.036, 0.033)), (T, (-0.020, -0.058, 0.036))], ()),
    "semimem": (2300, 0.078, 15, [(P, (-0.052, -0.056, -0.016)), (T, (-0.029, -0.036, -0.021)), (T, (-0.018, -0.060, -0.022))], ()),
    "vasmed": (2900, 0.097, 20, [(F, (0.016, -0.200, 0.012)), (F, (0.038, -0.330, 0.004)), (T, (0.042, -0.055, 0.000))], ("knee_front",)),
    "vaslat": (4400, 0.099, 16, [(F, (0.010, -0.190, 0.035)), (F, (0.036, -0.330, 0.022)), (T, (0.042, -0.055, 0.002))], ("knee_front",)),
    "gasmed": (3000, 0.051, 11, [(F, (-0.014, -0.392, -0.022)), (C, (-0.020, 0.000, -0.006))], ("knee_back",)),
    "gaslat": (1500, 0.059, 12, [(F, (-0.014, -0.394, 0.024)), (C, (-0.020, 0.000, -0.003))], ("knee_back",)),
    "soleus": (5900, 0.044, 24, [(T, (-0.004, -0.145, 0.008)), (C, (-0.020, 0.000, -0.004))], ()),
    "tibant": (2000, 0.068, 10, [(T, (0.015, -0.160, 0.012)), (T, (0.030, -0.385, -0.012)), (C, (0.090, -0.004, -0.034))], ()),
    "perlong": (1700, 0.051, 14, [(T, (0.000, -0.155, 0.034)), (T, (-0.016, -0.412, 0.029)), (C, (0.020, -0.010, 0.028)), (C, (0.070, -0.026, 0.010))], ()),
    "tibpost": (1800, 0.038, 14, [(T, (-0.006, -0.130, 0.002)), (T, (-0.014, -0.408, -0.022)), (C, (0.028, 0.004, -0.027)), (C, (0.058, -0.014, -0.024))], ()),
    "tfl": (500, 0.100, 3, [(P, (0.033, 0.055, 0.036)), (F, (0.026, -0.100, 0.058)), (F, (0.005, -0.370, 0.044)), (T, (0.006, -0.022, 0.030))], ()),
    "sart": (280, 0.400, 2, [(P, (0.046, 0.058, 0.010)), (F, (-0.006, -0.360, -0.042)), (T, (-0.006, -0.040, -0.038)), (T, (0.024, -0.085, -0.024))], ()),
}  # fmt: skip

#: Muscles of each EMG channel. The last three muscles of the leg have no channel in any case.
CHANNELS: dict[str, tuple[str, ...]] = {
    "Iliopsoas": ("iliacus", "psoas"),
    "RecFem": ("recfem",),
    "GlutMax": ("glmax1", "glmax2"),
    "GlutMed": ("glmed1", "glmed2"),
    "Adductors": ("addlong", "addmag"),
    "BicFem": ("bflh", "bfsh"),
    "SemiMem": ("semimem",),
    "VastMed": ("vasmed",),
    "VastLat": ("vaslat",),
    "Gastroc": ("gasmed", "gaslat"),
    "Soleus": ("soleus",),
    "TibAnt": ("tibant",),
    "PerLong": ("perlong",),
}
UNRECORDED = ("tibpost", "tfl", "sart")

_CYLINDERS = (
    Cylinder("hip_front", P, (0.002, 0.004, 0.000), (0.0, 0.0, 0.0), 0.026, 0.12, "+x"),
    Cylinder("knee_front", F, (0.002, -THIGH + 0.004, 0.000), (0.0, 0.0, 0.0), 0.041, 0.14, "+x"),
    Cylinder("knee_back", F, (-0.002, -THIGH + 0.004, 0.000), (0.0, 0.0, 0.0), 0.021, 0.14, "-x"),
)


def channel_of(muscles: tuple[str, ...]) -> np.ndarray:
    """Return the index of the channel that drives each muscle, -1 if there is none."""
    driven = {name: index for index, group in enumerate(CHANNELS.values()) for name in group}
    return np.array([driven.get(name.removesuffix("_r"), -1) for name in muscles])


def reference_leg(mass: float, height: float) -> Leg:
    """Scale the leg to a person; tendon slack lengths are set later, from path lengths during walking."""
    s = height / REFERENCE_HEIGHT
    hip = tuple(s * np.array(HIP_CENTER))

    def scaled(point: Point) -> Point:
        body, position = point
        offset = np.array(hip) if body == P else 0.0
        x, y, z = s * np.array(position) + offset
        return body, (float(x), float(y), float(z))

    strength = mass / 72.0
    muscles = tuple(
        Muscle(f"{name}_r", force * strength, fiber * s, 0.1, float(np.radians(angle)), tuple(map(scaled, points)), cylinders)
        for name, (force, fiber, angle, points, cylinders) in _MUSCLES.items()
    )  # fmt: skip
    cylinders = tuple(
        replace(c, translation=scaled((c.body, c.translation))[1], radius=s * c.radius, length=s * c.length)
        for c in _CYLINDERS
    )
    return Leg(
        mass=mass,
        height=height,
        hip_center=(float(hip[0]), float(hip[1]), float(hip[2])),
        thigh=s * THIGH,
        shank=s * SHANK,
        subtalar=(s * SUBTALAR[0], s * SUBTALAR[1], s * SUBTALAR[2]),
        knee_axis=(0.0, 0.0, -1.0),
        ankle_axis=ANKLE_AXIS,
        subtalar_axis=SUBTALAR_AXIS,
        bodies=_bodies(mass, s),
        cylinders=cylinders,
        muscles=muscles,
    )


def _bodies(mass: float, s: float) -> tuple[Body, ...]:
    def segment(name, share, length, center, radii):
        m = share * mass
        x, y, z = (float(m * (r * length) ** 2) for r in radii)
        return Body(name, m, center, (x, y, z))

    thigh, shank, foot = s * THIGH, s * SHANK, 0.152 * s * REFERENCE_HEIGHT
    return (
        segment(P, 0.142, 0.25 * s, (-0.06 * s, 0.02 * s, 0.0), (0.40, 0.42, 0.40)),
        segment(F, 0.1416, thigh, (0.0, -0.41 * thigh, 0.0), (0.329, 0.149, 0.329)),
        segment(T, 0.0433, shank, (0.0, -0.446 * shank, 0.0), (0.253, 0.103, 0.253)),
        segment("talus_r", 0.0015, 0.05 * s, (0.0, 0.0, 0.0), (0.4, 0.4, 0.4)),
        segment(C, 0.0130, foot, (0.075 * s, -0.012 * s, 0.0), (0.124, 0.245, 0.245)),
    )
