"""Muscle paths and inverse dynamics of a walk by OpenSim, interpolated to the fine time base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from validation.blind.anatomy import COORDINATES, Leg
from validation.blind.gait import RATE, Walk, derivative
from validation.blind.opensim_leg import crossed_coordinates, inverse_dynamics, muscle_paths
from validation.blind.world import Paths, World

#: Rates at which OpenSim computes paths, changes of paths, and joint moments, Hz.
PATH_RATE, CHANGE_RATE, MOMENT_RATE = 50.0, 25.0, 100.0


def _sample_frames(walk: Walk, rate: float) -> np.ndarray:
    step = int(RATE / rate)
    return np.unique(np.append(np.arange(0, walk.time.size, step), walk.time.size - 1))


def _path_samples(
    leg: Leg, angles: np.ndarray, muscles: Sequence[int] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute lengths and moment arms of all recordings at once: (recording, muscle, ..., frame)."""
    recordings = angles.shape[0]
    lengths, arms = muscle_paths(leg, np.concatenate(list(angles), axis=-1), muscles)
    return _split_recordings(lengths, recordings), _split_recordings(arms, recordings)


def _split_recordings(values: np.ndarray, recordings: int) -> np.ndarray:
    return np.stack(np.split(values, recordings, axis=-1))


def paths_along(leg: Leg, walk: Walk) -> Paths:
    """Compute the paths of all muscles along a walk."""
    at = _sample_frames(walk, PATH_RATE)
    lengths, arms = _path_samples(leg, walk.angles[..., at], None)
    fine = CubicSpline(walk.time[at], lengths, axis=-1)
    return Paths(fine(walk.time), fine(walk.time, 1), CubicSpline(walk.time[at], arms, axis=-1)(walk.time))


def changed_paths(
    world: World, leg: Leg, angles: np.ndarray | None = None, muscles: Sequence[int] | None = None
) -> Paths:
    """Compute paths for another leg or other angles by interpolating differences from the present paths."""
    walk = world.walk
    at = _sample_frames(walk, CHANGE_RATE)
    chosen = list(range(len(leg.muscles))) if muscles is None else list(muscles)
    # The coarse frames are among the frames at which the present paths were computed.
    before = (world.own_paths.length[:, chosen][..., at], world.own_paths.arms[:, chosen][..., at])
    after = _path_samples(leg, (walk.angles if angles is None else angles)[..., at], chosen)
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
    """Compute inverse dynamics of a walk, (recording, coordinate, frame) in N m on the fine time base."""
    pose = walk.pose if pose is None else pose
    ground = walk.ground if ground is None else ground
    at = _sample_frames(walk, MOMENT_RATE)
    rates, accelerations = derivative(pose, walk.time), derivative(pose, walk.time, 2)
    parts = [a[..., at] for a in (pose, rates, accelerations, ground)]
    moments = inverse_dynamics(leg, *(np.concatenate(list(part), axis=-1) for part in parts))
    coarse = _split_recordings(moments, pose.shape[0])
    # Linear interpolation: ground forces start and end with a kink.
    return np.stack([[np.interp(walk.time, walk.time[at], row) for row in recording] for recording in coarse])


def muscle_indices(leg: Leg, coordinate_words: Sequence[str]) -> list[int]:
    """Return the indices of muscles that cross coordinates with any of these words in their names."""
    wanted = {name for name in COORDINATES for word in coordinate_words if word in name}
    return [index for index, m in enumerate(leg.muscles) if wanted & set(crossed_coordinates(m))]
