"""Simulated joint moments other than those of muscles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from validation.blind.effects.effect import Effect, Variant
from validation.blind.gait import RATE, derivative
from validation.blind.world import World

HIP, ADDUCTION, ROTATION, KNEE, ANKLE, SUBTALAR = range(6)


def _with_torque(world: World, torque: Callable[[World], np.ndarray]) -> World:
    return replace(world, torque=(*world.torque, torque))


def _zeros(world: World) -> np.ndarray:
    return np.zeros_like(world.walk.angles)


def smooth_ramp(value: np.ndarray, width: float) -> np.ndarray:
    """Compute a ramp with a smooth corner of a given width."""
    return width * np.logaddexp(0.0, value / width)


def _passive(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # Ligaments that engage over 8 degrees and then stiffen with the square of stretch.
        q, out = now.walk.angles, _zeros(now)
        hip, knee, ankle = q[:, HIP], q[:, KNEE], q[:, ANKLE]
        if variant[0] == "hip":
            stretch = smooth_ramp(-0.02 - hip + 0.10 * knee, 0.14)
            out[:, HIP] += amount * (stretch / 0.25) ** 2
        elif variant[0] == "ankle":
            stretch = smooth_ramp(ankle - 0.02 - 0.12 * knee, 0.10)
            out[:, ANKLE] -= amount * (stretch / 0.20) ** 2
        else:
            stretch = smooth_ramp(0.22 - knee + 0.15 * hip, 0.12)
            out[:, KNEE] += amount * (stretch / 0.25) ** 2
        return out

    return _with_torque(world, torque)


def _damping(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        speed = derivative(now.walk.angles, now.walk.time)
        share = np.array([1.0, 0.8, 0.3, 0.45, 0.25, 0.1])[None, :, None]
        # Shear-thinning tissue: a power below one, smoothed at rest.
        return -amount * share * speed * (0.09 + speed**2) ** -0.1

    return _with_torque(world, torque)


def _strap(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        q, out = now.walk.angles, _zeros(now)
        front = variant[0] == "front"
        arms = (0.042, -0.040) if front else (-0.062, 0.035)
        # An elastic strap with constant moment arms that carries tension only when stretched.
        length = -arms[0] * q[:, HIP] - arms[1] * q[:, KNEE]
        slack = np.percentile(length, 35)
        tension = 1000.0 * amount * smooth_ramp(length - slack, 0.006)
        out[:, HIP] += arms[0] * tension
        out[:, KNEE] += arms[1] * tension
        return out

    return _with_torque(world, torque)


def _orthosis(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # A shell with the given stiffness in dorsiflexion and half of it in plantarflexion, cubic stiffening,
        # and a lag.
        ankle = np.degrees(now.walk.angles[:, ANKLE]) - 1.0
        lag = np.exp(-1.0 / (0.05 * RATE))
        late = lfilter([1.0 - lag], [1.0, -lag], ankle, axis=-1, zi=lag * ankle[:, :1])[0]
        bent = 0.9 * ankle + 0.1 * late
        stiff = amount * (0.75 + 0.25 * np.tanh(bent / 3.0))
        out = _zeros(now)
        out[:, ANKLE] -= stiff * bent * (1.0 + (bent / 40.0) ** 2)
        return out

    return _with_torque(world, torque)


def _wobble(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # Soft tissue oscillates after heel strike: a damped 8 Hz oscillator driven by the rate of loading.
        load = now.walk.ground[:, 1] / (9.80665 * now.leg.mass)
        rise = derivative(load, now.walk.time)
        step, omega, loss = 1.0 / RATE, 2 * np.pi * 8.0, 0.25
        radius = np.exp(-loss * omega * step)
        poles = [1.0, -2 * radius * np.cos(omega * np.sqrt(1 - loss**2) * step), radius**2]
        swing = lfilter([step * omega], poles, rise, axis=-1) * step * omega
        out = _zeros(now)
        out[:, HIP] -= amount * swing * 0.6
        out[:, ADDUCTION] -= amount * swing * 0.25
        out[:, KNEE] -= amount * swing * 0.35
        return out

    return _with_torque(world, torque)


EFFECTS = (
    Effect(
        "passive_joint_moment", "joint", "N m at 11 to 14 degrees", 45.0, _passive,
        "square of a smooth ramp of stretch whose onset depends on the neighboring joint",
        "double exponential with coupling",
        variants=lambda w: (("hip",), ("ankle",), ("knee",)),
    ),
    Effect(
        "joint_damping", "joint", "N m s/rad at the hip", 8.0, _damping,
        "power 0.8 of velocity, smoothed at zero, with fixed ratios between joints",
        "linear in velocity, one coefficient for each joint",
    ),
    Effect(
        "biarticular_spring", "joint", "N/mm", 25.0, _strap,
        "elastic strap with moment arms at hip and knee that can go slack",
        "linear spring on the sum of both angles",
        variants=lambda w: (("front",), ("back",)),
    ),
    Effect(
        "ankle_foot_orthosis", "joint", "N m/deg", 4.0, _orthosis,
        "shell with half the stiffness in plantarflexion, cubic stiffening and a lag",
        "linear or bilinear spring with offset",
        parameters=lambda a, v: {"dorsiflexion_stiffness": a},
    ),
    Effect(
        "wobbling_mass", "measurement", "N m scale", 20.0, _wobble,
        "damped 8 Hz oscillator driven by the rate of loading",
        "pulse in gait phase",
    ),
)  # fmt: skip
