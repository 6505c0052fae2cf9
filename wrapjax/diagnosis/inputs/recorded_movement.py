"""Recorded movement as inverse dynamics uses it, and derivatives of moments by errors of its inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline

from wrapjax.osim.mechanics import JointShift, Mechanics
from wrapjax.osim.motion import Motion

#: Change of the measured moments per unit of each parameter of an effect, N m per unit.
MomentDerivatives = Float[np.ndarray, "parameter coordinate pose"]

UP = np.array([0.0, 1.0, 0.0])
#: Share of the largest vertical force above which a foot is in contact with the ground.
CONTACT = 0.05
#: Largest changes of angles (rad) and joints (rad and m) in the differences that give derivatives.
ANGLE_STEP, JOINT_STEP = 0.005, 0.002
#: Derivatives that are nowhere larger than this are rounding errors, N m per unit.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class RecordedMovement:
    """Motion and external forces of one leg in gait or in another movement, in ground's frame.

    All frames of all cycles, or windows of a movement, are one axis ``pose``.

    Parameters
    ----------
    side
        ``l`` or ``r``.
    time
        s.
    motion, mechanics
        Recorded motion, and the model's mechanics along it.
    loaded_bodies, wrenches
        Bodies of this leg on which the ground acts, and the wrench on each: moment about ground's origin
        (N m), then force (N).
    wrenches_by_latency
        Derivative of `wrenches` by the time (s) by which forces were recorded later than motion.
    other_wrench
        Wrench on the other foot; None where it was not recorded.
    analyse
        Function that computes the mechanics of another motion, with a joint of the model displaced if given.
    gait
        Recorded gait of the same leg, if this is another movement; None if this is the gait. What is relative
        to a largest force is relative to that of the gait, so that effect sizes mean the same in both.
    """

    side: str
    time: Float[np.ndarray, "trial frame"]
    motion: Motion
    mechanics: Mechanics
    loaded_bodies: tuple[str, ...]
    wrenches: Float[np.ndarray, "load 6 pose"]
    wrenches_by_latency: Float[np.ndarray, "load 6 pose"]
    other_wrench: Float[np.ndarray, "6 pose"] | None
    analyse: Callable[[Motion, JointShift | None], Mechanics]
    gait: RecordedMovement | None = None

    @property
    def is_gait(self) -> bool:
        """Whether the cycles are those of gait, which have a phase and repeat themselves."""
        return self.gait is None

    @property
    def reference(self) -> RecordedMovement:
        """The gait."""
        return self if self.gait is None else self.gait

    @property
    def outward(self) -> float:
        """Sign of a direction to the right that points away from the midline: 1 for the right leg."""
        return 1.0 if self.side == "r" else -1.0

    @property
    def force(self) -> Float[np.ndarray, "3 pose"]:
        """Total ground reaction force on this leg, N."""
        return self.wrenches[:, 3:].sum(axis=0)

    @property
    def center_of_pressure(self) -> Float[np.ndarray, "3 pose"]:
        """Center of pressure of the total force at height zero, m; the origin while there is no contact."""
        moment, force = self.wrenches.sum(axis=0).reshape(2, 3, -1)
        lifted = np.cross(UP, moment, axisa=0, axisb=0, axisc=0) / np.where(self.in_contact, force[1], 1.0)
        return np.where(self.in_contact, lifted, 0.0)

    @property
    def in_contact(self) -> Bool[np.ndarray, " pose"]:
        """Whether the foot is in contact with the ground."""
        vertical = self.force[1]
        return vertical > CONTACT * self.reference.force[1].max()

    @property
    def pelvis(self) -> int:
        """Number of the body that carries the leg: the ancestor of the foot that is jointed to ground."""
        bodies, parents = self.mechanics.bodies, self.mechanics.parents
        body = bodies.index(self.loaded_bodies[0])
        while parents[body] in bodies:
            body = bodies.index(parents[body])
        return body

    @property
    def forward(self) -> Float[np.ndarray, "3 pose"]:
        """Horizontal direction in which the pelvis faces on average over each cycle or window."""
        facing = self.mechanics.rotation[self.pelvis, :, 0].reshape(3, *self.time.shape)
        mean = facing.mean(axis=2) * (1.0 - UP)[:, None]
        mean = mean / np.linalg.norm(mean, axis=0)
        return np.repeat(mean, self.time.shape[1], axis=1)

    @property
    def rightward(self) -> Float[np.ndarray, "3 pose"]:
        """Horizontal direction to the right of `forward`."""
        return np.cross(self.forward, UP, axisa=0, axisc=0)

    def rows_of(self, stem: str) -> list[int]:
        """Find the rows of `mechanics.coordinates` whose names start with a stem."""
        return [row for row, name in enumerate(self.mechanics.coordinates) if name.startswith(stem)]

    def no_change(self, parameters: int) -> MomentDerivatives:
        """Give zero derivatives for this number of parameters."""
        return np.zeros((parameters, *self.mechanics.screw.shape[::2]))

    def transmitted_wrenches(self) -> Float[np.ndarray, "coordinate 6 pose"]:
        """Compute the wrench that each coordinate's joint transmits (`Mechanics.transmitted`)."""
        return self.mechanics.transmitted(self.loaded_bodies, self.wrenches)

    def derivative_by_wrenches(
        self, change: Float[np.ndarray, "load 6 pose"]
    ) -> Float[np.ndarray, "coordinate pose"]:
        """Compute the change of the moments (N m) for a change of the wrenches on the leg."""
        moved = self.mechanics.moves_bodies(self.loaded_bodies)
        return -self.mechanics.moments(np.einsum("kl,lwp->kwp", moved, change))

    @property
    def independent_rows(self) -> tuple[list[int], list[int]]:
        """Rows of the coordinates that are not coupled to others: in `mechanics`, and in `motion`."""
        names, moving = self.mechanics.coordinates, self.motion.coordinates
        rows = [row for row, name in enumerate(names) if name in moving]
        return rows, [moving.index(names[row]) for row in rows]

    def derivatives_by_angles(
        self, errors: Float[np.ndarray, "pattern coordinate trial frame"]
    ) -> Float[np.ndarray, "pattern coordinate pose"]:
        """Compute the change of the moments per unit of each pattern of errors in the recorded angles.

        Angular velocities and accelerations change with the angles; external forces stay as recorded. A
        coordinate that is coupled to another follows that one. Every second frame is evaluated.

        Parameters
        ----------
        errors
            Errors of the coordinates of `mechanics`, rad for one unit.
        """
        poses = self._evaluated_poses
        rows_in_mechanics, rows = self.independent_rows
        step = (self.time[:, 1] - self.time[:, 0])[:, None]
        derivatives = self.no_change(len(errors))
        for number, pattern in enumerate(errors[:, rows_in_mechanics]):
            largest = np.abs(pattern).max(initial=0.0)
            if largest == 0.0:
                continue
            unit = ANGLE_STEP / largest
            rates = np.gradient(pattern, axis=-1) / step
            moved = Motion(
                self.motion.coordinates,
                *(
                    _add_to_rows(recorded[:, poses], rows, unit * error.reshape(len(rows), -1)[:, poses])
                    for recorded, error in (
                        (self.motion.values, pattern),
                        (self.motion.speeds, rates),
                        (self.motion.accelerations, np.gradient(rates, axis=-1) / step),
                    )
                ),
            )
            derivatives[number] = self._moment_change(self.analyse(moved, None)) / unit
        return derivatives

    def derivative_by_joint(
        self, coordinate: str, displacement: Float[np.ndarray, " 3"], turn: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "coordinate pose"]:
        """Compute the change of the moments where the model's joint is displaced, and the leg with it.

        Angles and external forces stay as recorded. Every second frame is evaluated.

        Parameters
        ----------
        coordinate
            Coordinate of the joint.
        displacement, turn
            Change of the joint for one unit, m and rad: see `JointShift`.
        """
        recorded = self.motion
        signals = [
            signal[:, self._evaluated_poses]
            for signal in (recorded.values, recorded.speeds, recorded.accelerations)
        ]
        shift = JointShift(coordinate, JOINT_STEP * displacement, JOINT_STEP * turn)
        derivative = (
            self._moment_change(self.analyse(Motion(recorded.coordinates, *signals), shift)) / JOINT_STEP
        )
        # A joint that cannot be moved changes the moments by rounding errors only.
        return derivative if np.abs(derivative).max() > _ROUNDING else np.zeros_like(derivative)

    @property
    def _evaluated_frames(self) -> Int[np.ndarray, " kept"]:
        """Frames of each cycle at which OpenSim evaluates a changed motion or model, which is slow."""
        frames = self.time.shape[1]
        return np.arange(frames) if frames % 2 == 0 else np.arange(0, frames, 2)

    @property
    def _evaluated_poses(self) -> Int[np.ndarray, " pose"]:
        trials, frames = self.time.shape
        return (np.arange(trials)[:, None] * frames + self._evaluated_frames).ravel()

    def _moment_change(self, changed: Mechanics) -> Float[np.ndarray, "coordinate pose"]:
        """Compute the change of the moments at the evaluated poses, and interpolate it to all poses."""
        poses, (trials, frames) = self._evaluated_poses, self.time.shape
        plain = self.mechanics.moments(self.transmitted_wrenches())[:, poses]
        change = changed.moments(changed.transmitted(self.loaded_bodies, self.wrenches[..., poses])) - plain
        by_time = CubicSpline(self._evaluated_frames, change.reshape(len(change), trials, -1), axis=-1)
        return np.asarray(by_time(np.arange(frames))).reshape(len(change), -1)

    def other_foot_wrench(self) -> Float[np.ndarray, "6 pose"]:
        """Give the recorded wrench on the other foot, or estimate it from this foot's.

        The estimate is this foot's wrench half a cycle away, mirrored in the pelvis' midplane, so that it
        holds on treadmills and over ground. It assumes symmetric gait; in another movement there is none.
        """
        if self.other_wrench is not None:
            return self.other_wrench
        if not self.is_gait:
            return np.zeros_like(self.wrenches[0])
        half = (self.time.shape[1] - 1) // 2
        later = (np.arange(self.time.shape[1]) + half) % (2 * half)
        origin = self.mechanics.origin[self.pelvis]
        total = self.wrenches.sum(axis=0)
        about = total[:3] - np.cross(origin, total[3:], axis=0)

        def half_a_cycle_away(vector: Float[np.ndarray, "3 pose"]) -> Float[np.ndarray, "3 pose"]:
            return vector.reshape(3, *self.time.shape)[..., later].reshape(3, -1)

        right = self.rightward
        force, moment = half_a_cycle_away(total[3:]), half_a_cycle_away(about)
        force = force - 2.0 * right * (right * force).sum(axis=0)
        # A mirror reverses the sense of a moment.
        moment = 2.0 * right * (right * moment).sum(axis=0) - moment
        return np.concatenate([moment + np.cross(origin, force, axis=0), force])


def _add_to_rows(
    signals: Float[np.ndarray, "coordinate pose"],
    rows: Sequence[int],
    added: Float[np.ndarray, "moved pose"],
) -> Float[np.ndarray, "coordinate pose"]:
    changed = signals.copy()
    changed[list(rows)] += added
    return changed
