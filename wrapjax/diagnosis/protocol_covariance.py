"""Null covariance over recorded cycles and candidate trials, with error sizes as expected."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.error_sources import Matrix, block_diagonal, periodic_kernel
from wrapjax.diagnosis.null_covariance import (
    ACROSS_SPEEDS,
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    REPEATABLE_WIDTH,
    input_covariance,
    muscle_covariance,
    parameter_covariance,
)
from wrapjax.diagnosis.protocol_inputs import ProtocolInput

#: Standard deviation of moments of a dynamometer, N m.
DYNAMOMETER_NOISE = 1.0
#: Factor on the cycle noise of gait for a movement that is recorded once or twice.
NOISE_INFLATION = 1.5


def protocol_covariance(data: ProtocolInput) -> Matrix:
    """Compute the null covariance of all rows, with errors of muscle force and smooth errors as expected."""
    linearized = data.linearized
    total = block_diagonal(_noise_blocks(data))
    for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
        total += share**2 * input_covariance(errors)
    for signatures in (linearized.calibrated, linearized.nuisances):
        total += parameter_covariance(signatures, np.ones(len(signatures)))
    total += EXPECTED_FORCE_ERROR**2 * muscle_covariance(linearized.muscle_errors)
    return total + EXPECTED_REPEATABLE_ERROR**2 * _smooth_errors(data)


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
    for gait, complete in zip(data.gait, data.measured.all(axis=1), strict=True):
        blocks.append(of_gait if gait else NOISE_INFLATION**2 * of_gait if complete else of_device)
    return np.stack(blocks)


def _smooth_errors(data: ProtocolInput) -> Matrix:
    """Compute the covariance of smooth errors that repeat with the movement, relative to the moments."""
    phases = data.linearized.residual.shape[-1]
    groups, gait = data.groups, data.gait
    same = (groups[:, None] == groups[None]).astype(float)
    same = np.where(gait[:, None] & gait[None], np.maximum(same, ACROSS_SPEEDS), same)
    size = data.moment_size
    across = np.einsum("cd,ck,dk->ckd", same, size, size)
    cycles, coordinates = size.shape
    total = np.zeros((cycles, coordinates, phases) * 2)
    kernel = periodic_kernel(phases, REPEATABLE_WIDTH)
    for place in range(coordinates):
        total[:, place, :, :, place, :] = across[:, place, None, :, None] * kernel[None, :, None, :]
    return total.reshape(cycles * coordinates * phases, -1)
