"""Simulated walking on a treadmill or overground: joint angles, pelvis pose and ground forces of cycles.

Mean curves approximate Winter 2009 and Perry 2010 at the phases below (deg; body weights); amplitudes,
cadence and stance grow with speed as in Schwartz 2008 (doi:10.1016/j.jbiomech.2008.03.015). Cycles differ in
duration, amplitude and shape, smoothly in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfiltfilt

from validation.blind.anatomy import Leg
from validation.blind.opensim_leg import ALL_COORDINATES, foot_points
from validation.blind.worlds import USUAL_GAIT, GaitSettings

# Tables are easier to read in one line.
# ruff: noqa: E501


#: Rate of the fine time base and of the written files, Hz; duration of a recording, s.
RATE = 500.0
FILE_RATE = 100.0
DURATION = 13.0
#: Time before the first cycle that is used, s: delays and filters need earlier samples.
LEAD = 0.6

_PHASES = {
    "hip_flexion_r": ([0, 8, 20, 30, 40, 52, 60, 70, 80, 88, 94], [26, 24, 16, 8, 1, -5, 0, 15, 26, 30, 28]),
    "hip_adduction_r": ([0, 8, 18, 30, 40, 52, 62, 72, 84, 94], [-5, -1.5, 0.5, -0.5, -1.5, -4.5, -9, -8.5, -6.5, -5.5]),
    "hip_rotation_r": ([0, 10, 22, 36, 50, 60, 70, 82, 92], [-2, 1, 3, 2, 2.5, -1, -4.5, -4, -2.5]),
    "knee_angle_r": ([0, 6, 13, 22, 32, 40, 50, 60, 67, 72, 80, 90, 95], [6, 12, 19, 17, 12, 9, 12, 32, 54, 60, 50, 18, 7]),
    "ankle_angle_r": ([0, 6, 12, 22, 34, 44, 51, 58, 63, 70, 80, 90], [0, -5, -2, 4, 8, 11, 6, -8, -15, -9, -0.5, 1]),
    "subtalar_angle_r": ([0, 10, 22, 36, 48, 58, 66, 80, 92], [2, -4, -5, -4, -1, 5, 5, 2.5, 2]),
    "pelvis_tilt": ([0, 25, 50, 75], [-4.5, -3, -4.5, -3]),
    "pelvis_list": ([0, 14, 30, 50, 64, 80], [0, 3.5, 1.5, 0, -3.5, -1.5]),
    "pelvis_rotation": ([0, 25, 50, 75], [4, 0, -4, 0]),
    "pelvis_tx": ([0, 12, 25, 38, 50, 62, 75, 88], [0, -0.008, 0, 0.008, 0, -0.008, 0, 0.008]),
    "pelvis_ty": ([0, 6, 30, 50, 56, 80], [-0.014, -0.018, 0.018, -0.014, -0.018, 0.018]),
    "pelvis_tz": ([0, 30, 50, 80], [0.0, 0.018, 0.0, -0.018]),
}  # fmt: skip

# Ground force over stance, in body weights: forward, up, right. First list: % of stance.
_FORWARD = ([0, 3, 10, 22, 40, 55, 70, 82, 91, 100], [0, 0.02, -0.10, -0.17, -0.08, 0.0, 0.09, 0.19, 0.18, 0])
_UP = (
    [0, 4, 10, 20, 33, 50, 65, 77, 87, 95, 100],
    [0, 0.25, 0.72, 1.07, 0.98, 0.80, 0.94, 1.09, 0.82, 0.25, 0],
)
_RIGHT = ([0, 4, 12, 30, 50, 75, 90, 100], [0, 0.02, -0.035, -0.05, -0.042, -0.05, -0.03, 0])
_TURN = ([0, 15, 40, 60, 80, 100], [0, -0.004, 0.0, 0.006, 0.006, 0])
# Center of pressure in the foot's frame (share of the foot's length; m to the right).
_CENTER = ([0, 8, 20, 40, 60, 80, 92, 100], [0.03, 0.09, 0.22, 0.40, 0.57, 0.71, 0.76, 0.79])
_CENTER_RIGHT = ([0, 20, 60, 85, 100], [0.002, 0.006, 0.006, -0.004, -0.012])


@dataclass(frozen=True)
class Walk:
    """Walk at three speeds. Axes: recording, (coordinate or component), frame of the fine time base."""

    time: np.ndarray  # (frame,)
    phase: np.ndarray  # (recording, frame): number of cycles completed
    speeds: tuple[float, ...]
    pose: np.ndarray  # (recording, 12, frame), rad and m: pelvis, then leg
    stance: np.ndarray  # (recording, frame): share of stance in 0 to 1, nan in swing
    ground: np.ndarray  # (recording, 9, frame): force, point, free moment on the right foot
    # The same on the left foot, whose points are those of the right foot half a cycle earlier.
    other_ground: np.ndarray

    @property
    def angles(self) -> np.ndarray:
        return self.pose[:, 6:]

    def strikes(self, recording: int) -> np.ndarray:
        """Return the times at which cycles begin (heel strikes), s."""
        phase = self.phase[recording]
        whole = np.arange(np.ceil(phase[0]), np.floor(phase[-1]) + 1)
        return np.interp(whole, phase, self.time)


def derivative(values: np.ndarray, time: np.ndarray, order: int = 1) -> np.ndarray:
    return CubicSpline(time, values, axis=-1)(time, order)


def lowpass(values: np.ndarray, cutoff: float, rate: float) -> np.ndarray:
    """Apply a zero-phase Butterworth low-pass filter of fourth order in total."""
    return sosfiltfilt(butter(2, cutoff, fs=rate, output="sos"), values, axis=-1)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], frames: float) -> np.ndarray:
    """Draw unit-variance Gaussian noise with a Gaussian correlation of a number of frames."""
    # Draw on a coarse grid, where the filter is short, and interpolate by splines.
    step = max(1, int(frames / 4))
    coarse = shape[-1] // step + 3
    noise = gaussian_filter1d(
        rng.standard_normal((*shape[:-1], coarse)), frames / step, axis=-1, mode="reflect"
    )
    noise /= np.sqrt(1.0 / (2.0 * np.sqrt(np.pi) * frames / step))
    if step == 1:
        return noise[..., : shape[-1]]
    return CubicSpline(np.arange(coarse) * step, noise, axis=-1)(np.arange(shape[-1]))


def simulate_walk(
    leg: Leg,
    rng: np.random.Generator,
    speeds: tuple[float, ...],
    settings: GaitSettings = USUAL_GAIT,
    cycles: np.random.Generator | None = None,
) -> Walk:
    """Simulate walking at several speeds, 13 s each; what differs between cycles may have its own generator."""
    time = np.arange(int(DURATION * RATE)) / RATE
    habits = {name: 1.0 + 0.08 * rng.standard_normal() for name in ALL_COORDINATES}
    offsets = {name: rng.standard_normal() for name in ALL_COORDINATES}
    cadence = settings.period * (1.0 + 0.04 * rng.standard_normal())
    habits |= {name: habits[name] * factor for name, factor in settings.ranges}
    own = rng if cycles is None else cycles
    recordings = [_recording(leg, own, time, speed, habits, offsets, cadence, settings) for speed in speeds]
    phase, pose, stance, ground, other = (np.stack(part) for part in zip(*recordings, strict=True))
    return Walk(time, phase, speeds, pose, stance, ground, other)


def _recording(leg, rng, time, speed, habits, offsets, cadence, settings):
    period = 1.17 * speed**-0.38 * np.sqrt(leg.height / 1.72) * cadence
    rate = 1.0 / period * (1.0 + settings.period_spread * smooth_noise(rng, time.shape, period * RATE))
    phase = np.cumsum(rate) / RATE
    phase -= np.interp(LEAD, time, phase) - 1.0  # the first whole cycle begins after the lead
    toe_off = 0.675 - 0.045 * speed
    amplitude = 0.72 + 0.28 * speed / 1.25
    frames = 0.45 * period * RATE
    pose = np.stack(
        [
            _coordinate(
                name,
                phase,
                amplitude * habits[name],
                offsets[name],
                settings.variability * smooth_noise(rng, time.shape, frames),
            )
            for name in ALL_COORDINATES
        ]
    )
    pose = lowpass(pose, 7.0 / period, RATE)
    advance = speed * time if settings.overground else np.zeros_like(time)
    pose[3] += advance
    ground, stance, local = _ground(leg, rng, phase, toe_off, speed, frames)
    _place_on_floor(leg, time, pose, stance, local, ground)
    other = _mirrored_ground(phase, ground, advance)
    return phase, pose, stance, ground, other


def _coordinate(name, phase, amplitude, offset, noise):
    at, values = _PHASES[name]
    values = np.array(values, float)
    unit = np.radians(1.0) if not name.startswith("pelvis_t") or name == "pelvis_tilt" else 1.0
    curve = PchipInterpolator(
        [*(np.array(at[-2:]) - 100), *at, *(np.array(at[:3]) + 100)],
        np.concatenate([values[-2:], values, values[:3]]),
    )
    shape = CubicSpline(np.linspace(0, 1, 201), _closed(gaussian_filter1d(curve(np.linspace(0, 100, 201)[:-1]), 5.0, mode="wrap")), bc_type="periodic")(phase % 1.0)  # fmt: skip
    middle = values.mean()
    spread = 0.013 * np.ptp(values)
    tilt = 0.6 * offset if unit != 1.0 else 0.0
    return unit * (middle + tilt + amplitude * (shape - middle) + spread * noise)


def _closed(values):
    return np.append(values, values[0])


def _over_stance(table, stance):
    at, values = table
    return PchipInterpolator(np.array(at) / 100.0, values)(stance)


def _ground(leg, rng, phase, toe_off, speed, frames):
    share = (phase % 1.0) / toe_off
    stance = np.where(share < 1.0, share, np.nan)
    inside = np.nan_to_num(stance, nan=1.0)
    weight = leg.mass * 9.80665
    brisk = np.clip(speed / 1.25, 0.2, 1.3)
    # The vertical force has a plateau in slow walking and two peaks in fast walking.
    plateau = _over_stance(([0, 4, 10, 20, 33, 50, 65, 77, 87, 95, 100], [0, 0.2, 0.62, 0.97, 0.99, 0.97, 0.99, 0.98, 0.70, 0.2, 0]), inside)  # fmt: skip
    up = (1 - brisk) * plateau + brisk * _over_stance(_UP, inside)
    wobble = 1.0 + 0.03 * smooth_noise(rng, (3, phase.size), frames)
    force = weight * np.stack(
        [(0.35 + 0.65 * brisk) * _over_stance(_FORWARD, inside), up, _over_stance(_RIGHT, inside)]
    )
    force = lowpass(force * wobble, 20.0, RATE)
    force[:, np.isnan(stance)] = 0.0
    length = 0.152 * leg.height
    along = -0.010 + 0.93 * length * _over_stance(_CENTER, inside) * (0.90 + 0.10 * brisk)
    along += 0.008 * smooth_noise(rng, phase.shape, frames)
    right = _over_stance(_CENTER_RIGHT, inside) + 0.003 * smooth_noise(rng, phase.shape, frames)
    local = np.stack([along, np.full_like(along, -0.038 * leg.height / 1.72), right], axis=-1)
    turn = np.where(np.isnan(stance), 0.0, weight * leg.height * _over_stance(_TURN, inside))
    ground = np.zeros((9, phase.size))
    ground[:3], ground[7] = force, turn
    return ground, stance, local


def _place_on_floor(leg, time, pose, stance, local, ground):
    """Shift the pelvis vertically so that the sole is on the floor on average, and place the force."""
    every = int(RATE / 50.0)
    coarse = np.unique(np.append(np.arange(0, time.size, every), time.size - 1))
    pose[4] += 0.9 * leg.height / 1.72
    places = foot_points(leg, pose[:, coarse], local[coarse])
    loaded = ~np.isnan(stance[coarse])
    pose[4] -= places[loaded, 1].mean()
    world = CubicSpline(time[coarse], places, axis=0)(time)
    ground[3], ground[5] = world[:, 0], world[:, 2]
    ground[3:6, np.isnan(stance)] = 0.0


def _mirrored_ground(phase, ground, advance):
    """Mirror the ground forces of the right foot to the left, half a cycle later."""
    source = np.interp(phase - 0.5, phase, np.arange(phase.size), left=0)
    other = np.array([np.interp(source, np.arange(phase.size), row) for row in ground])
    stepped = np.interp(np.arange(phase.size) - source, np.arange(phase.size), advance - advance[0])
    other[3] += np.where(other[1] > 0.0, stepped, 0.0)
    other[[2, 6, 7]] *= -1.0
    other[5] = -other[5]
    return other
