"""A recorded walk as inverse dynamics see it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline

from wrapjax.osim.inverse_dynamics import JointShift, Mechanics
from wrapjax.osim.motion import Motion

UP = np.array([0.0, 1.0, 0.0])
#: Share of the largest vertical force from which a foot counts as on the ground.
CONTACT = 0.05
#: By how much angles and joints are moved to see what that does, rad and m.
ANGLE_STEP, JOINT_STEP = 0.005, 0.002
# N m a unit.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Walk:
    """All frames of all cycles in a row (``pose``), in ground's frame.

    Parameters
    ----------
    side
        ``l`` or ``r``.
    time
        s.
    motion, mechanics
        How the model moved, and what inverse dynamics need of that.
    loaded, wrench
        Bodies of this leg on which the ground acts, and what acts on each: moment about ground's origin
        (N m), then force (N).
    by_latency
        How that changes with the time (s) by which forces were recorded later than motion.
    other
        What acts on the other leg; None where it was not recorded.
    analyse
        Gives the mechanics of another motion, and of it with a joint elsewhere.
    """

    side: str
    time: Float[np.ndarray, "trial frame"]
    motion: Motion
    mechanics: Mechanics
    loaded: tuple[str, ...]
    wrench: Float[np.ndarray, "load 6 pose"]
    by_latency: Float[np.ndarray, "load 6 pose"]
    other: Float[np.ndarray, "6 pose"] | None
    analyse: Callable[[Motion, JointShift | None], Mechanics]

    @property
    def outward(self) -> float:
        """Sign of a direction to the right that points away from the midline."""
        return 1.0 if self.side == "r" else -1.0

    @property
    def force(self) -> Float[np.ndarray, "3 pose"]:
        """The ground's whole force on this leg."""
        return self.wrench[:, 3:].sum(axis=0)

    @property
    def center_of_pressure(self) -> Float[np.ndarray, "3 pose"]:
        """Where the ground's whole force meets its plane at height zero; the origin while it is small."""
        moment, force = self.wrench.sum(axis=0).reshape(2, 3, -1)
        lifted = np.cross(UP, moment, axisa=0, axisb=0, axisc=0) / np.where(self.in_contact, force[1], 1.0)
        return np.where(self.in_contact, lifted, 0.0)

    @property
    def in_contact(self) -> Bool[np.ndarray, " pose"]:
        """Whether the foot is on the ground."""
        vertical = self.force[1]
        return vertical > CONTACT * vertical.max()

    @property
    def pelvis(self) -> int:
        """Number of the body that hangs on ground and carries the leg."""
        bodies, parents = self.mechanics.bodies, self.mechanics.parents
        body = bodies.index(self.loaded[0])
        while parents[body] in bodies:
            body = bodies.index(parents[body])
        return body

    @property
    def forward(self) -> Float[np.ndarray, "3 pose"]:
        """Horizontal direction in which the pelvis faces, the same all through a cycle."""
        facing = self.mechanics.rotation[self.pelvis, :, 0].reshape(3, *self.time.shape)
        mean = facing.mean(axis=2) * (1.0 - UP)[:, None]
        mean = mean / np.linalg.norm(mean, axis=0)
        return np.repeat(mean, self.time.shape[1], axis=1)

    @property
    def rightward(self) -> Float[np.ndarray, "3 pose"]:
        """Horizontal direction to the right of `forward`."""
        return np.cross(self.forward, UP, axisa=0, axisc=0)

    def starting(self, stem: str) -> list[int]:
        """Number the coordinates whose names start so."""
        return [row for row, name in enumerate(self.mechanics.coordinates) if name.startswith(stem)]

    def transmitted(self) -> Float[np.ndarray, "coordinate 6 pose"]:
        """Give the wrench that each coordinate's joint hands on (`Mechanics.transmitted`)."""
        return self.mechanics.transmitted(self.loaded, self.wrench)

    def moments_by_load(
        self, change: Float[np.ndarray, "load 6 pose"]
    ) -> Float[np.ndarray, "coordinate pose"]:
        """Give what moments change by when what acts on the leg changes so."""
        moved = self.mechanics.moved(self.loaded)
        return -self.mechanics.moments(np.einsum("kl,lwp->kwp", moved, change))

    @property
    def moving(self) -> tuple[list[int], list[int]]:
        """Rows of the coordinates that follow no other: in `mechanics`, and in `motion`."""
        names, moving = self.mechanics.coordinates, self.motion.coordinates
        own = [row for row, name in enumerate(names) if name in moving]
        return own, [moving.index(names[row]) for row in own]

    def moments_by_angles(
        self, errors: Float[np.ndarray, "pattern coordinate trial frame"]
    ) -> Float[np.ndarray, "pattern coordinate pose"]:
        """Give what moments change by, for a unit of each pattern, when angles are recorded so far off (rad).

        Coordinates as those of `mechanics`; one that follows another is off as that one is. Forces stay where
        they were recorded; rates and accelerations are off as well. Every second frame is looked at.
        """
        poses = self._looked_at
        own_rows, rows = self.moving
        step = (self.time[:, 1] - self.time[:, 0])[:, None]
        slopes = np.zeros((len(errors), *self.mechanics.screw.shape[::2]))
        for number, pattern in enumerate(errors[:, own_rows]):
            largest = np.abs(pattern).max(initial=0.0)
            if largest == 0.0:
                continue
            unit = ANGLE_STEP / largest
            rates = np.gradient(pattern, axis=-1) / step
            moved = Motion(
                self.motion.coordinates,
                *(
                    _with(own[:, poses], rows, unit * off.reshape(len(rows), -1)[:, poses])
                    for own, off in (
                        (self.motion.values, pattern),
                        (self.motion.speeds, rates),
                        (self.motion.accelerations, np.gradient(rates, axis=-1) / step),
                    )
                ),
            )
            slopes[number] = self._change(self.analyse(moved, None)) / unit
        return slopes

    def moments_by_joint(
        self, coordinate: str, displacement: Float[np.ndarray, " 3"], turn: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "coordinate pose"]:
        """Give what moments change by when the model has a joint elsewhere, and the leg hangs on it there.

        A unit of displacement (m) and of turn (rad), see `JointShift`. Angles and forces stay as they were
        recorded. Every second frame is looked at.
        """
        own = self.motion
        signals = [signal[:, self._looked_at] for signal in (own.values, own.speeds, own.accelerations)]
        shift = JointShift(coordinate, JOINT_STEP * displacement, JOINT_STEP * turn)
        slopes = self._change(self.analyse(Motion(own.coordinates, *signals), shift)) / JOINT_STEP
        # A joint that cannot be moved changes nothing but rounding.
        return slopes if np.abs(slopes).max() > _ROUNDING else np.zeros_like(slopes)

    @property
    def _kept(self) -> Int[np.ndarray, " kept"]:
        """Frames of each cycle that are looked at where every pose takes its time."""
        frames = self.time.shape[1]
        return np.arange(frames) if frames % 2 == 0 else np.arange(0, frames, 2)

    @property
    def _looked_at(self) -> Int[np.ndarray, " pose"]:
        trials, frames = self.time.shape
        return (np.arange(trials)[:, None] * frames + self._kept).ravel()

    def _change(self, found: Mechanics) -> Float[np.ndarray, "coordinate pose"]:
        """By how much moments of the poses that are looked at are other than they were, at all poses."""
        poses, (trials, frames) = self._looked_at, self.time.shape
        plain = self.mechanics.moments(self.transmitted())[:, poses]
        change = found.moments(found.transmitted(self.loaded, self.wrench[..., poses])) - plain
        by_time = CubicSpline(self._kept, change.reshape(len(change), trials, -1), axis=-1)
        return np.asarray(by_time(np.arange(frames))).reshape(len(change), -1)

    def other_foot(self) -> Float[np.ndarray, "6 pose"]:
        """Give what acts on the other foot: as recorded, else this one's half a cycle away, mirrored.

        The mirror is the pelvis' midplane, so that it holds on treadmills and over ground; that gait is
        symmetric is the assumption.
        """
        if self.other is not None:
            return self.other
        half = (self.time.shape[1] - 1) // 2
        later = (np.arange(self.time.shape[1]) + half) % (2 * half)
        where = self.mechanics.origin[self.pelvis]
        sum_of_loads = self.wrench.sum(axis=0)
        about = sum_of_loads[:3] - np.cross(where, sum_of_loads[3:], axis=0)

        def half_a_cycle_away(vector: Float[np.ndarray, "3 pose"]) -> Float[np.ndarray, "3 pose"]:
            return vector.reshape(3, *self.time.shape)[..., later].reshape(3, -1)

        right = self.rightward
        force, moment = half_a_cycle_away(sum_of_loads[3:]), half_a_cycle_away(about)
        force = force - 2.0 * right * (right * force).sum(axis=0)
        # A moment turns the other way round in a mirror.
        moment = 2.0 * right * (right * moment).sum(axis=0) - moment
        return np.concatenate([moment + np.cross(where, force, axis=0), force])


def _with(
    signals: Float[np.ndarray, "coordinate pose"],
    rows: Sequence[int],
    added: Float[np.ndarray, "moved pose"],
) -> Float[np.ndarray, "coordinate pose"]:
    found = signals.copy()
    found[list(rows)] += added
    return found
