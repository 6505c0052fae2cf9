"""World of a simulated person (leg, walk, muscles, effects), and the noise-free recordings of it.

An effect is a function that returns another world with other muscles, other geometry, or a change at one of
the stages below. Effects can be combined. Axes: recording, (muscle, channel or coordinate), frame of the fine
time base.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from validation.blind.anatomy import CHANNELS, Leg
from validation.blind.families import Curves, Family, activate
from validation.blind.gait import RATE, Walk
from validation.blind.muscles import Muscles, muscle_forces
from validation.blind.worlds import WorldSettings, default_world

Change = Callable[["World", np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Paths:
    """Muscle paths: lengths (m), their rates (m/s) and moment arms (m)."""

    length: np.ndarray  # (recording, muscle, frame)
    rate: np.ndarray
    arms: np.ndarray  # (recording, muscle, coordinate, frame)


@dataclass(frozen=True)
class World:
    """True state of a person and a walk, with the changes by effects at every stage."""

    leg: Leg  # the true leg
    walk: Walk
    family: Family
    curves: Curves
    muscles: Muscles
    paths: Paths  # of the muscles
    own_paths: Paths  # of ``leg``, before any change by effects
    channel: np.ndarray  # (muscle,): channel that drives it, -1 for none
    drive: np.ndarray  # (recording, channel, frame): true envelopes, about 1 at their peak
    inverse: np.ndarray  # moments by inverse dynamics of walk and ground, (recording, coordinate, frame)
    paretic: bool = False
    excitation: tuple[Change, ...] = ()  # change excitations (recording, muscle, frame)
    force: tuple[Change, ...] = ()  # change muscle forces
    torque: tuple[Callable[[World], np.ndarray], ...] = ()  # add joint moments
    recorded_emg: tuple[Change, ...] = ()  # change the recorded envelopes
    recorded_pose: tuple[np.ndarray, ...] = ()  # added to the recorded pose
    recorded_moments: tuple[np.ndarray, ...] = ()  # added to the moments by wrong inverse dynamics
    recorded_ground: tuple[Change, ...] = ()  # change the recorded ground forces
    settings: WorldSettings = field(default_factory=lambda: default_world("millard"))

    @property
    def recorded(self) -> np.ndarray:
        """Whether each channel is recorded."""
        return np.array([name not in self.settings.emg.unrecorded for name in CHANNELS])


@dataclass(frozen=True)
class Recording:
    """Recordings without noise."""

    moments: np.ndarray
    emg: np.ndarray
    pose: np.ndarray
    ground: np.ndarray


def excitations(world: World) -> np.ndarray:
    """Compute scaled and delayed envelopes, 0 for muscles without a channel."""
    time, muscles = world.walk.time, world.muscles
    out = np.zeros((world.drive.shape[0], world.channel.size, time.size))
    for recording in range(out.shape[0]):
        for muscle, channel in enumerate(world.channel):
            if channel >= 0:
                late = np.interp(
                    time - muscles.delay[recording, muscle], time, world.drive[recording, channel]
                )
                out[recording, muscle] = muscles.scale[muscle] * late
    for change in world.excitation:
        out = change(world, out)
    return np.clip(out, 0.0, 1.5)


def activations(world: World) -> np.ndarray:
    m = world.muscles
    raw = activate(world.family, excitations(world), m.rise[None], m.fall[None], 1.0 / RATE)
    return world.family.shape(np.clip(raw, 0.0, 1.5), m.bend[None, :, None])


def forces(world: World) -> np.ndarray:
    paths = world.paths
    out = muscle_forces(world.curves, world.muscles, activations(world), paths.length, paths.rate, 1.0 / RATE)
    for change in world.force:
        out = change(world, out)
    return out


def moments_by_muscle(world: World) -> np.ndarray:
    """Compute the moment of each muscle, (recording, muscle, coordinate, frame) in N m."""
    return world.paths.arms * forces(world)[:, :, None, :]


def joint_moments(world: World) -> np.ndarray:
    """Compute the true joint moments, (recording, coordinate, frame) in N m."""
    total = np.einsum("rmkf,rmf->rkf", world.paths.arms, forces(world))
    for add in world.torque:
        total = total + add(world)
    return total


def record(world: World) -> Recording:
    """Record a world without noise."""
    emg, ground = world.drive, world.walk.ground
    for change in world.recorded_emg:
        emg = change(world, emg)
    for change in world.recorded_ground:
        ground = change(world, ground)
    return Recording(
        joint_moments(world) + sum(world.recorded_moments, np.zeros_like(world.inverse)),
        np.maximum(emg, 0.0),
        world.walk.pose + sum(world.recorded_pose, np.zeros_like(world.walk.pose)),
        ground,
    )


def with_muscles(world: World, **changes: np.ndarray) -> World:
    return replace(world, muscles=replace(world.muscles, **changes))
