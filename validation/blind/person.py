"""Simulated person: nominal and true leg, walk, muscle parameters and muscle drive."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from validation.blind.anatomy import CHANNELS, Leg, channel_of, reference_leg
from validation.blind.families import FALL_TO_RISE, FAMILIES, Family
from validation.blind.gait import RATE, Walk, lowpass, simulate_walk, smooth_noise
from validation.blind.geometry import ground_moments, paths_along
from validation.blind.muscles import Muscles, muscle_forces
from validation.blind.opensim_leg import muscle_paths
from validation.blind.world import Paths, World
from validation.blind.worlds import GeometrySettings, PersonSettings, WorldSettings

# Tables are easier to read in one line.
# ruff: noqa: E501


#: Mean normalized fiber length in walking, if not 0.95.
_FIBER = {"vasmed": 0.85, "vaslat": 0.85, "glmax1": 1.0, "glmax2": 1.0, "bflh": 1.0, "semimem": 1.0, "tibant": 0.9, "iliacus": 1.0, "psoas": 1.0, "recfem": 0.9}  # fmt: skip

# EMG bursts similar to Perry 2010 and Winter 1991: center and width in % of the cycle, activation.
_BURSTS = {
    "Iliopsoas": [(58, 9, 0.22)],
    "RecFem": [(5, 5, 0.10), (58, 6, 0.12)],
    "GlutMax": [(6, 7, 0.25), (96, 4, 0.15)],
    "GlutMed": [(8, 8, 0.35), (30, 12, 0.20)],
    "Adductors": [(6, 6, 0.08), (62, 7, 0.12), (95, 6, 0.08)],
    "BicFem": [(94, 6, 0.22), (4, 5, 0.10)],
    "SemiMem": [(93, 6, 0.22), (4, 4, 0.08)],
    "VastMed": [(7, 7, 0.22), (97, 3, 0.08)],
    "VastLat": [(7, 7, 0.22), (97, 3, 0.08)],
    "Gastroc": [(41, 9, 0.30)],
    "Soleus": [(38, 12, 0.30)],
    "TibAnt": [(4, 5, 0.25), (66, 8, 0.16), (92, 7, 0.16)],
    "PerLong": [(44, 10, 0.22)],
}
#: Tolerances of the drive: tracking of each joint moment (N m), and deviation from the bursts.
_TRACKING = np.array([4.0, 6.0, 8.0, 4.0, 4.0, 8.0])
_STRAY = 0.12


@dataclass(frozen=True)
class Person:
    """Simulated person with nominal leg and true world."""

    name: str
    paretic: bool
    nominal: Leg  # of the model file
    world: World  # the truth


def draw_person(
    name: str,
    seed: tuple[int, ...],
    settings: WorldSettings,
    paretic: bool = False,
    session: tuple[int, ...] | None = None,
) -> Person:
    """Draw a person and their walk; the same seed gives the same person.

    With a seed of a session, the person walks once more: other cycles by the same habits, at the same speeds,
    with the same muscles and units of EMG.
    """
    rng = np.random.default_rng(seed)
    mass, height = rng.uniform(58, 92), rng.uniform(1.58, 1.86)
    family, gait = FAMILIES[settings.family], settings.gait
    nominal = reference_leg(float(mass), float(height))
    true = _with_hidden_errors(nominal, rng, settings.geometry)
    speeds = gait.speeds[int(rng.integers(len(gait.speeds)))]
    before = copy.deepcopy(rng)
    walked = simulate_walk(true, rng, speeds, gait)
    paths = paths_along(true, walked)
    nominal = _with_slack(nominal, walked)
    muscles = _muscles(true, paths, rng, settings.person)
    target = ground_moments(true, walked)
    ratio = muscles.scale
    drive, peaks = _drive(walked, family, paths, muscles, target, bursts(walked, gait.bursts), rng)
    channel = channel_of(true.names)
    muscles = replace(muscles, scale=_scale(peaks, channel, ratio))
    if session is not None:
        again = np.random.default_rng(session)
        walked = simulate_walk(true, before, speeds, gait, cycles=again)
        paths, target = paths_along(true, walked), ground_moments(true, walked)
        unscaled = replace(muscles, scale=ratio)
        other, others_peaks = _drive(
            walked, family, paths, unscaled, target, bursts(walked, gait.bursts), again
        )
        drive = other * (others_peaks / peaks)[None, :, None]
    curves = family.curves()
    world = World(
        true,
        walked,
        family,
        curves,
        muscles,
        paths,
        paths,
        channel,
        drive,
        target,
        paretic,
        settings=settings,
    )
    return Person(name, paretic, nominal, world)


def _with_hidden_errors(leg: Leg, rng: np.random.Generator, settings: GeometrySettings) -> Leg:
    """Add errors of geometry: by default points by a millimeter or two, cylinders by a few percent."""

    def moved(point):
        body, place = point
        x, y, z = np.array(place) + settings.points * rng.standard_normal(3)
        return body, (float(x), float(y), float(z))

    muscles = tuple(replace(m, points=tuple(map(moved, m.points))) for m in leg.muscles)
    cylinders = tuple(
        replace(
            c,
            radius=float(c.radius * (1 + settings.radius * rng.standard_normal())),
            translation=moved((c.body, c.translation))[1],
        )
        for c in leg.cylinders
    )
    leg = replace(leg, muscles=muscles, cylinders=cylinders)
    return _with_displaced_centers(leg, rng, settings.centers) if settings.centers > 0.0 else leg


def _with_displaced_centers(leg: Leg, rng: np.random.Generator, distance: float) -> Leg:
    """Displace the hip center in any direction, the knee and ankle centers along their segments."""
    direction = rng.standard_normal(3)
    x, y, z = map(float, np.array(leg.hip_center) + distance * direction / np.linalg.norm(direction))
    thigh, shank = (distance * rng.choice((-1.0, 1.0), 2)).tolist()
    return replace(leg, hip_center=(x, y, z), thigh=leg.thigh + thigh, shank=leg.shank + shank)


def _target_fiber(leg: Leg) -> np.ndarray:
    return np.array([_FIBER.get(name.removesuffix("_r"), 0.95) for name in leg.names])


def _with_slack(leg: Leg, walked: Walk) -> Leg:
    """Set tendon slack lengths so that fibers have their target lengths in walking."""
    lengths, _ = muscle_paths(leg, walked.angles[0][:, :: int(RATE / 5)])
    slack = lengths.mean(axis=1)
    muscles = []
    for m, mean, fiber in zip(leg.muscles, slack, _target_fiber(leg), strict=True):
        reach = m.optimal_fiber_length * np.cos(m.pennation)
        muscles.append(replace(m, tendon_slack_length=float(max(mean - fiber * reach, 0.01))))
    return replace(leg, muscles=tuple(muscles))


def _muscles(leg: Leg, paths: Paths, rng: np.random.Generator, settings: PersonSettings) -> Muscles:
    count = len(leg.muscles)
    draw = lambda spread: np.clip(spread * rng.standard_normal(count), -2 * spread, 2 * spread)  # noqa: E731
    channel = channel_of(leg.names)
    # Muscles of one channel are similar, but not identical.
    common = rng.standard_normal(channel.max() + 1)[channel]
    fiber = np.array([m.optimal_fiber_length for m in leg.muscles]) * np.exp(draw(settings.fiber))
    pennation = np.array([m.pennation for m in leg.muscles])
    mean = paths.length.mean(axis=(0, 2))
    slack = mean - (_target_fiber(leg) + draw(settings.slack)) * fiber * np.cos(pennation)
    zero = np.zeros(count)
    latest = max(0.085, settings.delay + 3.0 * settings.delay_spread)
    delay = np.clip(settings.delay + settings.delay_spread * common + draw(0.004), 0.015, latest)
    return Muscles(
        max_isometric_force=np.array([m.max_isometric_force for m in leg.muscles]),
        optimal_fiber_length=fiber,
        tendon_slack_length=np.maximum(slack, 0.008),
        pennation=pennation,
        scale=np.exp(draw(0.15)),  # completed with the drive
        delay=np.tile(delay, (paths.length.shape[0], 1)),
        rise=settings.rise * np.exp(draw(0.15)),
        fall=np.full(count, FALL_TO_RISE),
        bend=np.clip(settings.bend + draw(0.08), 0.05, 0.6),
        slowness=zero,
        length_gain=zero,
        enhancement=zero,
        tightness=zero,
        strain=zero,
        recruitment=zero,
    )


def bursts(walked: Walk, additional: tuple[tuple[str, float, float, float], ...] = ()) -> np.ndarray:
    """Compute typical activations of the channels from the literature, (recording, channel, frame)."""
    table = {
        name: [*own, *(burst[1:] for burst in additional if burst[0] == name)]
        for name, own in _BURSTS.items()
    }
    phase = 100.0 * (walked.phase % 1.0)
    out = np.zeros((phase.shape[0], len(CHANNELS), phase.shape[1]))
    for row, name in enumerate(CHANNELS):
        for center, width, height in table[name]:
            away = (phase - center + 50.0) % 100.0 - 50.0
            out[:, row] += height * np.exp(-0.5 * (away / width) ** 2)
    brisk = 0.55 + 0.45 * np.array(walked.speeds) / 1.2
    return 0.015 + brisk[:, None, None] * out


def _drive(
    walked: Walk,
    family: Family,
    paths: Paths,
    muscles: Muscles,
    target: np.ndarray,
    typical: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Find envelopes near typical bursts that approximate the moments, relative to their peaks; and these."""
    curves, every = family.curves(), 5
    channel = channel_of(reference_leg(70.0, 1.72).names)
    ratio = muscles.scale
    coarse = (slice(None), slice(None), slice(None, None, every))
    length, rate = paths.length[coarse], paths.rate[coarse]
    arms, moments = paths.arms[..., ::every], target[coarse]
    passive = muscle_forces(curves, muscles, np.zeros_like(length), length, rate, every / RATE)
    full = muscle_forces(curves, muscles, np.ones_like(length), length, rate, every / RATE) - passive
    prior = typical[coarse]
    members = np.stack([channel == row for row in range(len(CHANNELS))]) * ratio
    activations = np.zeros_like(prior)
    for recording in range(prior.shape[0]):
        by_channel = np.einsum("cm,mkf,mf->fkc", members, arms[recording], full[recording])
        rest = np.einsum("mkf,mf->fk", arms[recording], passive[recording])
        for frame in range(prior.shape[2]):
            rows = by_channel[frame] / _TRACKING[:, None]
            matrix = np.vstack([rows, np.eye(len(CHANNELS)) / _STRAY])
            right = np.concatenate(
                [
                    (moments[recording, :, frame] - rest[frame]) / _TRACKING,
                    prior[recording, :, frame] / _STRAY,
                ]
            )
            activations[recording, :, frame] = nnls(matrix, right)[0]
    return _envelopes(walked, family, muscles, channel, activations, every, rng)


def _scale(peaks: np.ndarray, channel: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Compute the excitation of each muscle at an envelope of one."""
    return np.where(channel >= 0, np.clip(peaks[channel] * ratio, 0.05, 0.95), 0.0)


def _envelopes(walked, family, muscles, channel, activations, every, rng):
    time, cycle = walked.time, RATE / np.median(np.diff(walked.phase[0])) / RATE
    fine = np.stack([[np.interp(time, time[::every], row) for row in part] for part in activations])
    smooth = np.clip(lowpass(fine, 4.5 * max(1.0, 1.2 / (cycle / RATE)), RATE), 0.004, 0.9)
    # Every channel varies slightly from cycle to cycle.
    smooth = smooth * np.exp(0.08 * smooth_noise(rng, smooth.shape, 0.5 * cycle))
    envelopes, peaks = np.zeros_like(smooth), np.zeros(len(CHANNELS))
    for row in range(len(CHANNELS)):
        driven = channel == row
        bend = muscles.bend[driven].mean()
        grid = np.linspace(0.0, 1.0, 400)
        drive = np.interp(smooth[:, row], family.shape(grid, np.array(bend)), grid)
        # Advance by the delay and by the lag of activation dynamics.
        ahead = muscles.delay[:, driven].mean() + 1.6 * muscles.rise[driven].mean()
        envelopes[:, row] = [np.interp(time + ahead, time, part) for part in drive]
        peaks[row] = np.percentile(envelopes[:, row], 99.5)
    return envelopes / peaks[None, :, None], peaks
