"""Gait cycles of one leg on a common time grid."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

#: Number of frames of a resampled gait cycle, from 0 to 100 %.
FRAMES = 101
#: Tolerance in s by which a cycle may extend beyond its recording: times are often printed with few digits.
TIME_TOLERANCE = 1e-5


@dataclass(frozen=True)
class Trials:
    """Gait cycles of one leg, resampled to the same number of frames.

    Parameters
    ----------
    names
        Name of each cycle: that of its recording, or ``walk_a/03`` (counted from 1) if that has several
        cycles.
    recordings
        Name of the recording of each cycle.
    uses
        ``calibration`` or ``validation``, for each cycle.
    speeds
        Walking speed of each cycle in m/s, NaN where not given.
    coordinates
        Coordinates of the model that all angle files contain, in the model's order.
    moment_coordinates
        Coordinates whose moments are predicted, in the order of the subject's settings.
    channels
        EMG channels, in the order of the subject's settings.
    time
        Time in s, evenly spaced over each cycle.
    angles
        Joint angles in rad (m for translations), with OpenSim's signs.
    angular_velocities
        Time derivative of the spline through the recorded angles, in rad/s (m/s).
    moments
        Net joint moments by inverse dynamics in N m, with OpenSim's signs.
    emg_time
        Time in s of the EMG: the frames of the cycle and padding frames before and after it, at the same
        step.
    emg
        Normalised EMG envelopes, dimensionless, not negative.
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
        """Number of EMG frames before the cycle, which equals that after it."""
        return (self.emg_time.shape[1] - self.time.shape[1]) // 2

    def __len__(self) -> int:
        return len(self.names)

    def select(self, keep) -> Trials:
        """Select some of the cycles.

        Parameters
        ----------
        keep
            Boolean mask or indices of the cycles to keep.
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
        """Select the cycles of one use, ``calibration`` or ``validation``."""
        return self.select(np.array([entry == use for entry in self.uses], dtype=bool))
