"""Detectability of effects (d*) and ties, computed with the true parameters and the true noise covariance.

The signal of an effect is the difference between the recorded moments and a prediction without the effect
from the same recorded EMG and angles at the true parameters. The covariance contains everything that a
calibration can adjust, and everything that it cannot know: noise of moments and EMG, hidden geometry, curves
of other families.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from validation.blind.anatomy import COORDINATES
from validation.blind.effects.effect import Effect, Variant
from validation.blind.families import FAMILIES
from validation.blind.gait import LEAD
from validation.blind.geometry import changed_paths, muscle_indices
from validation.blind.noise import MOMENT_CORRELATION, MOMENT_SD
from validation.blind.world import World, joint_moments, moments_by_muscle, record, with_muscles
from validation.blind.worlds import GeometrySettings

# Tables are easier to read in one line.
# ruff: noqa: E501


PHASES = 25
#: Parameters that calibration adjusts: prior standard deviation, difference step, whether both are relative.
_ADJUSTED = {
    "scale": (0.6, 0.05, True),
    "delay": (0.025, 0.004, False),
    "rise": (0.4, 0.1, True),
    "bend": (0.25, 0.04, False),
    "optimal_fiber_length": (0.15, 0.01, True),
    "tendon_slack_length": (0.04, 0.002, True),
}
#: Standard deviations of hidden moment arm errors (m), and of the change to curves of another family.
_ARM_SD, _CURVE_SD = 0.0015, 1.0
#: Families whose curves and dynamics are uncertain; those of the test banks are reserved for these.
_OTHER_FAMILIES = ("thelen", "spline")
#: Unknown drive of an unrecorded channel: standard deviation, and smooth bumps over the cycle.
_DRIVE_SD, _BUMPS = 0.3, 10
#: Two effects are tied below this difference, in squared standard deviations.
TIE = 9.0


def cycles(world: World) -> list[list[tuple[float, float]]]:
    """Return start and end (s) of the cycles used of each recording, calibration before validation cycles.

    All cycles of the last recording are validation cycles.
    """
    walk, gait = world.walk, world.settings.gait
    used = []
    for recording in range(len(walk.speeds)):
        strikes = walk.strikes(recording)
        # Times are written with four decimals, so use rounded ones.
        strikes = np.round(strikes[strikes >= LEAD - 1e-6], 4)
        pairs = [(float(a), float(b)) for a, b in pairwise(strikes)]
        pairs = [pair for pair in pairs if pair[1] < walk.time[-1] - 0.3]
        used.append(pairs[: gait.calibration + gait.validation])
    return used


def at_cycles(world: World, values: np.ndarray, uses: list[list[tuple[float, float]]]) -> np.ndarray:
    """Sample (recording, row, frame) at the phases of cycles: (cycle, phase, row)."""
    out = []
    for recording, pairs in enumerate(uses):
        for start, end in pairs:
            times = np.linspace(start, end, PHASES, endpoint=False)
            index = np.clip(np.searchsorted(world.walk.time, times), 0, world.walk.time.size - 1)
            out.append(values[recording][:, index].T)
    return np.stack(out)


def calibration_cycles(world: World) -> list[list[tuple[float, float]]]:
    used, count = cycles(world), world.settings.gait.calibration
    return [*(pairs[:count] for pairs in used[:-1]), []]


def difference(world: World, effect: Effect, amount: float, variant: Variant) -> tuple[World, np.ndarray]:
    """Return the world with an effect, and the signal of the effect, (recording, coordinate, frame) in N m."""
    changed = effect.apply(world, amount, variant)
    return changed, signal(
        changed, effect.apply(world, 0.0, variant) if effect.id == "bound_pressure" else world
    )


def signal(changed: World, base: World) -> np.ndarray:
    """Subtract the base world's moments, at the recorded EMG and angles, from the recorded moments."""
    recorded = record(changed)
    # Effects on the recorded EMG of a channel that is not recorded have no influence.
    predicted = replace(base, drive=np.where(base.recorded[:, None], recorded.emg, base.drive))
    shift = sum(changed.recorded_pose, np.zeros_like(base.walk.pose))[:, 6:]
    moved = [name for name, row in zip(COORDINATES, np.abs(shift).max(axis=(0, 2)), strict=True) if row > 0.0]
    if moved:
        angles = base.walk.angles + shift
        predicted = replace(
            predicted, paths=changed_paths(base, base.leg, angles, muscle_indices(base.leg, moved))
        )
    return recorded.moments - joint_moments(predicted)


@dataclass(frozen=True)
class Oracle:
    """Inner products under the covariance of everything that is not an effect."""

    factor: tuple[np.ndarray, bool]

    def whiten(self, signals: np.ndarray) -> np.ndarray:
        """Multiply signals (sample, signal) by the inverse covariance."""
        return cho_solve(self.factor, signals)

    def gram(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return left.T @ self.whiten(right)


def flat(world: World, values: np.ndarray) -> np.ndarray:
    """Flatten the samples of the calibration cycles in the order cycle, phase, coordinate."""
    return at_cycles(world, values, calibration_cycles(world)).ravel()


def oracles(world: World, levels: tuple[float, ...]) -> dict[float, Oracle]:
    """Build an oracle for each level of EMG noise."""
    columns, gains = _nuisances(world)
    plain = columns @ columns.T
    noise = _moment_covariance(world)
    electrodes = _emg_covariance(world, gains)
    if world.settings.emg.baseline > 0.0:
        noise = noise + world.settings.emg.baseline**2 * _emg_covariance(world, _by_drive(world))
    ridge = 0.05**2 * np.eye(plain.shape[0])
    return {
        level: Oracle(cho_factor(plain + noise + level**2 * electrodes + ridge, lower=True))
        for level in levels
    }


def _nuisances(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Compute nuisance columns, (sample, column), and derivatives by log EMG gain, (sample, channel)."""
    base = moments_by_muscle(world)
    m = world.muscles
    columns, gains = [], np.zeros(0)
    for name, (prior, step, share) in _ADJUSTED.items():
        value = getattr(m, name)
        moved = value * (1.0 + step) if share else value + step
        change = (moments_by_muscle(with_muscles(world, **{name: moved})) - base) / step
        by_muscle = _by_muscle(world, change)
        columns.append(by_muscle * prior)
        if name == "scale":
            gains = np.stack(
                [by_muscle[:, world.channel == c].sum(1) for c in range(world.drive.shape[1])], 1
            )
    for name in _OTHER_FAMILIES:
        family = FAMILIES[name]
        if name != world.family.name:
            other = moments_by_muscle(replace(world, curves=family.curves())) - base
            columns.append(_by_muscle(world, other) * _CURVE_SD)
            twitch = replace(world, family=family)
            columns.append(_by_muscle(world, moments_by_muscle(twitch) - base) * _CURVE_SD)
    columns.append(_arm_errors(world, base))
    if not world.recorded.all():
        columns.append(_unknown_drive(world))
    nuisances = np.concatenate(columns, axis=1)
    return nuisances[:, np.abs(nuisances).max(0) > 1e-9], gains


def _by_muscle(world: World, change: np.ndarray) -> np.ndarray:
    return np.stack([flat(world, change[:, muscle]) for muscle in range(change.shape[1])], axis=1)


def _by_drive(world: World) -> np.ndarray:
    """Compute derivatives by an addition to the drive of each channel, (sample, channel)."""
    step = 0.05
    more = moments_by_muscle(replace(world, drive=world.drive + step)) - moments_by_muscle(world)
    by_muscle = _by_muscle(world, more / step)
    return np.stack([by_muscle[:, world.channel == c].sum(1) for c in range(world.drive.shape[1])], 1)


def _unknown_drive(world: World) -> np.ndarray:
    """Compute columns of the unknown drive of unrecorded channels, by phase and separately for each recording."""
    counts = [len(pairs) for pairs in calibration_cycles(world)]
    center = np.arange(_BUMPS) / _BUMPS
    away = (np.arange(PHASES)[:, None] / PHASES - center + 0.5) % 1.0 - 0.5
    bumps = np.repeat(np.exp(-0.5 * (away * _BUMPS) ** 2), len(COORDINATES), axis=0)
    columns = []
    for unit in _by_drive(world)[:, ~world.recorded].T:
        for recording in range(len(counts) - 1):
            within = np.repeat(np.arange(len(counts)) == recording, counts).astype(float)
            columns.append(_DRIVE_SD * unit[:, None] * np.kron(within[:, None], bumps))
    return np.concatenate(columns, axis=1)


def _arm_errors(world: World, moments: np.ndarray) -> np.ndarray:
    columns = []
    arms, usual, own = world.paths.arms, GeometrySettings(), world.settings.geometry
    sd = _ARM_SD * max(own.points / usual.points, own.radius / usual.radius)
    crossed = np.abs(arms).max(axis=(0, 3)) > 1e-4
    strength = np.linalg.norm(moments, axis=2) / np.maximum(np.linalg.norm(arms, axis=2), 1e-3)
    for muscle, coordinate in np.argwhere(crossed):
        column = np.zeros_like(world.inverse)
        column[:, coordinate] = strength[:, muscle] * sd
        columns.append(flat(world, column))
    return np.stack(columns, axis=1)


def _correlation(width: float) -> np.ndarray:
    steps = np.arange(PHASES)
    return np.exp(-0.25 * ((steps[:, None] - steps[None]) / (PHASES * width)) ** 2)


def _moment_covariance(world: World) -> np.ndarray:
    settings = world.settings.moments
    sd = settings.noise * MOMENT_SD * world.leg.mass / 72.0
    block = np.kron(_correlation(settings.phase), MOMENT_CORRELATION * np.outer(sd, sd))
    count = sum(map(len, calibration_cycles(world)))
    return np.kron(np.eye(count), block)


def _emg_covariance(world: World, gains: np.ndarray) -> np.ndarray:
    used = [pair for pairs in calibration_cycles(world) for pair in pairs]
    size = PHASES * len(COORDINATES)
    out = np.zeros((size * len(used), size * len(used)))
    for order, (start, end) in enumerate(used):
        # Wider than the EMG noise: activation dynamics smooth it.
        near = np.kron(
            _correlation(1.5 * world.settings.emg.time / (end - start)), np.ones((len(COORDINATES),) * 2)
        )
        part = slice(order * size, (order + 1) * size)
        own = gains[part]
        out[part, part] = (own @ own.T) * near
    return out
