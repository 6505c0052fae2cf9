"""Simulated effects on muscle excitation and on recorded EMG."""

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
#: Channels with neighboring electrodes: (receiving, source).
_NEIGHBORS = (("Soleus", "Gastroc"), ("Gastroc", "Soleus"), ("TibAnt", "PerLong"), ("PerLong", "TibAnt"), ("RecFem", "VastLat"), ("VastMed", "RecFem"), ("BicFem", "SemiMem"), ("SemiMem", "Adductors"), ("GlutMax", "GlutMed"))  # fmt: skip
_BURST = {"tibpost": (42.0, 15.0), "tfl": (28.0, 16.0), "sart": (64.0, 11.0)}


def _channels(world: World) -> tuple[Variant, ...]:
    return tuple((name,) for name in ("Iliopsoas", "GlutMed", "VastLat", "Gastroc", "Soleus", "TibAnt"))


def _with_recorded_emg(world: World, change: Callable[[World, np.ndarray], np.ndarray]) -> World:
    return replace(world, recorded_emg=(*world.recorded_emg, change))


def _missing_drive(world: World, amount: float, variant: Variant) -> World:
    muscle = world.leg.names.index(f"{variant[0]}_r")
    center, width = _BURST[variant[0]]

    def excite(now: World, excitations: np.ndarray) -> np.ndarray:
        # A skewed burst with a fast rise and slow decay that grows with the square root of speed.
        away = (100.0 * (now.walk.phase % 1.0) - center + 50.0) % 100.0 - 50.0
        burst = np.exp(-0.5 * (away / np.where(away < 0.0, 1.3 * width, 0.7 * width)) ** 2)
        speed = np.sqrt(np.array(now.walk.speeds) / now.walk.speeds[1])
        # The amount is an activation: invert the activation nonlinearity of the muscle.
        grid = np.linspace(0.0, 1.5, 300)
        bent = now.family.shape(grid, now.muscles.bend[muscle])
        out = excitations.copy()
        out[:, muscle] += np.interp(amount * speed[:, None] * burst, bent, grid)
        return out

    return replace(world, excitation=(*world.excitation, excite))


def _spasticity(world: World, amount: float, variant: Variant) -> World:
    muscle = world.leg.names.index(f"{variant[0]}_r")

    def excite(now: World, excitations: np.ndarray) -> np.ndarray:
        # Muscle spindles: square root of stretch velocity, larger at long lengths, delayed by 40 ms and
        # smoothed.
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
    # By cadence, not by speed, and slightly larger in the shank; zero mean over the first two speeds.
    slow, fast = world.walk.speeds[0] ** -0.5, world.walk.speeds[1] ** -0.5
    place = (np.array(world.walk.speeds) ** -0.5 - 0.5 * (slow + fast)) / (slow - fast)
    shank = np.array([n.startswith(("soleus", "gas", "tib", "per")) for n in world.leg.names])
    late = amount * place[:, None] * np.where(shank, 1.1, 0.95)
    return with_muscles(world, delay=np.clip(world.muscles.delay + late, 0.0, 0.2))


def session_progress(world: World) -> np.ndarray:
    """Compute the elapsed share of the session, (recording, frame)."""
    count = len(world.walk.speeds)
    within = np.clip((world.walk.time - LEAD) / (DURATION - 2 * LEAD), 0.0, 1.0)
    return (np.arange(count)[:, None] + within) / count


def _drift(world: World, amount: float, variant: Variant) -> World:
    channel = _NAMES.index(variant[0])

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # Electrode gel settles, fast at first.
        gone = -np.expm1(-2.5 * session_progress(now)) / -np.expm1(-2.5)
        out = emg.copy()
        out[:, channel] *= 1.0 + amount * gone
        return out

    return _with_recorded_emg(world, change)


def _gain_change(amount: float, variant: Variant) -> dict[str, float]:
    """Compute the gain change from first to last cycle; at their centers 5.3 and 99.7 % have occurred."""
    return {f"gain_change_{variant[0]}": 0.944 * amount / (1.0 + 0.053 * amount)}


def _crosstalk(world: World, amount: float, variant: Variant) -> World:
    here, there = map(_NAMES.index, variant)

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # Signals of two uncorrelated sources: powers add, not envelopes.
        out = emg.copy()
        out[:, here] = np.hypot(emg[:, here], amount * emg[:, there])
        return out

    return _with_recorded_emg(world, change)


def _nonlinear(world: World, amount: float, variant: Variant) -> World:
    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # Saturation of an amplifier or of the motor pool: a logarithm, or its inverse.
        if abs(amount) < 1e-9:
            return emg
        steep = 6.0 * abs(amount)
        if amount > 0.0:
            return np.log1p(steep * emg) / np.log1p(steep)
        return np.expm1(emg * np.log1p(steep)) / steep

    return _with_recorded_emg(world, change)


_POSTURE = {"VastLat": 3, "Soleus": 4, "GlutMed": 1, "Gastroc": 3, "TibAnt": 4}


def _posture(world: World, amount: float, variant: Variant) -> World:
    channel, joint = _NAMES.index(variant[0]), _POSTURE[variant[0]]

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        angle = now.walk.angles[:, joint]
        middle, width = np.median(angle), np.ptp(angle) / 3.0
        out = emg.copy()
        out[:, channel] *= 1.0 + amount * np.tanh((angle - middle) / width)
        return out

    return _with_recorded_emg(world, change)


def _offset(world: World, amount: float, variant: Variant) -> World:
    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # A noise floor adds in power: it raises pauses and leaves peaks nearly unchanged.
        return np.hypot(emg, amount) if amount >= 0.0 else emg

    return _with_recorded_emg(world, change)


def _jitter(world: World, amount: float, variant: Variant) -> World:
    walk = world.walk
    rng = np.random.default_rng(20_11)  # which cycles are early is fixed; the amount is by how much

    def change(now: World, emg: np.ndarray) -> np.ndarray:
        # The EMG clock varies smoothly, not by a step for each cycle.
        cycle = RATE / (np.ptp(walk.phase[0]) / walk.time[-1])
        wander = amount / 100.0 * smooth_noise(rng_copy(rng), walk.phase.shape, 0.6 * cycle) * cycle / RATE
        return np.stack(
            [
                [np.interp(walk.time - shift, walk.time, row) for row in part]
                for shift, part in zip(wander, emg, strict=True)
            ]
        )

    return _with_recorded_emg(world, change)


def rng_copy(rng: np.random.Generator) -> np.random.Generator:
    copy = np.random.default_rng()
    copy.bit_generator.state = rng.bit_generator.state
    return copy


EFFECTS = (
    Effect(
        "missing_drive", "excitation", "peak activation", 0.9, _missing_drive,
        "skewed burst of one unrecorded muscle that grows with the square root of speed",
        "periodic splines times a power of speed",
        variants=lambda w: tuple((name,) for name in UNRECORDED),
        parameters=lambda a, v: {"peak_activation": a},
    ),
    Effect(
        "spasticity_unrecorded", "excitation", "gain", 1.6, _spasticity,
        "square root of stretch velocity above a threshold, larger at long lengths, delayed by 40 ms and smoothed",
        "linear in stretch velocity above a threshold, delayed",
        variants=lambda w: tuple((name,) for name in UNRECORDED), paretic_only=True,
    ),
    Effect(
        "speed_dependent_delay", "excitation", "s", 0.060, _delay,
        "delay in proportion to cycle time (inverse square root of speed), larger in the shank",
        "delay linear in speed",
        two_sided=True, parameters=lambda a, v: {"delay_slow_minus_fast": a},
    ),
    Effect(
        "emg_drift", "excitation", "share, first to last cycle", 1.2, _drift,
        "gain approaches its final value exponentially over the session",
        "gain linear in the number of the cycle",
        variants=_channels, parameters=_gain_change,
    ),
    Effect(
        "emg_crosstalk", "excitation", "share of the neighbour", 0.9, _crosstalk,
        "powers of neighboring channels add",
        "envelopes of neighboring channels are subtracted",
        variants=lambda w: _NEIGHBORS,
    ),
    Effect(
        "emg_nonlinearity", "excitation", "steepness / 6", 1.5, _nonlinear,
        "logarithm of the envelope, or its inverse",
        "power of excitation",
        two_sided=True,
    ),
    Effect(
        "posture_dependent_gain", "excitation", "share", 0.8, _posture,
        "gain of one channel changes with the tanh of a joint angle",
        "gain changes with the sine of a joint angle",
        variants=lambda w: tuple((name,) for name in _POSTURE), two_sided=True,
    ),
    Effect(
        "emg_offset", "excitation", "of full scale", 0.25, _offset,
        "noise floor added in power",
        "constant subtracted",
    ),
    Effect(
        "event_jitter", "kinematics", "% of the cycle", 4.0, _jitter,
        "clock of the EMG varies smoothly",
        "phase shift of each cycle",
    ),
)  # fmt: skip
