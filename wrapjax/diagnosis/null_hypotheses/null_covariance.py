"""Null hypotheses: covariances of the residual without any effect of the catalogue.

A residual is not white noise. It is correlated over the phases of a cycle; errors of EMG and angles change
all joint moments at once; calibrated parameters have adapted to it; the muscle curves of a person differ from
Hill's; and there is a smooth repeatable error of unknown cause. Effects must be significant against all of
these: where a term is missing, effects that resemble it are found in every recording.

Rows are ordered ``cycle coordinate phase``, the last running fastest. All matrices are in (N m)^2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.null_hypotheses.error_sources import (
    InputErrors,
    Matrix,
    MuscleErrors,
    block_diagonal,
    input_blocks,
    periodic_kernel,
)

#: Correlation width of the smooth repeatable error, in gait cycles.
REPEATABLE_WIDTH = 0.05
#: Correlation of the repeatable error between two speeds.
ACROSS_SPEEDS = 0.7
#: Standard deviations of errors of muscle force that depend on the muscle's state, in maximum isometric
#: forces, and their prior mean. No muscle model is without such errors: they take up what other curves and
#: another activation leave in every recording, at a lower cost in power than an unstructured error.
FORCE_ERRORS, EXPECTED_FORCE_ERROR = (0.005, 0.01, 0.02, 0.04), 0.02
#: Standard deviations of smooth repeatable errors of unknown cause, relative to the standard deviation of the
#: measured moment of a coordinate, and their prior mean.
REPEATABLE_ERRORS, EXPECTED_REPEATABLE_ERROR = (0.0, 0.03, 0.1), 0.02

Signatures = Float[np.ndarray, "parameter cycle coordinate phase"]


@dataclass(frozen=True)
class Null:
    """One null hypothesis: a covariance of the residual, and the logarithm of its prior probability."""

    covariance: Matrix
    log_prior: float = 0.0


def nulls(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]
) -> Iterator[Null]:
    """Compute null covariances over a grid of the unknown error sizes, one after the other.

    Parameters
    ----------
    linearized
        Linearised model.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate over the gait cycle, N m.
    """
    phases = linearized.residual.shape[-1]
    fixed = fixed_covariance(linearized)
    by_force = muscle_covariance(linearized.muscle_errors)
    repeatable = repeatable_covariance(np.asarray(measured_moment_sd, dtype=float), linearized.speeds, phases)
    for force, error in product(FORCE_ERRORS, REPEATABLE_ERRORS):
        # Exponential priors: larger errors are less plausible.
        log_prior = -force / EXPECTED_FORCE_ERROR - error / EXPECTED_REPEATABLE_ERROR
        yield Null(fixed + force**2 * by_force + error**2 * repeatable, log_prior)


def fixed_covariance(linearized: LinearizedModel) -> Matrix:
    """Sum the terms that are part of every null: noise, input errors, calibrated parameters and nuisances."""
    cycles, _, phases = linearized.residual.shape
    total = linearized.noise.covariance(cycles, phases)
    for share, errors in zip(linearized.noise.input_shares, linearized.input_errors, strict=True):
        total += share**2 * input_covariance(errors)
    for signatures in (linearized.calibrated, linearized.nuisances):
        total += parameter_covariance(signatures, np.ones(len(signatures)))
    return total


def input_covariance(errors: InputErrors) -> Matrix:
    """Compute the covariance of all cycles by errors of inputs."""
    return block_diagonal(input_blocks(errors))


def parameter_covariance(signatures: Signatures, prior_sd: Float[np.ndarray, " parameter"]) -> Matrix:
    """Compute the covariance by parameters with these prior standard deviations, the same in all cycles."""
    rows = math.prod(signatures.shape[1:])
    columns = (signatures * prior_sd[:, None, None, None]).reshape(len(prior_sd), rows)
    return columns.T @ columns


def muscle_covariance(errors: MuscleErrors) -> Matrix:
    """Compute the covariance by errors of muscle force, which are similar where a muscle's states are."""
    _, cycles, coordinates, phases = errors.arms.shape
    total = np.zeros((cycles * coordinates * phases,) * 2)
    for states, arms in zip(errors.states, errors.arms, strict=True):
        rows = states.reshape(cycles * phases, -1)
        squares = np.sum(rows**2, axis=1)
        distance = np.maximum(squares[:, None] + squares[None] - 2.0 * rows @ rows.T, 0.0)
        similar = np.exp(-0.5 * distance).reshape(cycles, phases, cycles, phases)
        spread = np.broadcast_to(similar[:, None, :, :, None, :], (cycles, coordinates, phases) * 2)
        total += spread.reshape(total.shape) * np.outer(arms.ravel(), arms.ravel())
    return total


def repeatable_covariance(
    sd: Float[np.ndarray, " coordinate"], speeds: Int[np.ndarray, " cycle"], phases: int
) -> Matrix:
    """Compute the covariance of a smooth error that repeats in all cycles of a speed, and partly at others.

    Parameters
    ----------
    sd
        Standard deviation of the error at each coordinate, N m.
    speeds
        Speed number of each cycle, counted from 0.
    phases
        Number of phases of a cycle.
    """
    same = np.where(speeds[:, None] == speeds[None], 1.0, ACROSS_SPEEDS)
    return np.kron(same, np.kron(np.diag(sd**2), periodic_kernel(phases, REPEATABLE_WIDTH)))
