"""The null hypotheses that effects are scored against, of several strengths of what cannot be named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null_covariance import (
    Matrix,
    input_covariance,
    muscle_covariance,
    parameter_covariance,
    repeated_covariance,
)
from wrapjax.diagnosis.projection import Null
from wrapjax.diagnosis.score import Scored

#: Errors of muscle force that depend on the muscle's state, in maximum isometric forces; and what is
#: expected of them. No model of a muscle is without: these take up what other curves and another activation
#: leave in everyone, which an error that is free to be anywhere would cost more to allow for.
FORCE_ERRORS, EXPECTED_FORCE_ERROR = (0.005, 0.01, 0.02, 0.04), 0.02
#: Smooth errors that repeat and that no mechanism is known for, in parts of how far the measured moment of a
#: coordinate goes from its mean; and what is expected of them.
REPEATED_ERRORS, EXPECTED_REPEATED_ERROR = (0.0, 0.03, 0.1), 0.02


def nulls(gap: LinearizedModel, sizes: Sequence[float] | np.ndarray) -> Iterator[Null]:
    """Build null covariances over a grid of the strengths that nobody knows beforehand, one after the other.

    Parameters
    ----------
    gap
        The straight lines of a calibrated model.
    sizes
        Standard deviation of the measured moment of each coordinate over the gait cycle, N m.
    """
    phases = gap.residual.shape[-1]
    known = known_covariance(gap)
    by_force = muscle_covariance(gap.muscle_errors)
    repeated = repeated_covariance(np.asarray(sizes, dtype=float), gap.speeds, phases)
    for force, offset in product(FORCE_ERRORS, REPEATED_ERRORS):
        # Exponential: the stronger, the less plausible.
        log_prior = -force / EXPECTED_FORCE_ERROR - offset / EXPECTED_REPEATED_ERROR
        yield Null(known + force**2 * by_force + offset**2 * repeated, log_prior)


def known_covariance(gap: LinearizedModel) -> Matrix:
    """Sum what is always there: noise, errors of inputs, calibrated parameters and nuisances."""
    cycles, _, phases = gap.residual.shape
    total = gap.noise.covariance(cycles, phases)
    for share, errors in zip(gap.noise.input_shares, gap.input_errors, strict=True):
        total += share**2 * input_covariance(errors)
    for signatures in (gap.calibrated, gap.nuisances):
        total += parameter_covariance(signatures, np.ones(len(signatures)))
    return total


def best_null(gap: LinearizedModel, sizes: Sequence[float] | np.ndarray, found: Scored) -> Null:
    """Build the null that residuals speak for."""
    wanted = int(np.argmax(found.plausible))
    return next(null for place, null in enumerate(nulls(gap, sizes)) if place == wanted)
