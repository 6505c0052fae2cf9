"""Detectability of effects before and after further trials, with all that is uncertain marginalised.

Residuals of recorded and of candidate trials are jointly normal under the null hypothesis: calibrated
parameters, muscle law, nuisances and errors of muscle force are the same in all of them. Conditioning on the
rows that are recorded leaves the covariance and the signatures of the others, so that the value of a trial
follows from its own rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix


@dataclass(frozen=True)
class Design:
    """Information on effect sizes by the recorded rows, and what is left of the rows that are not.

    Columns are the parameters of all variants of all effects, in units of their prior standard deviation.

    Parameters
    ----------
    information
        Signatures times inverse covariance times signatures of the recorded rows.
    covariance, signatures
        Of all rows, given the recorded ones, (N m)^2 and N m.
    """

    information: Float[np.ndarray, "column column"]
    covariance: Matrix
    signatures: Float[np.ndarray, "row column"]

    @classmethod
    def of_effects(
        cls,
        candidates: Sequence[Candidate],
        covariance: Matrix,
        rows: Int[np.ndarray, " row"] | None = None,
    ) -> Design:
        """Start with no recorded rows; ``rows`` are those of the signatures that count, all if None."""
        columns = [
            (variant if rows is None else variant[:, rows]) * candidate.prior_sd[:, None]
            for candidate in candidates
            for variant in candidate.variants
        ]
        signatures = np.concatenate(columns).T
        return cls(np.zeros((signatures.shape[1],) * 2), covariance, signatures)

    def information_with(self, rows: Int[np.ndarray, " own"]) -> Float[np.ndarray, "column column"]:
        """Compute the information by the recorded rows and these."""
        white, _ = self._white(rows)
        return np.asarray(self.information + white.T @ white)

    def recorded(self, rows: Int[np.ndarray, " own"]) -> Design:
        """Record these rows."""
        if not len(rows):
            return self
        white, factor = self._white(rows)
        across = scipy.linalg.solve_triangular(factor, self.covariance[rows], lower=True, check_finite=False)
        return replace(
            self,
            information=self.information + white.T @ white,
            covariance=self.covariance - across.T @ across,
            signatures=self.signatures - across.T @ white,
        )

    def of_rows(self, rows: Int[np.ndarray, " kept"]) -> Design:
        """Keep some of the rows."""
        return replace(self, covariance=self.covariance[np.ix_(rows, rows)], signatures=self.signatures[rows])

    def _white(self, rows: Int[np.ndarray, " own"]) -> tuple[np.ndarray, np.ndarray]:
        own = self.covariance[np.ix_(rows, rows)]
        # Rounding must not make it indefinite where earlier rows tell all of these.
        own = own + 1e-9 * np.trace(own) / max(len(rows), 1) * np.eye(len(rows))
        factor = scipy.linalg.cholesky(own, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(factor, self.signatures[rows], lower=True, check_finite=False)
        return white, factor


@dataclass(frozen=True)
class Detection:
    """How well effects of their prior size can be detected and distinguished.

    Parameters
    ----------
    detectability
        Signal-to-noise ratio d' of each effect: that of the most visible parameter of any variant.
    apart
        Squared distance of each effect (row) from no effect where another one (column) is allowed for with
        its prior, in squared standard deviations. On the diagonal, the square of the detectability.
    """

    detectability: Float[np.ndarray, " effect"]
    apart: Float[np.ndarray, "effect effect"]

    @property
    def expected_evidence(self) -> Float[np.ndarray, " effect"]:
        """Expected log Bayes factor of each effect against none where it is present, nats.

        Its size is drawn from the prior: ``(d'^2 - log(1 + d'^2)) / 2``.
        """
        square = self.detectability**2
        return np.asarray(0.5 * (square - np.log1p(square)))

    def tied(self, least: float, visible: float) -> Bool[np.ndarray, "effect effect"]:
        """Mark pairs of visible effects that are nearer than ``least`` to each other, both ways."""
        farther = np.maximum(self.apart, self.apart.T)
        seen = self.detectability >= visible
        pairs = (farther < least) & seen[:, None] & seen[None]
        np.fill_diagonal(pairs, False)
        return np.asarray(pairs)


def detection(
    information: Float[np.ndarray, "column column"], candidates: Sequence[Candidate], *, pairs: bool = True
) -> Detection:
    """Compute how well effects can be detected and distinguished.

    Parameters
    ----------
    information
        Information in units of the prior standard deviations, see `Design`.
    candidates
        Effects, whose variants have the columns.
    pairs
        Whether to compare effects with each other; if not, distances between them are zero.
    """
    diagonal = np.diag(information)
    strongest, spans, first = [], [], 0
    for candidate in candidates:
        count = len(candidate.prior_sd)
        own = diagonal[first : first + count * len(candidate.variants)]
        place = int(np.argmax(own))
        strongest.append(first + place)
        start = first + place // count * count
        spans.append(np.arange(start, start + count))
        first += len(own)
    at = np.array(strongest, dtype=int)
    square = np.maximum(diagonal[at], 0.0)
    apart = np.zeros((len(at), len(at)))
    for column, span in enumerate(spans if pairs else ()):
        precision = information[np.ix_(span, span)] + np.eye(len(span))
        factor = scipy.linalg.cholesky(precision, lower=True, check_finite=False)
        shared = scipy.linalg.solve_triangular(
            factor, information[np.ix_(span, at)], lower=True, check_finite=False
        )
        apart[:, column] = np.maximum(square - np.sum(shared**2, axis=0), 0.0)
    apart[np.diag_indices(len(at))] = square
    return Detection(np.sqrt(square), apart)


def information_gain(
    detected: Detection, weights: Float[np.ndarray, " effect"], rivals: Float[np.ndarray, "effect effect"]
) -> float:
    """Compute the expected information on which effect is present, and on its size, nats.

    Parameters
    ----------
    detected
        How well the effects can be detected and distinguished.
    weights
        Probability of each effect, of those that are undecided.
    rivals
        Probability of each rival (column) of each effect (row); on the diagonal, that of no effect.

    Returns
    -------
    float
        Mean of ``log(1 + D) / 2`` over effects and rivals, with D the squared distance of both: it grows with
        the logarithm of the distance, so that what is seen already does not count again.
    """
    return float(weights @ np.sum(rivals * 0.5 * np.log1p(detected.apart), axis=1))
