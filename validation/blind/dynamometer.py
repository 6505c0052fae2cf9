"""Trials of a dynamometer beside walking: passive rotations, and isometric ramps at three angles a joint.

The moment about the one joint is that of the muscles, with the noise of the device. A rotation ends where the
joint resists with 40 N m. A ramp reaches an excitation of 0.6, or an envelope of 1.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from validation.blind.anatomy import CHANNELS, COORDINATES, PELVIS
from validation.blind.folder import FILE_STEP, write_table
from validation.blind.gait import FILE_RATE, RATE, smooth_noise
from validation.blind.muscles import muscle_forces
from validation.blind.noise import noisy_envelopes
from validation.blind.opensim_leg import ALL_COORDINATES, muscle_paths
from validation.blind.world import Paths, World, joint_moments

#: Duration of a rotation and of a ramp, s.
ROTATION_SECONDS, RAMP_SECONDS = 6.0, 3.0
#: Noise of the device, N m, and its correlation time, s.
NOISE, NOISE_TIME = 0.8, 0.1
#: Moment at which a rotation ends, N m.
RESISTANCE = 40.0
#: Excitation at the top of a ramp, largest envelope there, and envelope of channels that do not act.
RAMP, LARGEST, REST = 0.6, 1.5, 0.02
#: Share of the strongest channel's moment from which a channel acts in a ramp.
ACTS = 0.15
#: Postures of a rotation in which OpenSim computes paths.
_POSTURES = 21


@dataclass(frozen=True)
class Trial:
    """One trial: joint, its range (degrees), posture of the others (degrees), direction of effort."""

    name: str
    coordinate: str
    low: float
    high: float
    posture: dict[str, float]
    sign: int = 0

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return RAMP_SECONDS if self.sign else ROTATION_SECONDS

    @property
    def task(self) -> str:
        """Task in the words of a subject folder."""
        return "isometric" if self.sign else "passive"


_KNEE_BENT = {"hip_flexion_r": 60.0, "knee_angle_r": 90.0}
_RAMPS = {
    "hip_flexion_r": ((0.0, 12.0, 25.0), {"knee_angle_r": 40.0}),
    "knee_angle_r": ((30.0, 50.0, 70.0), {"hip_flexion_r": 30.0}),
    "ankle_angle_r": ((-20.0, -5.0, 10.0), {"hip_flexion_r": 60.0, "knee_angle_r": 30.0}),
}
PASSIVE = (
    Trial("passive_ankle_knee_straight", "ankle_angle_r", -25.0, 15.0, {}),
    Trial("passive_ankle_knee_bent", "ankle_angle_r", -25.0, 20.0, _KNEE_BENT),
    Trial("passive_knee", "knee_angle_r", 5.0, 100.0, {"hip_flexion_r": 30.0}),
    Trial("passive_hip", "hip_flexion_r", -10.0, 70.0, {"knee_angle_r": 40.0}),
)
ISOMETRIC = tuple(
    Trial(f"ramp_{name.removesuffix('_r')}_{number}_{way}", name, angle, angle, posture, sign)
    for name, (angles, posture) in _RAMPS.items()
    for number, angle in enumerate(angles, start=1)
    for way, sign in (("up", 1), ("down", -1))
)


@dataclass(frozen=True)
class Measured:
    """Time (s), pose (12, frame), true moment about the joint (N m), and envelopes (channel, frame)."""

    time: np.ndarray
    pose: np.ndarray
    moment: np.ndarray
    envelopes: np.ndarray


def perform(world: World, trial: Trial) -> Measured:
    """Let a person do a trial."""
    if not trial.sign:
        trial = _resisted(world, trial)
    time = np.arange(round(trial.seconds * RATE) + 1) / RATE
    turn = 0.5 * (1.0 - np.cos(2.0 * np.pi * time / trial.seconds))
    paths = _paths(world, trial, turn)
    drive = np.zeros((len(CHANNELS), time.size))
    if trial.sign:
        ramp = 1.0 - np.abs(2.0 * time / trial.seconds - 1.0)
        drive += REST
        for row, top in _tops(world, trial, paths).items():
            drive[row] = REST + (top - REST) * ramp
    doing = replace(
        world,
        walk=replace(world.walk, time=time, pose=_pose(trial, turn)[None]),
        paths=paths,
        drive=drive[None],
        muscles=replace(world.muscles, delay=world.muscles.delay[:1]),
    )
    moment = joint_moments(doing)[0, COORDINATES.index(trial.coordinate)]
    return Measured(time, doing.walk.pose[0], moment, drive)


def _pose(trial: Trial, turn: np.ndarray) -> np.ndarray:
    pose = np.zeros((len(ALL_COORDINATES), turn.size))
    for name, degrees in trial.posture.items():
        pose[ALL_COORDINATES.index(name)] = np.radians(degrees)
    angle = trial.low + (trial.high - trial.low) * turn
    pose[ALL_COORDINATES.index(trial.coordinate)] = np.radians(angle)
    return pose


def _paths(world: World, trial: Trial, turn: np.ndarray) -> Paths:
    """Compute paths over a turn, 0 to 1 and back; recording is the leading axis."""
    at = np.linspace(0.0, 1.0, 1 if trial.low == trial.high else _POSTURES)
    length, arms = muscle_paths(world.leg, _pose(trial, at)[len(PELVIS) :])
    if at.size == 1:
        still = np.repeat(length, turn.size, axis=-1)
        return Paths(still[None], np.zeros_like(still)[None], np.repeat(arms, turn.size, axis=-1)[None])
    of_length, of_arms = CubicSpline(at, length, axis=-1), CubicSpline(at, arms, axis=-1)
    return Paths(
        of_length(turn)[None], (of_length(turn, 1) * np.gradient(turn, 1.0 / RATE))[None], of_arms(turn)[None]
    )


def _resisted(world: World, trial: Trial) -> Trial:
    """Return a rotation that ends where the joint resists, about the middle of the planned range."""
    turn = np.linspace(0.0, 1.0, 81)
    blocked = np.flatnonzero(np.abs(_at_rest(world, trial, _paths(world, trial, turn))) >= RESISTANCE)
    middle = turn.size // 2
    first = max((int(place) + 1 for place in blocked if place < middle), default=0)
    last = min((int(place) - 1 for place in blocked if place > middle), default=turn.size - 1)
    span = trial.high - trial.low
    low, high = (trial.low + span * float(turn[place]) for place in (first, max(last, first)))
    return replace(trial, low=low, high=high)


def _at_rest(world: World, trial: Trial, paths: Paths) -> np.ndarray:
    """Return the moment of the relaxed muscles about the joint, (frame,) in N m."""
    idle = np.zeros_like(paths.length)
    force = muscle_forces(world.curves, world.muscles, idle, paths.length, idle, 1.0 / RATE)
    arms = paths.arms[:, :, COORDINATES.index(trial.coordinate)]
    return np.asarray((arms * force).sum(axis=1)[0])


def can_be_held(world: World, trial: Trial) -> bool:
    """Return whether relaxed muscles resist the posture of a ramp with less than `RESISTANCE`."""
    still = np.zeros(1)
    return bool(np.abs(_at_rest(world, trial, _paths(world, trial, still))).max() < RESISTANCE)


def _tops(world: World, trial: Trial, paths: Paths) -> dict[int, float]:
    """Return the envelope at the top of a ramp of the channels that act."""
    one = slice(0, 1)
    length = paths.length[..., one]
    none, full = np.zeros_like(length), np.ones_like(length)
    active = muscle_forces(world.curves, world.muscles, full, length, none, 1.0 / RATE)
    active -= muscle_forces(world.curves, world.muscles, none, length, none, 1.0 / RATE)
    arms = paths.arms[..., one][:, :, COORDINATES.index(trial.coordinate)]
    along = trial.sign * (arms * active)[0, :, 0]
    of_channel = np.array([along[world.channel == row].sum() for row in range(len(CHANNELS))])
    return {
        int(row): float(min(RAMP / world.muscles.scale[world.channel == row].mean(), LARGEST))
        for row in np.flatnonzero(of_channel > ACTS * of_channel.max())
    }


def add_trials(
    folder: Path, world: World, trials: Sequence[Trial], emg_noise: float, rng: np.random.Generator
) -> None:
    """Add trials to a subject folder: angles of all coordinates, the moment about one, and envelopes.

    Parameters
    ----------
    folder
        Subject folder of the person's walk.
    world
        True state of the person, without effects.
    trials
        Trials to add; ramps in a posture that the relaxed muscles resist too much are left out.
    emg_noise
        Noise as a share of the envelopes.
    rng
        Source of the noise.
    """
    lines = []
    for trial in trials:
        if trial.sign and not can_be_held(world, trial):
            continue
        done = perform(world, trial)
        noise = NOISE * smooth_noise(rng, (done.time.size,), NOISE_TIME * RATE)
        place = folder / "trials" / trial.name
        place.mkdir()
        write_table(place / "angles.sto", "coordinates", ALL_COORDINATES, np.degrees(done.pose), True)
        column = [f"{trial.coordinate}_moment"]
        write_table(place / "moments.sto", "moment of the device", column, (done.moment + noise)[None])
        end = (done.time[::FILE_STEP].size - 1) / FILE_RATE
        lines += ["", "[[trial]]", f'name = "{trial.name}"', 'use = "calibration"', f'task = "{trial.task}"']
        lines += [f'{kind} = "trials/{trial.name}/{kind}.sto"' for kind in ("angles", "moments")]
        lines.append(f"interval = [0.0, {end:.2f}]")
        if trial.sign:
            recorded = noisy_envelopes(done.envelopes[None], emg_noise, rng)[0]
            write_table(place / "emg.sto", "envelopes", tuple(CHANNELS), recorded)
            lines.append(f'emg = "trials/{trial.name}/emg.sto"')
    file = folder / "subject.toml"
    file.write_text(file.read_text(encoding="utf-8") + "\n".join(lines) + "\n", encoding="utf-8")
