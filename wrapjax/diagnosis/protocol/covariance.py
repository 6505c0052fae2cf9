"""Null covariance over the measured rows of recorded cycles and candidate trials, error sizes as expected.

Of most candidate trials one coordinate is measured, so that the covariance of all rows would be several times
as large as that of the rows that count.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.error_sources import Matrix, input_blocks, periodic_kernel
from wrapjax.diagnosis.null_covariance import (
    ACROSS_SPEEDS,
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    REPEATABLE_WIDTH,
)
from wrapjax.diagnosis.protocol.inputs import ProtocolInput

#: Standard deviation of moments of a dynamometer, N m.
DYNAMOMETER_NOISE = 1.0
#: Factor on the cycle noise of gait for a movement that is recorded once or twice.
NOISE_INFLATION = 1.5


def measured_rows(data: ProtocolInput) -> Int[np.ndarray, " kept"]:
    """Return the numbers of the measured rows, in the order ``cycle coordinate phase``."""
    phases = data.linearized.residual.shape[-1]
    return np.flatnonzero(np.repeat(data.measured.ravel(), phases))


def protocol_covariance(data: ProtocolInput, rows: Int[np.ndarray, " kept"]) -> Matrix:
    """Compute the null covariance of some rows, (N m)^2.

    Its terms are those of `wrapjax.diagnosis.null_covariance`, with errors of muscle force and smooth errors
    of their expected sizes.

    Parameters
    ----------
    data
        Linearised model over recorded cycles and candidate trials.
    rows
        Numbers of the rows.
    """
    linearized = data.linearized
    cycle, coordinate, phase = np.unravel_index(rows, linearized.residual.shape)
    total = _within_cycles(data, rows, cycle)
    for signatures in (linearized.calibrated, linearized.nuisances):
        own = signatures.reshape(len(signatures), -1)[:, rows]
        total += own.T @ own
    total += EXPECTED_FORCE_ERROR**2 * _force_errors(data, cycle, coordinate, phase)
    return total + EXPECTED_REPEATABLE_ERROR**2 * _smooth_errors(data, cycle, coordinate, phase)


def _within_cycles(
    data: ProtocolInput, rows: Int[np.ndarray, " kept"], cycle: Int[np.ndarray, " kept"]
) -> Matrix:
    """Compute the covariance by noise and by errors of EMG and angles, independent between cycles."""
    linearized = data.linearized
    count = linearized.residual[0].size
    blocks = _noise_blocks(data)
    for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
        blocks = blocks + share**2 * input_blocks(errors)
    total = np.zeros((len(rows), len(rows)))
    for number in np.unique(cycle):
        own = np.flatnonzero(cycle == number)
        places = rows[own] - number * count
        total[np.ix_(own, own)] = blocks[number][np.ix_(places, places)]
    return total


def _noise_blocks(data: ProtocolInput) -> Float[np.ndarray, "cycle own own"]:
    """Compute the covariance of the noise within each cycle: that of gait, or of a dynamometer."""
    linearized = data.linearized
    coordinates, phases = linearized.residual.shape[1:]
    of_gait = linearized.noise.block(phases)
    smooth = periodic_kernel(phases, REPEATABLE_WIDTH)
    of_device = DYNAMOMETER_NOISE**2 * np.kron(np.eye(coordinates), smooth)
    # Digits of the device are independent.
    of_device += (0.1 * DYNAMOMETER_NOISE) ** 2 * np.eye(len(of_device))
    blocks = []
    for gait, measured in zip(data.gait, data.measured, strict=True):
        complete = bool(measured.all())
        blocks.append(of_gait if gait else NOISE_INFLATION**2 * of_gait if complete else of_device)
    return np.stack(blocks)


def _force_errors(
    data: ProtocolInput,
    cycle: Int[np.ndarray, " kept"],
    coordinate: Int[np.ndarray, " kept"],
    phase: Int[np.ndarray, " kept"],
) -> Matrix:
    """Compute the covariance by errors of muscle force, which are similar where a muscle's states are."""
    errors = data.linearized.muscle_errors
    total = np.zeros((len(cycle), len(cycle)))
    for states, arms in zip(errors.states, errors.arms, strict=True):
        own, arm = states[cycle, phase], arms[cycle, coordinate, phase]
        squares = np.sum(own**2, axis=1)
        distance = np.maximum(squares[:, None] + squares[None] - 2.0 * own @ own.T, 0.0)
        total += np.exp(-0.5 * distance) * np.outer(arm, arm)
    return total


def _smooth_errors(
    data: ProtocolInput,
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
