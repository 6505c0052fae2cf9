"""Simulated effects on fibers, tendons and activation dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from validation.blind.effects.effect import Effect, Variant
from validation.blind.world import World, with_muscles

# Tables are easier to read in one line.
# ruff: noqa: E501


def _indices(world: World, words: tuple[str, ...]) -> np.ndarray:
    return np.array([any(name.startswith(word) for word in words) for name in world.leg.names])


def _tendon(world: World, amount: float, variant: Variant) -> World:
    if amount < 5e-4:
        return world  # too stiff to integrate, and not detectable
    long = world.muscles.tendon_slack_length > 1.2 * world.muscles.optimal_fiber_length
    return with_muscles(world, strain=np.where(long, amount, 0.0))


def _slow_fibers(world: World, amount: float, variant: Variant) -> World:
    # Larger in the shank: real changes are not uniform over muscles.
    shank = _indices(world, ("soleus", "gas", "tib", "per"))
    return with_muscles(world, slowness=np.clip(amount * np.where(shank, 1.1, 0.95), -1.0, 0.85))


def _length_gain(world: World, amount: float, variant: Variant) -> World:
    return with_muscles(world, length_gain=np.full_like(world.muscles.length_gain, amount))


def _enhancement(world: World, amount: float, variant: Variant) -> World:
    return with_muscles(world, enhancement=np.full_like(world.muscles.enhancement, amount))


def _force_sharing(world: World, amount: float, variant: Variant) -> World:
    names = list(world.leg.names)
    giver = names.index("soleus_r")
    takers = [names.index("gasmed_r"), names.index("gaslat_r")]

    def share(now: World, forces: np.ndarray) -> np.ndarray:
        # Fascia transmits more where the muscles slide on each other, at the flexed knee.
        knee = now.walk.angles[:, 3]
        passed = amount * (0.6 + 0.8 * np.clip(knee / 1.0, 0.0, 1.0)) * forces[:, giver]
        out = forces.copy()
        out[:, giver] -= passed
        for taker, part in zip(takers, (0.65, 0.35), strict=True):
            out[:, taker] += part * passed
        return out

    return replace(world, force=(*world.force, share))


_CONTRACTED = {
    "plantarflexors": ("soleus", "gas"),
    "hamstrings": ("semimem", "bflh"),
    "rectus": ("recfem",),
}


def _contracture(world: World, amount: float, variant: Variant) -> World:
    chosen = _indices(world, _CONTRACTED[variant[0]])
    return with_muscles(world, tightness=np.where(chosen, amount, 0.0))


def _slow_deactivation(world: World, amount: float, variant: Variant) -> World:
    # Relaxation is slower in distal than in proximal muscles.
    shank = _indices(world, ("soleus", "gas", "tib", "per"))
    return with_muscles(world, fall=world.muscles.fall * np.exp(amount * np.where(shank, 1.15, 0.9)))


def _bound(world: World, amount: float, variant: Variant) -> World:
    """Move a parameter of one muscle beyond the bounds of calibration: delay > 125 ms, or fiber > 1.4 of nominal."""
    kind, word = variant
    chosen = _indices(world, (word,))
    if kind == "delay":
        delay = np.where(chosen, 0.125 + 0.2 * amount, world.muscles.delay)
        return with_muscles(world, delay=delay)
    m = world.muscles
    fiber = np.where(chosen, m.optimal_fiber_length * (1.4 + amount), m.optimal_fiber_length)
    middle = world.paths.length.mean(axis=(0, 2))
    slack = np.where(
        chosen, np.maximum(middle - 0.98 * fiber * np.cos(m.pennation), 0.005), m.tendon_slack_length
    )
    return with_muscles(world, optimal_fiber_length=fiber, tendon_slack_length=slack)


EFFECTS = (
    Effect(
        "tendon_compliance", "tendon", "strain at maximum force", 0.10, _tendon,
        "damped fiber in series with an exponential, then linear tendon, integrated in time; tendons longer than 1.2 fibers",
        "slack length increased by a logarithm of force",
        parameters=lambda a, v: {"strain_at_max_force": a},
    ),
    Effect(
        "slow_fibers", "fiber", "share of maximum velocity lost", 0.75, _slow_fibers,
        "maximum velocity reduced by a share that differs between shank and thigh, and a more curved hyperbola",
        "maximum velocity times exp(-theta)",
        parameters=lambda a, v: {"max_velocity_factor": 1.0 - a},
    ),
    Effect(
        "activation_dependent_fiber_length", "fiber", "share of fiber length at rest", 0.35, _length_gain,
        "optimal length decreases exponentially with activation",
        "optimal length decreases linearly with activation",
        parameters=lambda a, v: {"length_gain": a},
    ),
    Effect(
        "force_enhancement", "fiber", "share of force", 0.45, _enhancement,
        "tanh of leaky-integrated stretch of active fibers minus half a tanh of leaky-integrated shortening",
        "linear in the leaky integral of stretch",
    ),
    Effect(
        "force_sharing", "tendon", "share of soleus force", 0.5, _force_sharing,
        "soleus force passed to both gastrocnemii, more with the knee flexed",
        "fixed share of a neighboring muscle's force added",
    ),
    Effect(
        "contracture", "fiber", "share of passive fiber length", 0.15, _contracture,
        "passive fibers shortened by a share and stiffened, in one of three muscle groups",
        "passive curve shifted",
        variants=lambda w: tuple((name,) for name in _CONTRACTED), paretic_only=True,
    ),
    Effect(
        "deactivation_asymmetry", "activation", "log of relaxation time", 1.2, _slow_deactivation,
        "relaxation slowed by an exponential that differs between shank and thigh, in the simulator's two-stage dynamics",
        "deactivation time of first-order dynamics times (1 + theta)",
        two_sided=True,
    ),
    Effect(
        "bound_pressure", "fiber", "beyond the box (share of nominal, or 0.2 s)", 0.35, _bound,
        "true delay of one muscle above 125 ms, or true fiber length above 1.4 of nominal",
        "active bound of a parameter relaxed",
        variants=lambda w: (("fiber", "soleus"), ("fiber", "vaslat"), ("fiber", "recfem"), ("delay", "soleus"), ("delay", "iliacus")),
    ),
)  # fmt: skip
