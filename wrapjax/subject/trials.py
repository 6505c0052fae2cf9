"""Gait cycles, and windows of other tasks, of one leg on a common time grid."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

#: Number of frames of a resampled gait cycle, from 0 to 100 %.
FRAMES = 101
#: Tolerance in s by which a cycle may extend beyond its recording: times are often printed with few digits.
TIME_TOLERANCE = 1e-5
#: What a trial records: a gait cycle; a joint moved while muscles are at rest; a joint held, or moved at a
#: given velocity, by a dynamometer; any other movement, such as squat, stairs, running or jump.
GAIT, PASSIVE, MOVEMENT = "gait", "passive", "movement"
TASKS = (GAIT, PASSIVE, "isometric", "isokinetic", MOVEMENT)


@dataclass(frozen=True)
class Trials:
    """Gait cycles of one leg, and windows of its other tasks, with the same number of frames.

    A gait cycle is resampled to that number. An interval of another task keeps its own time: it is covered by
    windows of 1 s with a frame every 10 ms (`wrapjax.subject.windows`). "Cycle" below means either.

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
        Net joint moments by inverse dynamics in N m, with OpenSim's signs. NaN where none was measured about
        a coordinate, and in frames of a window that lie outside its interval or in an earlier window.
    emg_time
        Time in s of the EMG: the frames of the cycle and padding frames before and after it, at the same
        step.
    emg
        Normalised EMG envelopes, dimensionless, not negative.
    tasks
        Task of each cycle, one of `TASKS`; all ``gait`` if not given.
    conditions
        Condition of each cycle, such as ``brace``; empty where not given.
    given_samples
        Effective number of independent samples of each cycle, where the settings give it, else NaN; None if
        no cycle has one.
    leading
        Number of EMG frames before each cycle; None if as many as after it.
    emg_starts
        Number of the EMG frame from which each cycle's muscles are activated, from rest; None if the first.
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
    tasks: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()
    given_samples: Float[np.ndarray, " trial"] | None = None
    leading: int | None = None
    emg_starts: Int[np.ndarray, " trial"] | None = None

    def __post_init__(self) -> None:
        if not self.tasks:
            object.__setattr__(self, "tasks", (GAIT,) * len(self.names))
        if not self.conditions:
            object.__setattr__(self, "conditions", ("",) * len(self.names))

    @property
    def padding(self) -> int:
        """Number of EMG frames before the cycle."""
        if self.leading is not None:
            return self.leading
        return (self.emg_time.shape[1] - self.time.shape[1]) // 2

    @property
    def inside(self) -> slice:
        """Frames of the EMG that are those of the cycle."""
        return slice(self.padding, self.padding + self.time.shape[1])

    @property
    def is_gait(self) -> Bool[np.ndarray, " trial"]:
        """Whether each cycle is a gait cycle."""
        return np.array([task == GAIT for task in self.tasks], dtype=bool)

    @property
    def is_gait_only(self) -> bool:
        """Whether all cycles are gait cycles with moments in every frame, as many methods require."""
        return bool(self.is_gait.all() and np.isfinite(self.moments).all())

    @property
    def counted(self) -> Bool[np.ndarray, "trial frame"]:
        """Frames in which a moment about some coordinate was measured."""
        return np.isfinite(self.moments).any(axis=1)

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
            elif field.name in ("names", "recordings", "uses", "tasks", "conditions"):
                content = tuple(content[index] for index in indices)
            chosen[field.name] = content
        return Trials(**chosen)

    def only_gait(self) -> Trials:
        """Select the gait cycles, as if no other task had been recorded."""
        gait = self.select(self.is_gait)
        if gait.emg_starts is None or not len(gait):
            return replace(gait, leading=None, emg_starts=None)
        first = int(gait.emg_starts[0])
        emg_time, emg = gait.emg_time[:, first:], gait.emg[..., first:]
        return replace(gait, emg_time=emg_time, emg=emg, leading=None, emg_starts=None)

    def of_task(self, task: str) -> Trials:
        """Select the cycles of one task."""
        return self.select(np.array([entry == task for entry in self.tasks], dtype=bool))

    def used_for(self, use: str) -> Trials:
        """Select the cycles of one use, ``calibration`` or ``validation``."""
        return self.select(np.array([entry == use for entry in self.uses], dtype=bool))
