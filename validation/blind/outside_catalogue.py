"""Simulated mechanisms outside the catalogue, for which the correct answer is `unknown`.

The first seven are similar to the catalogue entry in their comment.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from validation.blind.anatomy import CHANNELS
from validation.blind.effects.chain import with_wrong_ground
from validation.blind.effects.drive import session_progress
from validation.blind.effects.effect import Effect, Variant
from validation.blind.effects.joint import ANKLE, KNEE
from validation.blind.gait import DURATION, LEAD, RATE, derivative
from validation.blind.geometry import ground_moments
from validation.blind.world import World, activations, with_muscles

# Tables are easier to read in one line.
# ruff: noqa: E501


def _torque(world, torque):
    return replace(world, torque=(*world.torque, torque))


def _friction(world: World, amount: float, variant: Variant) -> World:  # joint_damping
    def torque(now: World) -> np.ndarray:
        speed = derivative(now.walk.angles, now.walk.time)
        return -amount * np.array([1.0, 0.4, 0.2, 0.7, 0.4, 0.1])[None, :, None] * np.tanh(speed / 0.6)

    return _torque(world, torque)


def _boot(world: World, amount: float, variant: Variant) -> World:  # ankle_foot_orthosis
    def torque(now: World) -> np.ndarray:
        # A stiff boot: the collar always resists, the sole under load only.
        load = now.walk.ground[:, 1] / (9.80665 * now.leg.mass)
        out = np.zeros_like(now.walk.angles)
        out[:, ANKLE] = -amount * np.degrees(now.walk.angles[:, ANKLE]) * (0.35 + np.tanh(3.0 * load))
        return out

    return _torque(world, torque)


def _recruited(world: World, amount: float, variant: Variant) -> World:  # slow_fibers
    return with_muscles(world, recruitment=np.full_like(world.muscles.recruitment, amount))


def _yaw(world: World, amount: float, variant: Variant) -> World:  # joint_axis_rotation
    angle = np.radians(amount)
    ground = world.walk.ground.copy()
    for row in (0, 6):
        x, z = ground[:, row].copy(), ground[:, row + 2].copy()
        ground[:, row] = np.cos(angle) * x + np.sin(angle) * z
        ground[:, row + 2] = -np.sin(angle) * x + np.cos(angle) * z
    return with_wrong_ground(world, ground)


def _potentiated(world: World, amount: float, variant: Variant) -> World:  # emg_drift
    chosen = world.channel == list(CHANNELS).index(variant[0])

    def force(now: World, forces: np.ndarray) -> np.ndarray:
        # Force at a given drive grows with use; half of it is lost in the rest between recordings.
        out = forces.copy()
        within = np.clip((now.walk.time - LEAD) / (DURATION - 2 * LEAD), 0.0, 1.0)
        out[:, chosen] *= 1.0 + amount * 0.5 * (within + session_progress(now)[:, None])
        return out

    return replace(world, force=(*world.force, force))


def _patella(world: World, amount: float, variant: Variant) -> World:  # wrap_surface, muscle_attachment
    chosen = [i for i, m in enumerate(world.leg.muscles) if "knee_front" in m.cylinders]
    knee = world.walk.angles[:, 3]
    paths = replace(world.paths, arms=world.paths.arms.copy())
    shape = 1.0 + amount * np.sin(2.2 * (knee - 0.35))
    for muscle in chosen:
        paths.arms[:, muscle, KNEE] *= shape
    return replace(world, paths=paths)


def _dystonia(world: World, amount: float, variant: Variant) -> World:  # missing_drive
    muscle = world.leg.names.index(f"{variant[0]}_r")

    def excite(now: World, excitations: np.ndarray) -> np.ndarray:
        out = excitations.copy()
        out[:, muscle] += amount
        return out

    return replace(world, excitation=(*world.excitation, excite))


def _breathing(world: World, amount: float, variant: Variant) -> World:
    def change(now: World, emg: np.ndarray) -> np.ndarray:
        wave = np.sin(2 * np.pi * 0.23 * now.walk.time + np.arange(emg.shape[0])[:, None])
        return emg * (1.0 + amount * wave[:, None])

    return replace(world, recorded_emg=(*world.recorded_emg, change))


def _dropouts(world: World, amount: float, variant: Variant) -> World:
    channel = list(CHANNELS).index(variant[0])

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # Every few cycles the electrode loses contact for a quarter of a cycle.
        out, phase = emg.copy(), now.walk.phase
        lost = ((phase % 2.7) < 0.25).astype(float)
        out[:, channel] *= 1.0 - amount * gaussian_filter1d(lost, 0.02 * RATE, axis=-1)
        return out

    return replace(world, recorded_emg=(*world.recorded_emg, change))


def _plate_gain(world: World, amount: float, variant: Variant) -> World:
    ground = world.walk.ground.copy()
    ground[:, 1] *= 1.0 + amount
    return with_wrong_ground(world, ground)


def _tilted(world: World, amount: float, variant: Variant) -> World:
    # The laboratory's vertical axis is tilted: recorded poses are tilted forward, forces are not.
    shift = np.zeros_like(world.walk.pose)
    shift[:, 0] = np.radians(amount)
    change = ground_moments(world.leg, world.walk, pose=world.walk.pose + shift) - world.inverse
    return replace(
        world,
        recorded_pose=(*world.recorded_pose, shift),
        recorded_moments=(*world.recorded_moments, change),
    )


def _catch(world: World, amount: float, variant: Variant) -> World:
    def force(now: World, forces: np.ndarray) -> np.ndarray:
        # Doublets: more force at a given drive while activation rises.
        rising = np.maximum(derivative(activations(now), now.walk.time), 0.0)
        return forces * (1.0 + amount * np.tanh(rising / 2.0))

    return replace(world, force=(*world.force, force))


def _channels(*names):
    return lambda world: tuple((name,) for name in names)


def _mechanism(name, unit, most, apply, form, **options):
    return Effect(name, "outside", unit, most, apply, form, "-", **options)


OUTSIDE: dict[str, Effect] = {
    effect.id: effect
    for effect in (
        _mechanism("joint_friction", "N m", 15.0, _friction, "friction that saturates with velocity"),
        _mechanism("stiff_boot", "N m/deg", 4.0, _boot, "stiff boot, stiffer under load"),
        _mechanism("size_principle", "share", 0.85, _recruited, "weakly driven fibers are slower"),
        _mechanism("plate_yaw", "deg", 25.0, _yaw, "ground force rotated about the vertical", two_sided=True),
        _mechanism("potentiation", "share", 1.6, _potentiated, "force at constant EMG grows with use", variants=_channels("Soleus", "VastLat", "GlutMed")),
        _mechanism("patella_tracking", "share", 0.6, _patella, "moment arms of the knee extensors change with knee angle", two_sided=True),
        _mechanism("dystonia", "activation", 0.7, _dystonia, "constant drive of an unrecorded muscle", variants=_channels("tibpost", "tfl")),
        _mechanism("breathing_gain", "share", 0.8, _breathing, "gains of all channels oscillate at 0.23 Hz"),
        _mechanism("electrode_dropout", "share", 0.95, _dropouts, "intermittent loss of one channel", variants=_channels("Soleus", "VastLat", "GlutMed", "Gastroc")),
        _mechanism("plate_gain", "share", 0.3, _plate_gain, "vertical force scaled", two_sided=True),
        _mechanism("tilted_laboratory", "deg", 8.0, _tilted, "vertical axis of the laboratory tilted", two_sided=True),
        _mechanism("catch_like_force", "share", 0.9, _catch, "more force while activation rises"),
    )
}  # fmt: skip
