"""Deviations in all recordings of a person that are no cause of a case.

These are defects of the laboratory, displaced joint centers, and unmodelled moments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from validation.blind.anatomy import CHANNELS
from validation.blind.gait import LEAD
from validation.blind.geometry import ground_moments
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import Person
from validation.blind.world import World, joint_moments
from validation.blind.worlds import BackgroundSettings

#: Mechanisms outside the catalogue that act at the same time in unmodelled moments, with their amounts.
_MECHANISMS = tuple(
    (OUTSIDE[name], amount)
    for name, amount in (
        ("joint_friction", 6.0),
        ("size_principle", 0.4),
        ("patella_tracking", 0.3),
        ("catch_like_force", 0.4),
    )
)
_PHASES, _HARMONICS = 100, 5


@dataclass(frozen=True)
class Background:
    """Additions to the recorded moments (N m) and envelopes, on the fine time base."""

    moments: np.ndarray
    emg: np.ndarray


def background_of(who: Person, seed: tuple[int, ...]) -> Background | None:
    """Compute the background of a person, None if their world has none; the same seed gives the same."""
    world = who.world
    settings = world.settings.background
    if settings == BackgroundSettings() and world.settings.geometry.centers == 0.0:
        return None
    moments, emg = np.zeros_like(world.inverse), np.zeros_like(world.drive)
    if world.settings.geometry.centers > 0.0:
        # Inverse dynamics uses the nominal joint centers.
        moments += ground_moments(who.nominal, world.walk) - world.inverse
    if settings.emg_baseline is not None:
        channel, recording, amount = settings.emg_baseline
        emg[recording, list(CHANNELS).index(channel)] += amount
    if settings.unmodelled is not None:
        moments += _unmodelled_moments(world, settings.unmodelled, np.random.default_rng(seed))
    return Background(moments, emg)


def with_background(world: World, background: Background | None) -> World:
    """Add a background to the recordings of a world."""
    if background is None:
        return world
    return replace(
        world,
        recorded_moments=(*world.recorded_moments, background.moments),
        recorded_emg=(*world.recorded_emg, lambda now, emg: emg + background.emg),
    )


def _unmodelled_moments(world: World, limits: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Draw moments that depend only on phase and speed: mechanisms plus a random smooth function of phase."""
    changed = world
    for mechanism, amount in _MECHANISMS:
        changed = mechanism.apply(changed, amount, ())
    mechanisms = _repeated(world, joint_moments(changed) - joint_moments(world))
    count = world.inverse.shape[1]
    weight = rng.standard_normal((2, count, _HARMONICS)) / np.arange(1, _HARMONICS + 1) ** 0.7
    angle = 2.0 * np.pi * world.walk.phase[:, None, :, None] * np.arange(1, _HARMONICS + 1)
    drawn = np.einsum("rjfh,kh->rkf", np.sin(angle), weight[0])
    drawn += np.einsum("rjfh,kh->rkf", np.cos(angle), weight[1])
    drawn *= np.sqrt(np.array(world.walk.speeds) / world.walk.speeds[1])[:, None, None]
    rest = mechanisms / _rms(mechanisms) + drawn / _rms(drawn)
    target = rng.uniform(*limits, size=(1, count, 1))
    return rest / _rms(rest) * target


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=(0, 2), keepdims=True)) + 1e-9


def _repeated(world: World, values: np.ndarray) -> np.ndarray:
    """Replace every cycle by the smooth mean over the cycles of its recording."""
    used = world.walk.time > LEAD
    grid = (np.arange(_PHASES) + 0.5) / _PHASES
    out = np.empty_like(values)
    for recording, phase in enumerate(world.walk.phase % 1.0):
        bins = np.minimum((phase[used] * _PHASES).astype(int), _PHASES - 1)
        times = np.bincount(bins, minlength=_PHASES)
        for row in range(values.shape[1]):
            sums = np.bincount(bins, values[recording, row, used], minlength=_PHASES)
            mean = gaussian_filter1d(sums / times, 2.5, mode="wrap")
            out[recording, row] = np.interp(phase, grid, mean, period=1.0)
    return out
