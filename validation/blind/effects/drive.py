"""What drives the muscles, and what the electrodes make of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from validation.blind.anatomy import CHANNELS, UNRECORDED
from validation.blind.effects.effect import Effect, Variant
from validation.blind.gait import DURATION, LEAD, RATE, smooth_noise
from validation.blind.world import World, with_muscles

# Tables are easier to read in one line.
# ruff: noqa: E501


_NAMES = tuple(CHANNELS)
#: Electrodes near each other: what one picks up of another.
_NEIGHBOURS = (("Soleus", "Gastroc"), ("Gastroc", "Soleus"), ("TibAnt", "PerLong"), ("PerLong", "TibAnt"), ("RecFem", "VastLat"), ("VastMed", "RecFem"), ("BicFem", "SemiMem"), ("SemiMem", "Adductors"), ("GlutMax", "GlutMed"))  # fmt: skip
_BURST = {"tibpost": (42.0, 15.0), "tfl": (28.0, 16.0), "sart": (64.0, 11.0)}


def _channels(world: World) -> tuple[Variant, ...]:
    return tuple((name,) for name in ("Iliopsoas", "GlutMed", "VastLat", "Gastroc", "Soleus", "TibAnt"))


def _recorded(world: World, change: Callable[[World, np.ndarray], np.ndarray]) -> World:
    return replace(world, recorded_emg=(*world.recorded_emg, change))


def _missing(world: World, amount: float, variant: Variant) -> World:
    muscle = world.leg.names.index(f"{variant[0]}_r")
    center, width = _BURST[variant[0]]

    def excite(now: World, excitations: np.ndarray) -> np.ndarray:
        # A skewed burst, quick up and slow down, that grows with the root of speed.
        away = (100.0 * (now.walk.phase % 1.0) - center + 50.0) % 100.0 - 50.0
        burst = np.exp(-0.5 * (away / np.where(away < 0.0, 1.3 * width, 0.7 * width)) ** 2)
        speed = np.sqrt(np.array(now.walk.speeds) / now.walk.speeds[1])
        # The amount is activation: undo what the muscle's bend will make of the excitation.
        grid = np.linspace(0.0, 1.5, 300)
        bent = now.family.shape(grid, now.muscles.bend[muscle])
        out = excitations.copy()
        out[:, muscle] += np.interp(amount * speed[:, None] * burst, bent, grid)
        return out

    return replace(world, excitation=(*world.excitation, excite))


def _spastic(world: World, amount: float, variant: Variant) -> World:
    muscle = world.leg.names.index(f"{variant[0]}_r")

    def excite(now: World, excitations: np.ndarray) -> np.ndarray:
        # Muscle spindles: a root of stretch velocity, more at long lengths, 40 ms late, smeared.
        fiber = now.muscles.optimal_fiber_length[muscle]
        velocity = now.paths.rate[:, muscle] / fiber
        long = (now.paths.length[:, muscle] - now.paths.length[:, muscle].mean(-1, keepdims=True)) / fiber
        afferent = np.sqrt(np.maximum(velocity - 0.08, 0.0)) * (1.0 + 2.0 * long)
        late = np.roll(afferent, int(0.040 * RATE), axis=-1)
        out = excitations.copy()
        out[:, muscle] += amount * gaussian_filter1d(np.maximum(late, 0.0), 0.012 * RATE, axis=-1)
        return out

    return replace(world, excitation=(*world.excitation, excite))


def _delay(world: World, amount: float, variant: Variant) -> World:
    # By cadence, not by speed, and a little more in the shank: zero on average over the first two speeds.
    slow, fast = world.walk.speeds[0] ** -0.5, world.walk.speeds[1] ** -0.5
    place = (np.array(world.walk.speeds) ** -0.5 - 0.5 * (slow + fast)) / (slow - fast)
    shank = np.array([n.startswith(("soleus", "gas", "tib", "per")) for n in world.leg.names])
    late = amount * place[:, None] * np.where(shank, 1.1, 0.95)
    return with_muscles(world, delay=np.clip(world.muscles.delay + late, 0.0, 0.2))


def progress(world: World) -> np.ndarray:
    """Share of the session that has passed, (recording, frame)."""
    count = len(world.walk.speeds)
    within = np.clip((world.walk.time - LEAD) / (DURATION - 2 * LEAD), 0.0, 1.0)
    return (np.arange(count)[:, None] + within) / count


def _drift(world: World, amount: float, variant: Variant) -> World:
    channel = _NAMES.index(variant[0])

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # A gel that settles: fast at first.
        gone = -np.expm1(-2.5 * progress(now)) / -np.expm1(-2.5)
        out = emg.copy()
        out[:, channel] *= 1.0 + amount * gone
        return out

    return _recorded(world, change)


def _drift_seen(amount: float, variant: Variant) -> dict[str, float]:
    """Last cycle's gain against the first one's: at their middles 5.3 and 99.7 % of the drift are there."""
    return {f"gain_change_{variant[0]}": 0.944 * amount / (1.0 + 0.053 * amount)}


def _crosstalk(world: World, amount: float, variant: Variant) -> World:
    here, there = map(_NAMES.index, variant)

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # Interference of two noises: powers add, not envelopes.
        out = emg.copy()
        out[:, here] = np.hypot(emg[:, here], amount * emg[:, there])
        return out

    return _recorded(world, change)


def _nonlinear(world: World, amount: float, variant: Variant) -> World:
    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # An amplifier or a motor pool that saturates: a logarithm, or its inverse.
        if abs(amount) < 1e-9:
            return emg
        steep = 6.0 * abs(amount)
        if amount > 0.0:
            return np.log1p(steep * emg) / np.log1p(steep)
        return np.expm1(emg * np.log1p(steep)) / steep

    return _recorded(world, change)


_POSTURE = {"VastLat": 3, "Soleus": 4, "GlutMed": 1, "Gastroc": 3, "TibAnt": 4}


def _posture(world: World, amount: float, variant: Variant) -> World:
    channel, joint = _NAMES.index(variant[0]), _POSTURE[variant[0]]

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        angle = now.walk.angles[:, joint]
        middle, width = np.median(angle), np.ptp(angle) / 3.0
        out = emg.copy()
        out[:, channel] *= 1.0 + amount * np.tanh((angle - middle) / width)
        return out

    return _recorded(world, change)


def _offset(world: World, amount: float, variant: Variant) -> World:
    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # A noise floor adds in power: it fills the pauses and leaves the peaks.
        return np.hypot(emg, amount) if amount >= 0.0 else emg

    return _recorded(world, change)


def _jitter(world: World, amount: float, variant: Variant) -> World:
    walk = world.walk
    rng = np.random.default_rng(20_11)  # which cycles are early is fixed; by how much is the amount

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # The EMG's clock stumbles: packets come late by a smooth wander, not by a step a cycle.
        cycle = RATE / (np.ptp(walk.phase[0]) / walk.time[-1])
        wander = amount / 100.0 * smooth_noise(rng_copy(rng), walk.phase.shape, 0.6 * cycle) * cycle / RATE
        return np.stack(
            [
                [np.interp(walk.time - shift, walk.time, row) for row in part]
                for shift, part in zip(wander, emg, strict=True)
            ]
        )

    return _recorded(world, change)


def rng_copy(rng: np.random.Generator) -> np.random.Generator:
    copy = np.random.default_rng()
    copy.bit_generator.state = rng.bit_generator.state
    return copy


EFFECTS = (
    Effect(
        "missing_drive", "excitation", "peak activation", 0.9, _missing,
        "a skewed burst on one unrecorded muscle that grows with the root of speed",
        "periodic splines times a power of speed",
        variants=lambda w: tuple((name,) for name in UNRECORDED),
        parameters=lambda a, v: {"peak_activation": a},
    ),
    Effect(
        "spasticity_unrecorded", "excitation", "gain", 1.6, _spastic,
        "root of stretch velocity over a threshold, more at long lengths, 40 ms late and smeared",
        "straight ramp of stretch velocity over a threshold, late",
        variants=lambda w: tuple((name,) for name in UNRECORDED), paretic_only=True,
    ),
    Effect(
        "speed_dependent_delay", "excitation", "s", 0.060, _delay,
        "delay follows cadence (inverse root of speed), more in the shank",
        "delay straight in speed",
        two_sided=True, parameters=lambda a, v: {"delay_slow_minus_fast": a},
    ),
    Effect(
        "emg_drift", "excitation", "share, first to last cycle", 1.2, _drift,
        "gain settles exponentially over the session",
        "gain straight in the cycle's number",
        variants=_channels, parameters=_drift_seen,
    ),
    Effect(
        "emg_crosstalk", "excitation", "share of the neighbour", 0.9, _crosstalk,
        "powers of neighbours add",
        "envelopes of neighbours subtract",
        variants=lambda w: _NEIGHBOURS,
    ),
    Effect(
        "emg_nonlinearity", "excitation", "steepness / 6", 1.5, _nonlinear,
        "logarithm of the envelope, or its inverse",
        "a power of excitation",
        two_sided=True,
    ),
    Effect(
        "posture_dependent_gain", "excitation", "share", 0.8, _posture,
        "gain by the tanh of a joint's angle on one channel",
        "gain by the sine of an angle",
        variants=lambda w: tuple((name,) for name in _POSTURE), two_sided=True,
    ),
    Effect(
        "emg_offset", "excitation", "of full scale", 0.25, _offset,
        "noise floor added in power",
        "a constant subtracted",
    ),
    Effect(
        "event_jitter", "kinematics", "% of the cycle", 4.0, _jitter,
        "the EMG's clock wanders smoothly",
        "a shift of phase for each cycle",
    ),
)  # fmt: skip
