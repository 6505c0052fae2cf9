"""Score test: log Bayes factor of each effect against no effect, without refitting.

With residuals r of null covariance V, an effect's signatures J and the prior N(0, T) of its sizes,
s = J'V^-1 r and I = J'V^-1 J give the posterior mean of the sizes, (I + T^-1)^-1 s, and the log Bayes factor
of the effect against no effect. It is a modification index with a prior for plausible sizes and a penalty for
flexibility.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int
from scipy.special import log_ndtr, logsumexp

from wrapjax.diagnosis.evidence.linearization import Candidate
from wrapjax.diagnosis.null_hypotheses.error_sources import Matrix
from wrapjax.diagnosis.null_hypotheses.null_covariance import Null

#: Factors on the prior standard deviation that are tried, as an effect can be smaller or larger than
#: expected: all its parameters share one factor, within their limits.
PRIOR_FACTORS = (0.1, 0.3, 1.0, 3.0)
#: Detectability below which a recording cannot show an effect.
MIN_DETECTABILITY = 2.0


@dataclass(frozen=True)
class Projection:
    """Projection of residuals and signatures by one null hypothesis: sufficient for a score test.

    Columns are the parameters of all variants of all candidates, one after the other.

    Parameters
    ----------
    weight
        Log posterior probability of the null given each residual, up to a constant.
    slope, information
        s and I; see the module.
    """

    weight: Float[np.ndarray, " sample"]
    slope: Float[np.ndarray, "sample column"]
    information: Float[np.ndarray, "column column"]

    def allowing(self, sd: Float[np.ndarray, " column"]) -> Projection:
        """Add parameters with these standard deviations to the null (Woodbury's identity)."""
        added = np.flatnonzero(sd)
        root = self.information[:, added] * sd[added]
        inner = np.eye(len(added)) + sd[added, None] * root[added]
        factor = scipy.linalg.cholesky(inner, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(
            factor, np.vstack([root, self.slope[:, added] * sd[added]]).T, lower=True, check_finite=False
        ).T
        of_columns, of_samples = np.split(white, [len(root)])
        return Projection(
            self.weight + 0.5 * np.sum(of_samples**2, axis=1) - np.sum(np.log(np.diag(factor))),
            self.slope - of_samples @ of_columns.T,
            self.information - of_columns @ of_columns.T,
        )


def project(
    residuals: Float[np.ndarray, "sample row"], null: Null, candidates: Sequence[Candidate]
) -> Projection:
    """Project residuals and signatures by a null covariance."""
    variants = [signature for candidate in candidates for signature in candidate.variants]
    stacked = np.concatenate([*variants, np.zeros((0, residuals.shape[1]))])
    factor = scipy.linalg.cholesky(null.covariance, lower=True, check_finite=False)
    white_residuals = scipy.linalg.solve_triangular(factor, residuals.T, lower=True, check_finite=False)
    # All signatures at once: one by one, each would wait for the factor to be read from memory.
    white_signatures = scipy.linalg.solve_triangular(factor, stacked.T, lower=True, check_finite=False)
    weight = null.log_prior - 0.5 * np.sum(white_residuals**2, axis=0) - np.sum(np.log(np.diag(factor)))
    return Projection(weight, white_residuals.T @ white_signatures, white_signatures.T @ white_signatures)


@dataclass(frozen=True)
class Score:
    """Score test of one effect.

    Parameters
    ----------
    id
        Identifier of the effect.
    evidence
        Log Bayes factor of the effect against no effect, nats.
    variant, part, prior_factor
        Most plausible hypothesis: number of the variant, numbers of the parameters that are not zero, and
        factor on the prior standard deviations.
    effect_sizes, sd
        Posterior mean and standard deviation of the parameters under that hypothesis, in their units.
    detectability
        Signal-to-noise ratio of an effect of its prior size, d'; below 2 the recording cannot show it.
    """

    id: str
    evidence: float
    variant: int
    part: tuple[int, ...]
    prior_factor: float
    effect_sizes: Float[np.ndarray, " parameter"]
    sd: Float[np.ndarray, " parameter"]
    detectability: float

    @property
    def detectable(self) -> bool:
        """Whether the recording could show the effect at the largest size that is tried."""
        return max(PRIOR_FACTORS) * self.detectability >= MIN_DETECTABILITY


@dataclass(frozen=True)
class ScoreTest:
    """Score test of all candidates on one residual.

    Parameters
    ----------
    scores
        Score of each candidate, in their order.
    null_weights
        Log posterior probability of each null without any effect, up to a constant.
    """

    scores: tuple[Score, ...]
    null_weights: Float[np.ndarray, " null"]


def score_each(
    residuals: Float[np.ndarray, "sample row"], nulls: Iterable[Null], candidates: Sequence[Candidate]
) -> tuple[ScoreTest, ...]:
    """Score every candidate on several residuals that share the null hypotheses.

    Each hypothesis is averaged over the nulls by itself: an effect that explains the residual gets the
    evidence of a null with smaller unexplained errors.

    Parameters
    ----------
    residuals
        Residuals at the prior mean of the calibrated variables, whose deviation is part of the nulls, N m.
    nulls
        Null hypotheses with different sizes of the unexplained errors.
    candidates
        Effects, in any order.
    """
    return score_projected([project(residuals, null, candidates) for null in nulls], candidates)


def score_projected(
    projections: Sequence[Projection], candidates: Sequence[Candidate]
) -> tuple[ScoreTest, ...]:
    """Score every candidate from the projections by all nulls; see `score_each`."""
    by_null = [_score_against(one, candidates) for one in projections]
    null_weights = np.array([one.weight for one in projections])
    without_effect = logsumexp(null_weights, axis=0)
    tests = []
    for sample in range(null_weights.shape[1]):
        scores = []
        for number, candidate in enumerate(candidates):
            tested = [one_null[number] for one_null in by_null]
            joint = null_weights[:, sample] + [one_null.evidence[sample] for one_null in tested]
            best = tested[int(np.argmax(joint))]
            hypothesis = best.hypotheses[int(best.best[sample])]
            # Detectability is that under the most plausible null without any effect.
            detectability = tested[int(np.argmax(null_weights[:, sample]))].detectability
            scores.append(
                Score(
                    candidate.id,
                    float(logsumexp(joint) - without_effect[sample]),
                    hypothesis.variant,
                    hypothesis.part,
                    hypothesis.prior_factor,
                    hypothesis.effect_sizes[sample],
                    hypothesis.sd,
                    detectability,
                )
            )
        tests.append(ScoreTest(tuple(scores), null_weights[:, sample]))
    return tuple(tests)


@dataclass(frozen=True)
class _Hypothesis:
    variant: int
    part: tuple[int, ...]
    prior_factor: float
    evidence: Float[np.ndarray, " sample"]
    #: Zero outside the part.
    effect_sizes: Float[np.ndarray, "sample parameter"]
    sd: Float[np.ndarray, " parameter"]
    detectability: float
    log_prior: float


@dataclass(frozen=True)
class _Tested:
    hypotheses: tuple[_Hypothesis, ...]
    evidence: Float[np.ndarray, " sample"]
    #: Number of the most plausible hypothesis.
    best: Int[np.ndarray, " sample"]

    @property
    def detectability(self) -> float:
        return max(one.detectability for one in self.hypotheses)


def _score_against(projection: Projection, candidates: Sequence[Candidate]) -> list[_Tested]:
    """Score all candidates against one null."""
    tested, first = [], 0
    for candidate in candidates:
        variants = []
        for _ in candidate.variants:
            columns = slice(first, first := first + len(candidate.prior_sd))
            variants.append((projection.slope[:, columns], projection.information[columns, columns]))
        tested.append(_score_candidate(variants, candidate))
    return tested


def _score_candidate(
    variants: Sequence[
        tuple[Float[np.ndarray, "sample parameter"], Float[np.ndarray, "parameter parameter"]]
    ],
    candidate: Candidate,
) -> _Tested:
    """Score one candidate from s and I of its variants, which have equal prior probabilities."""
    hypotheses = []
    limit = np.broadcast_to(candidate.limit, candidate.prior_sd.shape)
    for variant, (slope, information) in enumerate(variants):
        for (part, share), factor in product(candidate.hypotheses, PRIOR_FACTORS):
            columns = np.array(part)
            evidence, part_sizes, part_sd, detectability = effect_evidence(
                slope[:, columns],
                information[np.ix_(columns, columns)],
                candidate.scaled_prior_sd(factor)[columns],
                candidate.one_sided[columns],
            )
            effect_sizes = np.zeros((len(slope), len(candidate.prior_sd)))
            # A normal posterior has no limits.
            effect_sizes[:, columns] = np.clip(part_sizes, -limit[columns], limit[columns])
            sd = np.zeros(len(candidate.prior_sd))
            sd[columns] = part_sd
            log_prior = np.log(share / len(candidate.variants) / len(PRIOR_FACTORS))
            hypotheses.append(
                _Hypothesis(
                    variant, part, factor, evidence, effect_sizes, sd, detectability / factor, log_prior
                )
            )
    weighted = np.array([one.evidence + one.log_prior for one in hypotheses])
    return _Tested(tuple(hypotheses), logsumexp(weighted, axis=0), np.argmax(weighted, axis=0))


def effect_evidence(
    slope: Float[np.ndarray, "*sample parameter"],
    information: Float[np.ndarray, "parameter parameter"],
    prior_sd: Float[np.ndarray, " parameter"],
    one_sided: Bool[np.ndarray, " parameter"],
) -> tuple[
    Float[np.ndarray, "*sample"],
    Float[np.ndarray, "*sample parameter"],
    Float[np.ndarray, " parameter"],
    float,
]:
    """Compute log Bayes factor (nats), posterior mean and standard deviation of sizes, and detectability.

    Parameters
    ----------
    slope, information
        s and I; see the module.
    prior_sd
        Standard deviations of normal priors; of half-normal priors before they are folded.
    one_sided
        Whether each effect size cannot be negative. The posterior probabilities of the correct sign are
        multiplied parameter by parameter, which is exact for a single one.
    """
    scaled = information * np.outer(prior_sd, prior_sd)
    precision = np.eye(len(prior_sd)) + scaled
    covariance = np.linalg.inv(precision)
    mean = (slope * prior_sd) @ covariance
    sd = np.sqrt(np.diag(covariance))
    evidence = 0.5 * np.sum(slope * prior_sd * mean, axis=-1) - 0.5 * np.linalg.slogdet(precision)[1]
    bounded = mean.copy()
    if one_sided.any():
        of_one_sided = mean[..., one_sided]
        evidence = evidence + np.sum(np.log(2.0) + log_ndtr(of_one_sided / sd[one_sided]), axis=-1)
        bounded[..., one_sided] = np.maximum(of_one_sided, 0.0)
    detectability = float(np.sqrt(np.max(np.diag(scaled))))
    return np.asarray(evidence), bounded * prior_sd, sd * prior_sd, detectability


def distinguishability(
    signals: Sequence[Float[np.ndarray, " row"]],
    # Each has the same number of rows, but any number of parameters.
    signatures: Sequence[Float[np.ndarray, "_ row"]],
    covariance: Matrix,
) -> Float[np.ndarray, "effect other"]:
    """Compute the squared distance of each effect (row) from the span of each other one (column).

    The distance is in standard deviations of the null hypothesis. Where it is below 9 both ways, the
    recording cannot tell the two effects apart.

    Parameters
    ----------
    signals
        Change of the moments by each effect at its most plausible sizes, N m.
    signatures
        Signatures of each effect, N m per unit.
    covariance
        Null covariance, (N m)^2.
    """
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)

    def white(rows: Float[np.ndarray, "_ row"]) -> Float[np.ndarray, "row _"]:
        return scipy.linalg.solve_triangular(factor, rows.T, lower=True, check_finite=False)

    white_signals = white(np.array(signals))
    total = np.sum(white_signals**2, axis=0)
    distances = np.zeros((len(signals), len(signatures)))
    for column, signature in enumerate(signatures):
        # Basis of the span of this effect; singular values near zero are rounding errors.
        vectors, values, _ = np.linalg.svd(white(signature), full_matrices=False)
        basis = vectors[:, values > 1e-8 * values.max(initial=0.0)]
        distances[:, column] = total - np.sum((basis.T @ white_signals) ** 2, axis=0)
    return np.maximum(distances, 0.0)
