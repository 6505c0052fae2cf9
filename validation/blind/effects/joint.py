"""Moments at joints that no muscle makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from validation.blind.effects.effect import Effect, Variant
from validation.blind.gait import RATE, derivative
from validation.blind.world import World

HIP, ADDUCTION, ROTATION, KNEE, ANKLE, SUBTALAR = range(6)


def _added(world: World, torque: Callable[[World], np.ndarray]) -> World:
    return replace(world, torque=(*world.torque, torque))


def _empty(world: World) -> np.ndarray:
    return np.zeros_like(world.walk.angles)


def soft(value: np.ndarray, width: float) -> np.ndarray:
    """A ramp whose corner is this wide."""
    return width * np.logaddexp(0.0, value / width)


def _passive(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # Ligament springs that engage over 8 degrees and then stiffen with the square of stretch.
        q, out = now.walk.angles, _empty(now)
        hip, knee, ankle = q[:, HIP], q[:, KNEE], q[:, ANKLE]
        if variant[0] == "hip":
            stretch = soft(-0.02 - hip + 0.10 * knee, 0.14)
            out[:, HIP] += amount * (stretch / 0.25) ** 2
        elif variant[0] == "ankle":
            stretch = soft(ankle - 0.02 - 0.12 * knee, 0.10)
            out[:, ANKLE] -= amount * (stretch / 0.20) ** 2
        else:
            stretch = soft(0.22 - knee + 0.15 * hip, 0.12)
            out[:, KNEE] += amount * (stretch / 0.25) ** 2
        return out

    return _added(world, torque)


def _damping(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        speed = derivative(now.walk.angles, now.walk.time)
        share = np.array([1.0, 0.8, 0.3, 0.45, 0.25, 0.1])[None, :, None]
        # Tissue thins when sheared: a power below one, rounded at rest.
        return -amount * share * speed * (0.09 + speed**2) ** -0.1

    return _added(world, torque)


def _strap(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        q, out = now.walk.angles, _empty(now)
        front = variant[0] == "front"
        arms = (0.042, -0.040) if front else (-0.062, 0.035)
        # A strap that goes slack: shorter as its arms say, force only when stretched.
        length = -arms[0] * q[:, HIP] - arms[1] * q[:, KNEE]
        slack = np.percentile(length, 35)
        tension = 1000.0 * amount * soft(length - slack, 0.006)
        out[:, HIP] += arms[0] * tension
        out[:, KNEE] += arms[1] * tension
        return out

    return _added(world, torque)


def _orthosis(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # A shell: bends into dorsiflexion with the stiffness asked for, into plantarflexion with half of it,
        # stiffens with the cube, and lags behind itself when it unbends.
        ankle = np.degrees(now.walk.angles[:, ANKLE]) - 1.0
        lag = np.exp(-1.0 / (0.05 * RATE))
        late = lfilter([1.0 - lag], [1.0, -lag], ankle, axis=-1, zi=lag * ankle[:, :1])[0]
        bent = 0.9 * ankle + 0.1 * late
        stiff = amount * (0.75 + 0.25 * np.tanh(bent / 3.0))
        out = _empty(now)
        out[:, ANKLE] -= stiff * bent * (1.0 + (bent / 40.0) ** 2)
        return out

    return _added(world, torque)


def _wobble(world: World, amount: float, variant: Variant) -> World:
    def torque(now: World) -> np.ndarray:
        # Soft masses swing after the heel strikes: a damped 8 Hz oscillator driven by the load's rise.
        load = now.walk.ground[:, 1] / (9.80665 * now.leg.mass)
        rise = derivative(load, now.walk.time)
        step, omega, loss = 1.0 / RATE, 2 * np.pi * 8.0, 0.25
        radius = np.exp(-loss * omega * step)
        poles = [1.0, -2 * radius * np.cos(omega * np.sqrt(1 - loss**2) * step), radius**2]
        swing = lfilter([step * omega], poles, rise, axis=-1) * step * omega
        out = _empty(now)
        out[:, HIP] -= amount * swing * 0.6
        out[:, ADDUCTION] -= amount * swing * 0.25
        out[:, KNEE] -= amount * swing * 0.35
        return out

    return _added(world, torque)


EFFECTS = (
    Effect(
        "passive_joint_moment", "joint", "N m at 11 to 14 degrees", 45.0, _passive,
        "square of a soft ramp of stretch, whose start moves with the neighbouring joint",
        "double exponential with coupling",
        variants=lambda w: (("hip",), ("ankle",), ("knee",)),
    ),
    Effect(
        "joint_damping", "joint", "N m s/rad at the hip", 8.0, _damping,
        "velocity to the power 0.8, rounded, shares fixed over the joints",
        "straight in velocity, a number a joint",
    ),
    Effect(
        "biarticular_spring", "joint", "N/mm", 25.0, _strap,
        "a strap with arms at hip and knee that goes slack",
        "straight spring on the sum of both angles",
        variants=lambda w: (("front",), ("back",)),
    ),
    Effect(
        "ankle_foot_orthosis", "joint", "N m/deg", 4.0, _orthosis,
        "shell with half the stiffness into plantarflexion, a cubic and a lag",
        "straight spring, bilinear, with offset",
        parameters=lambda a, v: {"dorsiflexion_stiffness": a},
    ),
    Effect(
        "wobbling_mass", "measurement", "N m scale", 20.0, _wobble,
        "damped 8 Hz oscillator driven by the load's rise",
        "a pulse in phase",
    ),
)  # fmt: skip
