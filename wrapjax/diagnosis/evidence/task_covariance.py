"""Null covariance over some rows of gait cycles and of other tasks.

Of most tasks other than gait one coordinate is measured, so that the covariance of all rows would be several
times as large as that of the rows that count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import (
    STATE_SCALES,
    Matrix,
    input_blocks,
    periodic_kernel,
)
from wrapjax.diagnosis.null_hypotheses.null_covariance import (
    ACROSS_SPEEDS,
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    REPEATABLE_WIDTH,
)

#: Standard deviation of moments of a dynamometer, N m.
DYNAMOMETER_NOISE = 1.0
#: Factor on the cycle noise of gait for a movement that is recorded once or twice.
NOISE_INFLATION = 1.5
#: Standard deviation, relative to the moments, of an error of the model in a trial of another task that is
#: the same at the same joint angle, its correlation width (rad), and the sizes that are tried. The calibrated
#: parameters are those of walking, and these trials leave its angles and efforts.
EXPECTED_ERROR_BY_ANGLE, ANGLE_WIDTH, ERRORS_BY_ANGLE = 0.1, 0.35, (0.05, 0.1, 0.2, 0.4)
#: Share of its prior standard deviation that everybody has of each effect and that walking leaves open: it
#: shows at angles and efforts of other tasks, such as usual passive moments, crosstalk or errors of paths.
USUAL_SHARE = 0.3
#: Activation from which a muscle's force has its whole error in tasks other than gait, and the share of it
#: that a muscle at rest has: what rests can only be wrong by its passive force, whose law has a prior.
FULL_ERROR_ACTIVATION, ERROR_AT_REST = 0.1, 0.1


@dataclass(frozen=True)
class LinearizedTasks:
    """Linearised model over gait cycles and movements of other tasks ("cycle" means either).

    Parameters
    ----------
    linearized
        Linearised model; its noise is that of the recorded gait, or the expected one.
    groups
        Number of the group of each cycle; cycles of one group repeat each other.
    gait
        Whether each cycle is one of gait.
    measured
        Coordinates of each cycle whose moments are measured.
    moment_size
        Size of the moments of each cycle and coordinate, N m, relative to which smooth errors are.
    trial
        Number of the trial of each cycle that is none of gait.
    angles
        Joint angles, rad.
    """

    linearized: LinearizedModel
    groups: Int[np.ndarray, " cycle"]
    gait: Bool[np.ndarray, " cycle"]
    measured: Bool[np.ndarray, "cycle coordinate"]
    moment_size: Float[np.ndarray, "cycle coordinate"]
    trial: Int[np.ndarray, " cycle"]
    angles: Float[np.ndarray, "cycle coordinate phase"]


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of the errors of a null hypothesis.

    Parameters
    ----------
    force
        Standard deviation of errors of muscle force, in maximum isometric forces.
    repeatable
        Standard deviation of smooth errors that repeat with the movement, relative to the moments.
    by_angle
        Standard deviation of the error by joint angle of tasks other than gait, relative to the moments.
    """

    force: float = EXPECTED_FORCE_ERROR
    repeatable: float = EXPECTED_REPEATABLE_ERROR
    by_angle: float = EXPECTED_ERROR_BY_ANGLE


@dataclass(frozen=True)
class TaskCovariance:
    """Null covariance of some rows as a function of the sizes of errors, (N m)^2.

    Its terms are those of `wrapjax.diagnosis.null_hypotheses.null_covariance`; errors of muscle force in
    tasks other than gait grow with activation.

    Parameters
    ----------
    fixed
        Noise, errors of inputs, calibrated parameters, nuisances and usual amounts of effects.
    force, repeatable, by_angle
        Errors of muscle force, smooth errors that repeat, and errors by joint angle, of size one
        (`ErrorSizes`).
    """

    fixed: Matrix
    force: Matrix
    repeatable: Matrix
    by_angle: Matrix

    @classmethod
    def of(cls, data: LinearizedTasks, rows: Int[np.ndarray, " kept"]) -> TaskCovariance:
        """Compute the terms for these rows, numbered in the order ``cycle coordinate phase``."""
        linearized = data.linearized
        cycle, coordinate, phase = np.unravel_index(rows, linearized.residual.shape)
        blocks = _noise(data)
        for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
            blocks += share**2 * input_blocks(errors)
        fixed = _within_cycles(blocks, rows, cycle)
        for signatures in (linearized.calibrated, linearized.nuisances, _usual_amounts(data)):
            own = signatures.reshape(len(signatures), linearized.residual.size)[:, rows]
            fixed += own.T @ own
        return cls(
            fixed,
            _force_errors(data, cycle, coordinate, phase),
            _smooth_errors(data, cycle, coordinate, phase),
            _errors_by_angle(data, cycle, coordinate, phase),
        )

    def __call__(self, sizes: ErrorSizes) -> Matrix:
        """Compute the covariance for these sizes of errors."""
        return np.asarray(
            self.fixed
            + sizes.force**2 * self.force
            + sizes.repeatable**2 * self.repeatable
            + sizes.by_angle**2 * self.by_angle
        )


def _within_cycles(
    blocks: Float[np.ndarray, "cycle own own"],
    rows: Int[np.ndarray, " kept"],
    cycle: Int[np.ndarray, " kept"],
) -> Matrix:
    """Select the rows of covariances within each cycle, independent between cycles."""
    count = blocks.shape[1]
    total = np.zeros((len(rows), len(rows)))
    for number in np.unique(cycle):
        own = np.flatnonzero(cycle == number)
        places = rows[own] - number * count
        total[np.ix_(own, own)] = blocks[number][np.ix_(places, places)]
    return total


def _noise(data: LinearizedTasks) -> Float[np.ndarray, "cycle own own"]:
    """Compute the covariance of the noise within each cycle.

    The noise of another task is that of gait, inflated, where all coordinates were measured, as by inverse
    dynamics; else that of a dynamometer.
    """
    linearized = data.linearized
    coordinates, phases = linearized.residual.shape[1:]
    of_gait = linearized.noise.block(phases)
    smooth = periodic_kernel(phases, REPEATABLE_WIDTH)
    of_device = DYNAMOMETER_NOISE**2 * np.kron(np.eye(coordinates), smooth)
    # Digits of the device are independent.
    of_device += (0.1 * DYNAMOMETER_NOISE) ** 2 * np.eye(len(of_device))
    complete = np.reshape(data.measured.all(axis=1), (-1, 1, 1))
    of_others = np.where(complete, NOISE_INFLATION**2 * of_gait, of_device)
    return np.where(data.gait[:, None, None], of_gait, of_others)


def _usual_amounts(data: LinearizedTasks) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Compute the signatures of usual amounts of each effect in tasks other than gait, N m.

    In gait the null hypothesis has errors of its own in their place.
    """
    linearized = data.linearized
    others = ~data.gait[:, None, None]
    signatures = [np.zeros((0, *linearized.residual.shape))]
    for one in linearized.candidates:
        sd = USUAL_SHARE * one.prior_sd / np.sqrt(len(one.variants))
        signatures += [
            sd[:, None, None, None] * variant.reshape(-1, *linearized.residual.shape) * others
            for variant in one.variants
        ]
    return np.concatenate(signatures)


def _force_errors(
    data: LinearizedTasks,
    cycle: Int[np.ndarray, " kept"],
    coordinate: Int[np.ndarray, " kept"],
    phase: Int[np.ndarray, " kept"],
) -> Matrix:
    """Compute the covariance by errors of muscle force, which are similar where a muscle's states are."""
    errors = data.linearized.muscle_errors
    total = np.zeros((len(cycle), len(cycle)))
    for states, arms in zip(errors.states, errors.arms, strict=True):
        own = states[cycle, phase]
        activation = STATE_SCALES[0] * own[:, 0]
        active = np.clip(activation / FULL_ERROR_ACTIVATION, ERROR_AT_REST, 1.0)
        arm = np.where(data.gait[cycle], 1.0, active) * arms[cycle, coordinate, phase]
        squares = np.sum(own**2, axis=1)
        distance = np.maximum(squares[:, None] + squares[None] - 2.0 * own @ own.T, 0.0)
        total += np.exp(-0.5 * distance) * np.outer(arm, arm)
    return total


def _smooth_errors(
    data: LinearizedTasks,
    cycle: Int[np.ndarray, " kept"],
    coordinate: Int[np.ndarray, " kept"],
    phase: Int[np.ndarray, " kept"],
) -> Matrix:
    """Compute the covariance of smooth errors that repeat with the movement, relative to the moments."""
    groups, gait = data.groups, data.gait
    same = (groups[:, None] == groups[None]).astype(float)
    same = np.where(gait[:, None] & gait[None], np.maximum(same, ACROSS_SPEEDS), same)
    kernel = periodic_kernel(data.linearized.residual.shape[-1], REPEATABLE_WIDTH)
    size = data.moment_size[cycle, coordinate]
    total = same[np.ix_(cycle, cycle)] * kernel[np.ix_(phase, phase)] * np.outer(size, size)
    return total * (coordinate[:, None] == coordinate[None])


def _errors_by_angle(
    data: LinearizedTasks,
    cycle: Int[np.ndarray, " kept"],
    coordinate: Int[np.ndarray, " kept"],
    phase: Int[np.ndarray, " kept"],
) -> Matrix:
    """Compute the covariance of errors of other tasks that are alike at similar angles of the same trial."""
    own = np.where(data.gait, -1 - np.arange(len(data.gait)), data.trial)[cycle]
    angle, size = data.angles[cycle, coordinate, phase], data.moment_size[cycle, coordinate]
    alike = (own[:, None] == own[None]) & (coordinate[:, None] == coordinate[None]) & ~data.gait[cycle]
    distance = (angle[:, None] - angle[None]) / ANGLE_WIDTH
    return np.where(alike, np.exp(-0.5 * distance**2), 0.0) * np.outer(size, size)
