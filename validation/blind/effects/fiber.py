"""Fibers and tendons."""

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
        return world  # too stiff to integrate, and not to be seen
    long = world.muscles.tendon_slack_length > 1.2 * world.muscles.optimal_fiber_length
    return with_muscles(world, strain=np.where(long, amount, 0.0))


def _slow(world: World, amount: float, variant: Variant) -> World:
    # Thick muscles of the shank are slower still: nobody slows all muscles alike.
    shank = _indices(world, ("soleus", "gas", "tib", "per"))
    return with_muscles(world, slowness=np.clip(amount * np.where(shank, 1.1, 0.95), -1.0, 0.85))


def _longer(world: World, amount: float, variant: Variant) -> World:
    return with_muscles(world, length_gain=np.full_like(world.muscles.length_gain, amount))


def _enhanced(world: World, amount: float, variant: Variant) -> World:
    return with_muscles(world, enhancement=np.full_like(world.muscles.enhancement, amount))


def _shared(world: World, amount: float, variant: Variant) -> World:
    names = list(world.leg.names)
    giver = names.index("soleus_r")
    takers = [names.index("gasmed_r"), names.index("gaslat_r")]

    def share(now: World, forces: np.ndarray) -> np.ndarray:
        # Fascia hands over more where the two slide on each other: the flexed knee.
        knee = now.walk.angles[:, 3]
        passed = amount * (0.6 + 0.8 * np.clip(knee / 1.0, 0.0, 1.0)) * forces[:, giver]
        out = forces.copy()
        out[:, giver] -= passed
        for taker, part in zip(takers, (0.65, 0.35), strict=True):
            out[:, taker] += part * passed
        return out

    return replace(world, force=(*world.force, share))


_TIGHT = {
    "plantarflexors": ("soleus", "gas"),
    "hamstrings": ("semimem", "bflh"),
    "rectus": ("recfem",),
}


def _tight(world: World, amount: float, variant: Variant) -> World:
    chosen = _indices(world, _TIGHT[variant[0]])
    return with_muscles(world, tightness=np.where(chosen, amount, 0.0))


def _asymmetric(world: World, amount: float, variant: Variant) -> World:
    # Slow relaxation lives in the distal muscles more than in the proximal ones.
    shank = _indices(world, ("soleus", "gas", "tib", "per"))
    return with_muscles(world, fall=world.muscles.fall * np.exp(amount * np.where(shank, 1.15, 0.9)))


def _bound(world: World, amount: float, variant: Variant) -> World:
    """One muscle that no box of calibration holds: a delay past 125 ms, a fiber past 1.4 of its nominal."""
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
        "damped fiber behind an exponential-then-straight tendon, integrated in time; tendons longer than 1.2 fibers",
        "slack length stretched by a logarithm of force",
        parameters=lambda a, v: {"strain_at_max_force": a},
    ),
    Effect(
        "slow_fibers", "fiber", "share of maximum velocity lost", 0.75, _slow,
        "maximum velocity less by a share that differs between shank and thigh, and a deeper hyperbola",
        "maximum velocity times exp(-theta)",
        parameters=lambda a, v: {"max_velocity_factor": 1.0 - a},
    ),
    Effect(
        "activation_dependent_fiber_length", "fiber", "share of fiber length at rest", 0.35, _longer,
        "optimal length falls with activation as an exponential",
        "optimal length falls with activation as a straight line",
        parameters=lambda a, v: {"length_gain": a},
    ),
    Effect(
        "force_enhancement", "fiber", "share of force", 0.45, _enhanced,
        "tanh of leaky stretch of active fibers, less half a tanh of leaky shortening",
        "leaky integral of stretch, straight",
    ),
    Effect(
        "force_sharing", "tendon", "share of soleus force", 0.5, _shared,
        "soleus hands force to both gastrocnemii, more with the knee flexed, and loses it",
        "a fixed share of a neighbour's force is added",
    ),
    Effect(
        "contracture", "fiber", "share of passive fiber length", 0.15, _tight,
        "passive fibers shorter by a share and stiffer, in one of three groups",
        "passive curve shifted",
        variants=lambda w: tuple((name,) for name in _TIGHT), paretic_only=True,
    ),
    Effect(
        "deactivation_asymmetry", "activation", "log of relaxation time", 1.2, _asymmetric,
        "relaxation slower by an exponential that differs between shank and thigh, in the generator's two-stage dynamics",
        "deactivation time of first-order dynamics times (1 + theta)",
        two_sided=True,
    ),
    Effect(
        "bound_pressure", "fiber", "beyond the box (share of nominal, or 0.2 s)", 0.35, _bound,
        "one muscle's true delay over 125 ms or true fiber over 1.4 of its nominal",
        "the active bound of a parameter relaxed",
        variants=lambda w: (("fiber", "soleus"), ("fiber", "vaslat"), ("fiber", "recfem"), ("delay", "soleus"), ("delay", "iliacus")),
    ),
)  # fmt: skip
