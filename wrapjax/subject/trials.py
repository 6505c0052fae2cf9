"""Gait cycles on a common grid: what every later step calculates with."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

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
