"""Null hypotheses of a contrast of two conditions, given the mean of both.

Errors of the person's parameters cancel only as far as the conditions have the same EMG and motion. What is
left of them is correlated with the mean of both conditions, and with calibrated parameters as uncertain as
their priors it can be larger than cycle noise. The contrast is therefore tested given that mean: with r_d and
r_m the contrast and the mean, V_dd, V_dm and V_mm their covariances under the null hypothesis, and J_d and
J_m an effect's signatures, r_d - G r_m has the covariance V_dd - G V_md and the signatures J_d - G J_m, where
G = V_dm V_mm^-1 (conditional normal distribution).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Float

from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import Score, ScoreTest, project, score_projected
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix, input_blocks, periodic_kernel
from wrapjax.diagnosis.null_hypotheses.null_covariance import (
    ACROSS_SPEEDS,
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    FORCE_ERRORS,
    REPEATABLE_ERRORS,
    REPEATABLE_WIDTH,
    Null,
    muscle_covariance,
)

#: Sizes of smooth repeatable errors that are tried, relative to the standard deviation of the measured
#: moment, and their correlations between the conditions. What a model lacks of a recorded person can be far
#: larger than the nulls of a single recording allow for, and would count as knowledge of the parameters; how
#: much of it differs between the conditions is unknown.
COMMON_ERRORS = tuple(
    (error, across)
    for error in (*REPEATABLE_ERRORS, 0.3)
    for across in (0.95, 0.995)
    if error > 0.0 or across == 0.95
)


def weighted_sums(
    rows: Float[np.ndarray, "sum cycle"], values: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*sums"]:
    """Compute weighted sums over the cycles of values with the axes ``cycle coordinate phase`` last."""
    return np.asarray(np.einsum("sc,...ckp->...skp", rows, values))


def with_means(rows: Float[np.ndarray, "speed cycle"]) -> Float[np.ndarray, "sum cycle"]:
    """Add the weights of the mean of both conditions at each speed to those of the contrasts."""
    return np.concatenate([rows, 0.5 * np.abs(rows)])


@dataclass(frozen=True)
class GivenMeans:
    """One null hypothesis of a contrast, given the mean of both conditions.

    Parameters
    ----------
    null
        Covariance of the contrast; the log probability includes that of the mean.
    samples
        The contrast less what the mean predicts of it, and reassigned contrasts, N m.
    candidates
        Candidates with the signatures that the mean leaves.
    """

    null: Null
    samples: Float[np.ndarray, "sample row"]
    candidates: tuple[Candidate, ...]


class ContrastNulls:
    """Null hypotheses of every contrast of the same cycles, by the sizes of unexplained errors.

    Parameters
    ----------
    linearized
        Linearised model over the cycles of both conditions, whose groups are speeds within conditions.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate, N m.
    """

    def __init__(self, linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]):
        cycles, coordinates, self.phases = linearized.residual.shape
        self.linearized = linearized
        self.own = coordinates * self.phases
        self.by_force = muscle_covariance(linearized.muscle_errors).reshape(
            cycles, self.own, cycles, self.own
        )
        self.sd = np.asarray(measured_moment_sd, dtype=float)

    def score(
        self,
        rows: Float[np.ndarray, "speed cycle"],
        residual: Float[np.ndarray, " row"],
        reassigned: Float[np.ndarray, "reassignment contrast_row"],
        candidates: tuple[Candidate, ...],
    ) -> tuple[tuple[ScoreTest, ...], list[GivenMeans]]:
        """Score every candidate on a contrast and on reassigned ones.

        ``residual`` and the candidates have the rows of the contrasts, then of the means.
        """
        given = list(self._given_means(rows, residual, reassigned, candidates))
        projections = [project(one.samples, one.null, one.candidates) for one in given]
        return score_projected(projections, candidates), given

    def _given_means(
        self,
        rows: Float[np.ndarray, "speed cycle"],
        residual: Float[np.ndarray, " row"],
        reassigned: Float[np.ndarray, "reassignment contrast_row"],
        candidates: tuple[Candidate, ...],
    ) -> Iterator[GivenMeans]:
        size = len(rows) * self.own
        for null in self._nulls(rows):
            of_contrast, across = null.covariance[:size, :size], null.covariance[size:, :size]
            factor = scipy.linalg.cholesky(null.covariance[size:, size:], lower=True, check_finite=False)
            gain = scipy.linalg.cho_solve((factor, True), across, check_finite=False).T
            white = scipy.linalg.solve_triangular(factor, residual[size:], lower=True, check_finite=False)
            of_mean = -0.5 * float(white @ white) - float(np.sum(np.log(np.diag(factor))))
            conditional = _regular(of_contrast - gain @ across)
            yield GivenMeans(
                Null(conditional, null.log_prior + of_mean),
                np.vstack([residual[:size] - gain @ residual[size:], reassigned]),
                tuple(
                    replace(
                        one, variants=tuple(each[:, :size] - each[:, size:] @ gain.T for each in one.variants)
                    )
                    for one in candidates
                ),
            )

    def _nulls(self, rows: Float[np.ndarray, "speed cycle"]) -> Iterator[Null]:
        """Compute the covariance of contrasts and means by each null hypothesis."""
        both = with_means(rows)
        size = len(both) * self.own
        fixed = self._fixed(both)
        by_force = np.einsum("sc,ckdl,td->sktl", both, self.by_force, both, optimize=True).reshape(size, size)
        for force, (error, across) in product(FORCE_ERRORS, COMMON_ERRORS):
            log_prior = -force / EXPECTED_FORCE_ERROR - error / EXPECTED_REPEATABLE_ERROR
            total = fixed + force**2 * by_force + error**2 * self._repeatable(rows, across)
            yield Null(_regular(total), log_prior)

    def _fixed(self, both: Float[np.ndarray, "sum cycle"]) -> Matrix:
        """Compute the terms that are part of every null, as `fixed_covariance` does for single cycles."""
        linearized = self.linearized
        noise = linearized.noise
        total = np.kron(both @ both.T, noise.block(self.phases))
        for share, errors in zip(noise.input_shares, linearized.input_errors, strict=True):
            blocks = np.einsum("sc,ckl,tc->sktl", both, input_blocks(errors), both, optimize=True)
            total += share**2 * blocks.reshape(total.shape)
        for signatures in (linearized.calibrated, linearized.nuisances):
            columns = weighted_sums(both, signatures).reshape(len(signatures), len(total))
            total += columns.T @ columns
        return total

    def _repeatable(self, rows: Float[np.ndarray, "speed cycle"], across: float) -> Matrix:
        """Compute the covariance of contrasts and means by a smooth error, nearly the same in both."""
        kernel = np.kron(np.diag(self.sd**2), periodic_kernel(self.phases, REPEATABLE_WIDTH))
        own = np.eye(len(rows))
        speeds = own + ACROSS_SPEEDS * (1.0 - own)
        of_contrast, of_mean = 2.0 * (1.0 - across), 0.5 * (1.0 + across)
        return np.kron(np.kron(np.diag([of_contrast, of_mean]), speeds), kernel)


def _regular(covariance: Matrix) -> Matrix:
    """Keep rounding from making a covariance indefinite where little is left of the common errors."""
    symmetric = 0.5 * (covariance + covariance.T)
    return symmetric + 1e-9 * np.trace(symmetric) / len(symmetric) * np.eye(len(symmetric))


def remaining_after(
    given: Sequence[GivenMeans], place: int, score: Score | None
) -> Float[np.ndarray, " sample"]:
    """Compute the mean square of each sample without an effect, in variances of the null hypothesis.

    Without a score, of the sample itself. The null hypothesis is the most probable one with the effect.
    """
    found = []
    for one in given:
        covariance = one.null.covariance
        if score is not None:
            candidate, columns = one.candidates[place], np.array(score.part)
            signatures = candidate.variants[score.variant][columns]
            signatures = signatures * candidate.scaled_prior_sd(score.prior_factor)[columns, None]
            covariance = covariance + signatures.T @ signatures
        factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(factor, one.samples.T, lower=True, check_finite=False)
        squares = np.mean(white**2, axis=0)
        probability = one.null.log_prior - 0.5 * len(white) * squares[0] - np.sum(np.log(np.diag(factor)))
        found.append((float(probability), squares))
    return max(found, key=lambda one: one[0])[1]
