"""Muscle paths along a walk, from OpenSim, on the fine time base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from validation.blind.anatomy import COORDINATES, Leg
from validation.blind.gait import RATE, Walk, derivative
from validation.blind.opensim_leg import crossed_coordinates, inverse_dynamics, muscle_paths
from validation.blind.world import Paths, World

#: OpenSim is asked so often a second: for paths, for their changes, and for joint moments.
PATH_RATE, CHANGE_RATE, MOMENT_RATE = 50.0, 25.0, 100.0


def _every(walk: Walk, rate: float) -> np.ndarray:
    step = int(RATE / rate)
    return np.unique(np.append(np.arange(0, walk.time.size, step), walk.time.size - 1))


def _asked(leg: Leg, angles: np.ndarray, muscles: Sequence[int] | None) -> tuple[np.ndarray, np.ndarray]:
    """Ask for all recordings in one go: (recording, muscle, ...frame)."""
    recordings = angles.shape[0]
    lengths, arms = muscle_paths(leg, np.concatenate(list(angles), axis=-1), muscles)
    return _apart(lengths, recordings), _apart(arms, recordings)


def _apart(values: np.ndarray, recordings: int) -> np.ndarray:
    return np.stack(np.split(values, recordings, axis=-1))


def paths_along(leg: Leg, walk: Walk) -> Paths:
    """Paths of all muscles along a walk."""
    at = _every(walk, PATH_RATE)
    lengths, arms = _asked(leg, walk.angles[..., at], None)
    fine = CubicSpline(walk.time[at], lengths, axis=-1)
    return Paths(fine(walk.time), fine(walk.time, 1), CubicSpline(walk.time[at], arms, axis=-1)(walk.time))


def changed_paths(
    world: World, leg: Leg, angles: np.ndarray | None = None, muscles: Sequence[int] | None = None
) -> Paths:
    """Paths on another leg, or at other angles, of these muscles; OpenSim is asked for differences."""
    walk = world.walk
    at = _every(walk, CHANGE_RATE)
    chosen = list(range(len(leg.muscles))) if muscles is None else list(muscles)
    # The coarse frames are frames of the paths: OpenSim has been asked there.
    before = (world.own_paths.length[:, chosen][..., at], world.own_paths.arms[:, chosen][..., at])
    after = _asked(leg, (walk.angles if angles is None else angles)[..., at], chosen)
    length, arms = (
        CubicSpline(walk.time[at], b - a, axis=-1)(walk.time) for a, b in zip(before, after, strict=True)
    )
    paths = world.paths
    new = Paths(paths.length.copy(), paths.rate.copy(), paths.arms.copy())
    new.length[:, chosen] += length
    new.rate[:, chosen] += derivative(length, walk.time)
    new.arms[:, chosen] += arms
    return new


def ground_moments(
    leg: Leg, walk: Walk, pose: np.ndarray | None = None, ground: np.ndarray | None = None
) -> np.ndarray:
    """Inverse dynamics of a walk, (recording, coordinate, frame) on the fine time base."""
    pose = walk.pose if pose is None else pose
    ground = walk.ground if ground is None else ground
    at = _every(walk, MOMENT_RATE)
    rates, accelerations = derivative(pose, walk.time), derivative(pose, walk.time, 2)
    parts = [a[..., at] for a in (pose, rates, accelerations, ground)]
    found = inverse_dynamics(leg, *(np.concatenate(list(part), axis=-1) for part in parts))
    coarse = _apart(found, pose.shape[0])
    # Linear between the frames: ground forces start and end with a corner.
    return np.stack([[np.interp(walk.time, walk.time[at], row) for row in recording] for recording in coarse])


def muscle_indices(leg: Leg, coordinate_words: Sequence[str]) -> list[int]:
    """Muscles that cross any of these coordinates."""
    wanted = {name for name in COORDINATES for word in coordinate_words if word in name}
    return [index for index, m in enumerate(leg.muscles) if wanted & set(crossed_coordinates(m))]
