"""Gait cycles on a common grid: what every later step calculates with.

From a recording of any rate to gait cycles of equally many frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

#: Frames of a resampled gait cycle, 0 to 100 %.
FRAMES = 101


@dataclass(frozen=True)
class Trials:
    """Gait cycles of one leg, all resampled to the same number of frames.

    Parameters
    ----------
    names
        One a cycle: the recording's name, or ``walk_a/03`` (counted from 1) where it holds several cycles.
    recordings
        Name of the recording that each cycle is from.
    uses
        ``calibration`` or ``validation``, one a cycle.
    speeds
        Walking speed in m/s, NaN where not given.
    coordinates
        Every coordinate of the model found in all angle files, in the model's order.
    moment_coordinates
        The coordinates whose moments are matched, in the order of the subject's settings.
    channels
        EMG channels, in the order of the subject's settings.
    time
        Time in s, evenly spaced over each cycle.
    angles
        Joint angles in rad (m for translations), OpenSim's signs.
    angular_velocities
        Derivative of the spline through the recorded angles, in rad/s (m/s).
    moments
        Net joint moments of inverse dynamics in N m, OpenSim's signs.
    emg_time
        Time in s of the EMG: the cycle's own frames and as many before as after, same step.
    emg
        Normalised EMG envelopes, without unit, not negative.
    """

    names: tuple[str, ...]
    recordings: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
    coordinates: tuple[str, ...]
    moment_coordinates: tuple[str, ...]
    channels: tuple[str, ...]
    time: Float[np.ndarray, "trial frame"]
    angles: Float[np.ndarray, "trial coordinate frame"]
    angular_velocities: Float[np.ndarray, "trial coordinate frame"]
    moments: Float[np.ndarray, "trial moment_coordinate frame"]
    emg_time: Float[np.ndarray, "trial padded_frame"]
    emg: Float[np.ndarray, "trial channel padded_frame"]

    @property
    def padding(self) -> int:
        """Frames of EMG before the cycle, and after it."""
        return (self.emg_time.shape[1] - self.time.shape[1]) // 2

    def __len__(self) -> int:
        return len(self.names)

    def select(self, keep) -> Trials:
        """Keep some cycles.

        Parameters
        ----------
        keep
            A boolean mask or indices over the cycles.
        """
        indices = np.arange(len(self))[np.asarray(keep)]
        chosen = {}
        for field in fields(self):
            content = getattr(self, field.name)
            if isinstance(content, np.ndarray):
                content = content[indices]
            elif field.name in ("names", "recordings", "uses"):
                content = tuple(content[index] for index in indices)
            chosen[field.name] = content
        return Trials(**chosen)

    def used_for(self, use: str) -> Trials:
        """Keep the cycles of one use, ``calibration`` or ``validation``."""
        return self.select(np.array([entry == use for entry in self.uses], dtype=bool))


#: Seconds of EMG kept before and after each cycle, so that it can be delayed electromechanically.
PADDING_SECONDS = 0.2
#: Frames beside a cycle come in multiples of this: people who walk at other paces then share compiled code.
PADDING_STEP = 10
#: A cycle may reach beyond the recording by this much, in s: times are often printed with few digits.
TIME_TOLERANCE = 1e-5


def padding_frames(cycles: list[tuple[float, float]]) -> int:
    """Count the frames to add on each side of every cycle: `PADDING_SECONDS` of the shortest, or more."""
    shortest = min(end - start for start, end in cycles)
    # A cycle from 0.07 to 0.57 s lasts 0.49999999999999994 s, which must not cost more frames.
    frames = math.ceil(PADDING_SECONDS / (shortest / (FRAMES - 1)) - 1e-9)
    return PADDING_STEP * math.ceil(frames / PADDING_STEP)


def cycle_times(cycles: list[tuple[float, float]], padding: int = 0) -> Float[np.ndarray, "trial frame"]:
    """Space frames evenly over each cycle, and as many as ``padding`` beyond either end at the same step.

    Parameters
    ----------
    cycles
        Start and end of each cycle in s.
    padding
        Frames added before and after.

    Returns
    -------
    Float[np.ndarray, "trial frame"]
        Time in s.
    """
    limits = np.array(cycles, dtype=float).reshape(-1, 2)
    phase = np.arange(-padding, FRAMES + padding) / (FRAMES - 1)
    times = limits[:, :1] * (1.0 - phase) + limits[:, 1:] * phase
    return times


def resample(
    time: Float[np.ndarray, " sample"],
    values: Float[np.ndarray, "coordinate sample"],
    at: Float[np.ndarray, "trial frame"],
) -> tuple[Float[np.ndarray, "trial coordinate frame"], Float[np.ndarray, "trial coordinate frame"]]:
    """Interpolate a recording by the cubic spline through all its samples (not-a-knot ends).

    Parameters
    ----------
    time
        Time of the samples in s, strictly increasing, not necessarily even.
    values
        The recording.
    at
        Wanted times in s. Before the first and after the last sample the edge value is held.

    Returns
    -------
    values, rates
        Interpolated values, and the spline's derivative by time.
    """
    spline = CubicSpline(time, values, axis=1, bc_type="not-a-knot")
    inside = np.clip(at, time[0], time[-1])
    return np.moveaxis(spline(inside), 1, 0), np.moveaxis(spline(inside, 1), 1, 0)
