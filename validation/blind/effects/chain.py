"""Geometry that is not as believed, and the chain from cameras and plates to joint moments.

Moments change by what OpenSim's inverse dynamics makes of wrong input, less what it makes of right input.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from validation.blind.anatomy import Leg
from validation.blind.effects.effect import Effect, Variant
from validation.blind.gait import RATE, lowpass
from validation.blind.geometry import changed_paths, ground_moments, muscle_indices
from validation.blind.world import World

# Tables are easier to read in one line.
# ruff: noqa: E501


def _with_ground(world: World, ground: np.ndarray) -> World:
    """Another ground force is recorded, and inverse dynamics believes it."""
    change = ground_moments(world.leg, world.walk, ground=ground) - world.inverse
    wrong = ground - world.walk.ground
    return replace(
        world,
        recorded_moments=(*world.recorded_moments, change),
        recorded_ground=(*world.recorded_ground, lambda now, recorded: recorded + wrong),
    )


def _with_leg(world: World, real: Leg, coordinates: tuple[str, ...]) -> World:
    """The real leg differs from the believed one, with which inverse dynamics was done."""
    change = world.inverse - ground_moments(real, world.walk)
    world = replace(world, recorded_moments=(*world.recorded_moments, change))
    if not coordinates:
        return world
    paths = changed_paths(world, real, muscles=muscle_indices(real, coordinates))
    return replace(world, paths=paths)


def _with_pose(world: World, shift: np.ndarray) -> World:
    """Other angles are recorded than the leg had; muscles know the true ones."""
    change = ground_moments(world.leg, world.walk, pose=world.walk.pose + shift)
    change = change - world.inverse
    return replace(
        world,
        recorded_pose=(*world.recorded_pose, shift),
        recorded_moments=(*world.recorded_moments, change),
    )


def _center_of_pressure(world: World, amount: float, variant: Variant) -> World:
    direction = {"anterior": (1.0, 0.0), "lateral": (0.0, 1.0)}[variant[0]]
    ground = world.walk.ground.copy()
    load = ground[:, 1] / (9.80665 * world.leg.mass)
    # A plate that bends: the offset grows a little with load.
    off = amount * (0.85 + 0.2 * load) * (ground[:, 1] > 20.0)
    ground[:, 3] += off * direction[0]
    ground[:, 5] += off * direction[1]
    return _with_ground(world, ground)


def _crossed(world: World, amount: float, variant: Variant) -> World:
    ground, other = world.walk.ground.copy(), world.walk.other_ground
    both = (ground[:, 1] > 20.0) & (other[:, 1] > 20.0)
    window = gaussian_filter1d(both.astype(float), 0.015 * RATE, axis=-1)
    # The other foot's force leaks onto this plate, at this foot's point.
    ground[:, :3] += amount * window[:, None] * other[:, :3] * (ground[:, 1:2] > 20.0)
    return _with_ground(world, ground)


def _late(world: World, amount: float, variant: Variant) -> World:
    time = world.walk.time
    ground = world.walk.ground.copy()
    # Points are held where nothing stands on the plate: a mean of a place and of zeros is no place.
    ground[:, 3:6] = _held(ground[:, 3:6], ground[:, 1:2])
    # A fifth of the lag is that of an analogue filter, the rest a plain delay.
    plain, filtered = 0.8 * amount, 0.2 * abs(amount)
    ground = np.array([[np.interp(time - plain, time, row) for row in recording] for recording in ground])
    if filtered > 0.0:
        keep = np.exp(-1.0 / (filtered * RATE))
        smooth = lfilter([1.0 - keep], [1.0, -keep], ground[:, :3], axis=-1)
        ground[:, :3] = smooth if amount > 0.0 else 2.0 * ground[:, :3] - smooth
    ground[:, 3:6] = np.where(np.abs(ground[:, 1:2]) > 1e-9, ground[:, 3:6], 0.0)
    return _with_ground(world, ground)


def _held(points: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Points where there is no load take the nearest in time where there is."""
    out = points.copy()
    frames = np.arange(points.shape[-1])
    for recording, loads in zip(out, load[:, 0], strict=True):
        good = np.flatnonzero(loads > 1e-9)
        weak = loads <= 1e-9
        after = np.clip(np.searchsorted(good, frames), 1, good.size - 1)
        closer = np.where(frames - good[after - 1] < good[after] - frames, good[after - 1], good[after])
        recording[:, weak] = recording[:, closer[weak]]
    return out


def _hip_center(world: World, amount: float, variant: Variant) -> World:
    axis = {"anterior": 0, "up": 1, "lateral": 2}[variant[0]]
    center = np.array(world.leg.hip_center)
    center[axis] += amount
    x, y, z = map(float, center)
    real = replace(world.leg, hip_center=(x, y, z))
    return _with_leg(world, real, ("hip",))


def _axis(world: World, amount: float, variant: Variant) -> World:
    name = variant[0]
    field = f"{name}_axis"
    axis = np.array(getattr(world.leg, field), float)
    axis /= np.linalg.norm(axis)
    turn = np.array([0.2, 1.0, 0.1]) if name != "subtalar" else np.array([0.0, 0.4, 1.0])
    turn = turn - axis * (turn @ axis)
    turn /= np.linalg.norm(turn)
    angle = np.radians(amount)
    turned = axis * np.cos(angle) + np.cross(turn, axis) * np.sin(angle)
    # By name, which types cannot follow.
    changed: dict[str, Any] = {field: tuple(map(float, turned))}
    real = replace(world.leg, **changed)
    return _with_leg(world, real, (name,))


_SEGMENTS = {"thigh": "femur_r", "shank": "tibia_r", "foot": "calcn_r"}


def _inertia(world: World, amount: float, variant: Variant) -> World:
    name = _SEGMENTS[variant[0]]
    bodies = []
    for body in world.leg.bodies:
        if body.name == name:
            # Mass that is missing in tables sits distally: the centre moves with it.
            x, y, z = body.center
            scale = 1.0 + amount
            xx, yy, zz = (float(value * scale**1.2) for value in body.inertia)
            center = (x, y * (1.0 + 0.15 * amount), z)
            body = replace(body, mass=body.mass * scale, center=center, inertia=(xx, yy, zz))
        bodies.append(body)
    return _with_leg(world, replace(world.leg, bodies=tuple(bodies)), ())


def _soft_tissue(world: World, amount: float, variant: Variant) -> World:
    walk = world.walk
    knee = walk.angles[:, 3]
    load = walk.ground[:, 1] / (9.80665 * world.leg.mass)
    shock = gaussian_filter1d(np.gradient(load, 1.0 / RATE, axis=-1), 0.02 * RATE, axis=-1)
    # Skin slides with knee flexion and shakes after the heel strike; markers show both.
    slide = np.tanh((knee - np.median(knee)) / 0.6) + 0.03 * shock
    shift = np.zeros_like(walk.pose)
    shares = {"thigh": {6: 0.35, 8: 1.0, 9: -0.4}, "shank": {9: 0.5, 10: -0.5, 8: 0.5}}[variant[0]]
    for row, share in shares.items():
        shift[:, row] = np.radians(amount) * share * slide
    return _with_pose(world, lowpass(shift, 6.0, RATE))


def _foot(world: World, amount: float, variant: Variant) -> World:
    load = world.walk.ground[:, 1] / (9.80665 * world.leg.mass)
    forward = np.clip((world.walk.stance - 0.3) / 0.6, 0.0, 1.0)
    keep = np.exp(-1.0 / (0.06 * RATE))
    # A midfoot that creeps: load on the forefoot, a lag of 60 ms, saturating.
    creep = lfilter([1.0 - keep], [1.0, -keep], np.nan_to_num(load * forward), axis=-1)
    shift = np.zeros_like(world.walk.pose)
    shift[:, 10] = np.radians(amount) * np.tanh(1.3 * creep)
    return _with_pose(world, lowpass(shift, 6.0, RATE))


def _wrap(world: World, amount: float, variant: Variant) -> World:
    name, kind = variant
    cylinders = []
    for c in world.leg.cylinders:
        if c.name == name:
            x, y, z = c.translation
            if kind == "radius":
                c = replace(c, radius=c.radius * (1.0 + amount))
            else:
                # Forward and up together, and turned by as much as that tilts it.
                c = replace(c, translation=(x + 0.03 * amount, y + 0.012 * amount, z), rotation=(0.3 * amount, 0.5 * amount, 0.0))  # fmt: skip
        cylinders.append(c)
    real = replace(world.leg, cylinders=tuple(cylinders))
    muscles = [index for index, m in enumerate(real.muscles) if name in m.cylinders]
    return replace(world, paths=changed_paths(world, real, muscles=muscles))


_ATTACHMENTS = {
    "bflh": (0, (-0.6, 0.8, 0.0)),
    "semimem": (0, (-0.6, 0.8, 0.0)),
    "soleus": (-1, (-1.0, 0.3, 0.0)),
    "gasmed": (-1, (-1.0, 0.3, 0.0)),
    "tibant": (-2, (1.0, 0.2, 0.0)),
    "glmed1": (-1, (0.2, 0.1, 1.0)),
    "vaslat": (-1, (1.0, 0.2, 0.0)),
    "iliacus": (-1, (0.7, -0.7, 0.0)),
}


def _attachment(world: World, amount: float, variant: Variant) -> World:
    order, direction = _ATTACHMENTS[variant[0]]
    step = amount * np.array(direction) / np.linalg.norm(direction)
    index = world.leg.names.index(f"{variant[0]}_r")
    muscle = world.leg.muscles[index]
    points = list(muscle.points)
    body, place = points[order]
    x, y, z = np.array(place) + step
    points[order] = (body, (float(x), float(y), float(z)))
    muscles = list(world.leg.muscles)
    muscles[index] = replace(muscle, points=tuple(points))
    real = replace(world.leg, muscles=tuple(muscles))
    return replace(world, paths=changed_paths(world, real, muscles=[index]))


EFFECTS = (
    Effect(
        "cop_offset", "measurement", "m", 0.035, _center_of_pressure,
        "offset of the point of force that grows with load; inverse dynamics redone",
        "constant offset",
        variants=lambda w: (("anterior",), ("lateral",)), two_sided=True,
    ),
    Effect(
        "hip_center_offset", "measurement", "m", 0.035, _hip_center,
        "the real leg's hip is elsewhere: paths and inverse dynamics redone",
        "cross product of offset and force; derivatives of paths by the offset",
        variants=lambda w: (("anterior",), ("up",), ("lateral",)), two_sided=True,
    ),
    Effect(
        "joint_axis_rotation", "kinematics", "deg", 20.0, _axis,
        "the real leg's axis is turned about a slanted line: paths and inverse dynamics redone",
        "moments projected on an axis turned by either of two angles; derivatives of paths by these",
        variants=lambda w: (("knee",), ("ankle",), ("subtalar",)), two_sided=True,
    ),
    Effect(
        "force_latency", "measurement", "s", 0.030, _late,
        "ground forces late and behind a first-order filter; inverse dynamics redone",
        "first derivative of the moment",
        two_sided=True, parameters=lambda a, v: {"latency": a},
    ),
    Effect(
        "segment_inertia", "measurement", "share of mass", 0.6, _inertia,
        "mass, its centre and inertia change together, the last with the power 1.2; inverse dynamics redone",
        "derivatives by mass, centre and inertia",
        variants=lambda w: tuple((name,) for name in _SEGMENTS), two_sided=True,
        parameters=lambda a, v: {f"mass_fraction_{v[0]}": a},
    ),
    Effect(
        "crossed_plates", "measurement", "share of the other foot's force", 0.5, _crossed,
        "the other foot's three forces leak in while both stand; inverse dynamics redone",
        "moments of double support times (1 + theta)",
        two_sided=True,
    ),
    Effect(
        "foot_deformation", "kinematics", "deg", 16.0, _foot,
        "recorded ankle creeps with forefoot load, 60 ms late, saturating",
        "recorded ankle straight in vertical force, or in its moment on the forefoot",
        two_sided=True,
    ),
    Effect(
        "soft_tissue_artifact", "kinematics", "deg", 14.0, _soft_tissue,
        "tanh of knee flexion and a shock after heel strike, on hip rotation, knee and ankle",
        "a bell of phase, plus shares of the joint's own angle and a neighbour's",
        variants=lambda w: (("thigh",), ("shank",)), two_sided=True,
    ),
    Effect(
        "wrap_surface", "geometry", "share of radius, or 30 mm", 0.5, _wrap,
        "the real cylinder has another radius, or is displaced and turned at once; OpenSim wraps",
        "six parameters of a surrogate",
        variants=lambda w: (("hip_front", "radius"), ("knee_front", "radius"), ("knee_front", "place")),
        two_sided=True,
    ),
    Effect(
        "muscle_attachment", "geometry", "m", 0.020, _attachment,
        "the real point is shifted along the bone; OpenSim's path",
        "derivatives of the path by its end points",
        variants=lambda w: tuple((name,) for name in _ATTACHMENTS), two_sided=True,
    ),
)  # fmt: skip
