"""Simulated errors of model geometry, of kinematics and of inverse dynamics.

The change of the joint moments is the difference between OpenSim's inverse dynamics with wrong and with true
inputs.
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


def with_wrong_ground(world: World, ground: np.ndarray) -> World:
    """Record wrong ground forces, and use them for inverse dynamics."""
    change = ground_moments(world.leg, world.walk, ground=ground) - world.inverse
    wrong = ground - world.walk.ground
    return replace(
        world,
        recorded_moments=(*world.recorded_moments, change),
        recorded_ground=(*world.recorded_ground, lambda now, recorded: recorded + wrong),
    )


def _with_leg(world: World, real: Leg, coordinates: tuple[str, ...]) -> World:
    """Let the true leg differ from the one that inverse dynamics uses."""
    change = world.inverse - ground_moments(real, world.walk)
    world = replace(world, recorded_moments=(*world.recorded_moments, change))
    if not coordinates:
        return world
    paths = changed_paths(world, real, muscles=muscle_indices(real, coordinates))
    return replace(world, paths=paths)


def _with_pose(world: World, shift: np.ndarray) -> World:
    """Record wrong angles; muscle paths follow the true ones."""
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
    # The force plate bends: the offset grows slightly with load.
    off = amount * (0.85 + 0.2 * load) * (ground[:, 1] > 20.0)
    ground[:, 3] += off * direction[0]
    ground[:, 5] += off * direction[1]
    return with_wrong_ground(world, ground)


def _crossed_plates(world: World, amount: float, variant: Variant) -> World:
    ground, other = world.walk.ground.copy(), world.walk.other_ground
    both = (ground[:, 1] > 20.0) & (other[:, 1] > 20.0)
    window = gaussian_filter1d(both.astype(float), 0.015 * RATE, axis=-1)
    # A share of the other foot's force acts on this plate, at this foot's center of pressure.
    ground[:, :3] += amount * window[:, None] * other[:, :3] * (ground[:, 1:2] > 20.0)
    return with_wrong_ground(world, ground)


def _latency(world: World, amount: float, variant: Variant) -> World:
    time = world.walk.time
    ground = world.walk.ground.copy()
    # Without load the center of pressure is undefined: use that of the nearest loaded frame, so that
    # interpolation does not average with zeros.
    ground[:, 3:6] = _fill_unloaded_points(ground[:, 3:6], ground[:, 1:2])
    # A fifth of the latency is that of a first-order filter, the rest a pure delay.
    plain, filtered = 0.8 * amount, 0.2 * abs(amount)
    ground = np.array([[np.interp(time - plain, time, row) for row in recording] for recording in ground])
    if filtered > 0.0:
        keep = np.exp(-1.0 / (filtered * RATE))
        smooth = lfilter([1.0 - keep], [1.0, -keep], ground[:, :3], axis=-1)
        ground[:, :3] = smooth if amount > 0.0 else 2.0 * ground[:, :3] - smooth
    ground[:, 3:6] = np.where(np.abs(ground[:, 1:2]) > 1e-9, ground[:, 3:6], 0.0)
    return with_wrong_ground(world, ground)


def _fill_unloaded_points(points: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Replace points without load by those of the nearest loaded frame."""
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
    # Field names chosen at run time cannot be type-checked.
    changed: dict[str, Any] = {field: tuple(map(float, turned))}
    real = replace(world.leg, **changed)
    return _with_leg(world, real, (name,))


_SEGMENTS = {"thigh": "femur_r", "shank": "tibia_r", "foot": "calcn_r"}


def _inertia(world: World, amount: float, variant: Variant) -> World:
    name = _SEGMENTS[variant[0]]
    bodies = []
    for body in world.leg.bodies:
        if body.name == name:
            # The difference in mass is distal, so the mass center moves with it.
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
    # Markers move with skin that slides with knee flexion and vibrates after heel strike.
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
    # The midfoot creeps: forefoot load, a lag of 60 ms, saturation.
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
                # Displaced forward and up, and turned in proportion.
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
        "offset of the center of pressure that grows with load; inverse dynamics repeated",
        "constant offset",
        variants=lambda w: (("anterior",), ("lateral",)), two_sided=True,
    ),
    Effect(
        "hip_center_offset", "measurement", "m", 0.035, _hip_center,
        "hip center of the true leg displaced; paths and inverse dynamics repeated",
        "cross product of offset and force; derivatives of the paths with respect to the offset",
        variants=lambda w: (("anterior",), ("up",), ("lateral",)), two_sided=True,
    ),
    Effect(
        "joint_axis_rotation", "kinematics", "deg", 20.0, _axis,
        "joint axis of the true leg rotated about an oblique line; paths and inverse dynamics repeated",
        "moments projected on an axis rotated by two angles; derivatives of the paths with respect to these",
        variants=lambda w: (("knee",), ("ankle",), ("subtalar",)), two_sided=True,
    ),
    Effect(
        "force_latency", "measurement", "s", 0.030, _latency,
        "ground forces delayed and filtered by a first-order filter; inverse dynamics repeated",
        "first time derivative of the moment",
        two_sided=True, parameters=lambda a, v: {"latency": a},
    ),
    Effect(
        "segment_inertia", "measurement", "share of mass", 0.6, _inertia,
        "mass, mass center and inertia (power 1.2 of mass) change together; inverse dynamics repeated",
        "derivatives with respect to mass, mass center and inertia",
        variants=lambda w: tuple((name,) for name in _SEGMENTS), two_sided=True,
        parameters=lambda a, v: {f"mass_fraction_{v[0]}": a},
    ),
    Effect(
        "crossed_plates", "measurement", "share of the other foot's force", 0.5, _crossed_plates,
        "a share of the other foot's force added in double support; inverse dynamics repeated",
        "moments in double support times (1 + theta)",
        two_sided=True,
    ),
    Effect(
        "foot_deformation", "kinematics", "deg", 16.0, _foot,
        "recorded ankle angle changes with forefoot load, lagging by 60 ms, saturating",
        "recorded ankle angle linear in the vertical force or in its moment on the forefoot",
        two_sided=True,
    ),
    Effect(
        "soft_tissue_artifact", "kinematics", "deg", 14.0, _soft_tissue,
        "tanh of knee flexion plus a vibration after heel strike, on hip rotation, knee and ankle",
        "Gaussian in gait phase plus shares of the joint's own angle and of a neighboring one",
        variants=lambda w: (("thigh",), ("shank",)), two_sided=True,
    ),
    Effect(
        "wrap_surface", "geometry", "share of radius, or 30 mm", 0.5, _wrap,
        "true cylinder with another radius, or displaced and rotated; OpenSim's path",
        "six wrap parameters of a surrogate",
        variants=lambda w: (("hip_front", "radius"), ("knee_front", "radius"), ("knee_front", "place")),
        two_sided=True,
    ),
    Effect(
        "muscle_attachment", "geometry", "m", 0.020, _attachment,
        "true attachment point displaced on the bone; OpenSim's path",
        "derivatives of the path with respect to its end points",
        variants=lambda w: tuple((name,) for name in _ATTACHMENTS), two_sided=True,
    ),
)  # fmt: skip
