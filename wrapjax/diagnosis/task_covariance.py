"""Null covariance over some rows of gait cycles and of other tasks.

Of most tasks other than gait one coordinate is measured, so that the covariance of all rows would be several
times as large as that of the rows that count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.error_sources import STATE_SCALES, Matrix, input_blocks, periodic_kernel
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import (
    ACROSS_SPEEDS,
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    REPEATABLE_WIDTH,
)

#: Standard deviation of moments of a dynamometer, N m.
DYNAMOMETER_NOISE = 1.0
#: Factor on the cycle noise of gait for a movement that is recorded once or twice.
NOISE_INFLATION = 1.5
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
    """

    linearized: LinearizedModel
    groups: Int[np.ndarray, " cycle"]
    gait: Bool[np.ndarray, " cycle"]
    measured: Bool[np.ndarray, "cycle coordinate"]
    moment_size: Float[np.ndarray, "cycle coordinate"]


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of the errors of a null hypothesis.

    Parameters
    ----------
    force
        Standard deviation of errors of muscle force, in maximum isometric forces.
    repeatable
        Standard deviation of smooth errors that repeat with the movement, relative to the moments.
    other_noise
        Factor on the noise of tasks other than gait.
    """

    force: float = EXPECTED_FORCE_ERROR
    repeatable: float = EXPECTED_REPEATABLE_ERROR
    other_noise: float = 1.0


@dataclass(frozen=True)
class TaskCovariance:
    """Null covariance of some rows as a function of the sizes of errors, (N m)^2.

    Its terms are those of `wrapjax.diagnosis.null_covariance`; errors of muscle force in tasks other than
    gait grow with activation.

    Parameters
    ----------
    fixed
        Noise of gait, errors of inputs, calibrated parameters and nuisances.
    other_noise
        Noise of tasks other than gait.
    force, repeatable
        Errors of muscle force, and smooth errors that repeat, of size one (`ErrorSizes`).
    """

    fixed: Matrix
    other_noise: Matrix
    force: Matrix
    repeatable: Matrix

    @classmethod
    def of(cls, data: LinearizedTasks, rows: Int[np.ndarray, " kept"]) -> TaskCovariance:
        """Compute the terms for these rows, numbered in the order ``cycle coordinate phase``."""
        linearized = data.linearized
        cycle, coordinate, phase = np.unravel_index(rows, linearized.residual.shape)
        of_gait, of_others = _noise(data)
        inputs = np.zeros_like(of_gait)
        for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
            inputs += share**2 * input_blocks(errors)
        fixed = _within_cycles(of_gait + inputs, rows, cycle)
        for signatures in (linearized.calibrated, linearized.nuisances):
            own = signatures.reshape(len(signatures), -1)[:, rows]
            fixed += own.T @ own
        return cls(
            fixed,
            _within_cycles(of_others, rows, cycle),
            _force_errors(data, cycle, coordinate, phase),
            _smooth_errors(data, cycle, coordinate, phase),
        )

    def __call__(self, sizes: ErrorSizes) -> Matrix:
        """Compute the covariance for these sizes of errors."""
        return np.asarray(
            self.fixed
            + sizes.other_noise**2 * self.other_noise
            + sizes.force**2 * self.force
            + sizes.repeatable**2 * self.repeatable
        )


def measured_rows(data: LinearizedTasks) -> Int[np.ndarray, " kept"]:
    """Return the numbers of the measured rows, in the order ``cycle coordinate phase``."""
    phases = data.linearized.residual.shape[-1]
    return np.flatnonzero(np.repeat(data.measured.ravel(), phases))


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


def _noise(
    data: LinearizedTasks,
) -> tuple[Float[np.ndarray, "cycle own own"], Float[np.ndarray, "cycle own own"]]:
    """Compute the covariance of the noise within each cycle: of gait, and of the other tasks.

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
    gait = data.gait[:, None, None]
    return np.where(gait, of_gait, 0.0), np.where(gait, 0.0, of_others)


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
