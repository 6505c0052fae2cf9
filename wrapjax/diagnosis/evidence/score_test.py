"""Score test: log Bayes factor of each effect against no effect, without refitting.

With residuals r of null covariance V, an effect's signatures J and the prior N(0, T) of its sizes,
s = J'V^-1 r and I = J'V^-1 J give the posterior mean of the sizes, (I + T^-1)^-1 s, and the log Bayes factor
of the effect against no effect. It is a modification index with a prior for plausible sizes and a penalty for
flexibility.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float
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
    weights = np.array([one.weight for one in projections])
    scores, first = [], 0
    for candidate in candidates:
        scores.append(_score_candidate(projections, weights, candidate, first))
        first += len(candidate.variants) * len(candidate.prior_sd)
    return tuple(
        ScoreTest(tuple(of_samples[sample] for of_samples in scores), weights[:, sample])
        for sample in range(weights.shape[1])
    )


def _score_candidate(
    projections: Sequence[Projection],
    weights: Float[np.ndarray, "null sample"],
    candidate: Candidate,
    first: int,
) -> list[Score]:
    """Score one candidate on every residual; its parameters begin at column ``first`` of the projections.

    Variants have equal prior probabilities, and so have the factors on the prior standard deviations. All
    nulls and factors are computed at once, hypothesis by hypothesis.
    """
    count, variants = len(candidate.prior_sd), len(candidate.variants)
    hypotheses = [(variant, *one) for variant in range(variants) for one in candidate.hypotheses]
    scaled_sd = np.array([candidate.scaled_prior_sd(factor) for factor in PRIOR_FACTORS])
    weighted, posteriors, detectabilities = [], [], []
    for variant, part, share in hypotheses:
        inside = np.array(part)
        columns = first + count * variant + inside
        # Axes: null, factor, then those of each.
        of_part, sizes, sd, detectability = effect_evidence(
            np.stack([one.slope[:, columns] for one in projections])[:, None],
            np.stack([one.information[np.ix_(columns, columns)] for one in projections])[:, None],
            scaled_sd[:, inside],
            candidate.one_sided[inside],
        )
        weighted.append(of_part + np.log(share / variants / len(PRIOR_FACTORS)))
        posteriors.append((sizes, sd))
        detectabilities.append(detectability / PRIOR_FACTORS)
    of_hypotheses = np.concatenate(weighted, axis=1)
    joint = weights + logsumexp(of_hypotheses, axis=1)
    evidence = logsumexp(joint, axis=0) - logsumexp(weights, axis=0)
    # Detectability is that under the most plausible null without any effect.
    of_nulls = np.concatenate(detectabilities, axis=1).max(axis=1)[np.argmax(weights, axis=0)]
    limit = np.broadcast_to(candidate.limit, count)
    scores = []
    for sample, null in enumerate(np.argmax(joint, axis=0)):
        best = int(np.argmax(of_hypotheses[null, :, sample]))
        number, factor = divmod(best, len(PRIOR_FACTORS))
        variant, part, _ = hypotheses[number]
        sizes, sd = posteriors[number]
        inside = np.array(part)
        all_sizes, all_sd = np.zeros(count), np.zeros(count)
        # A normal posterior has no limits.
        all_sizes[inside] = np.clip(sizes[null, factor, sample], -limit[inside], limit[inside])
        all_sd[inside] = sd[null, factor]
        scores.append(
            Score(
                candidate.id,
                float(evidence[sample]),
                variant,
                part,
                PRIOR_FACTORS[factor],
                all_sizes,
                all_sd,
                float(of_nulls[sample]),
            )
        )
    return scores


def effect_evidence(
    slope: Float[np.ndarray, "*null sample parameter"],
    information: Float[np.ndarray, "*null parameter parameter"],
    prior_sd: Float[np.ndarray, "*prior parameter"],
    one_sided: Bool[np.ndarray, " parameter"],
) -> tuple[
    Float[np.ndarray, "*case sample"],
    Float[np.ndarray, "*case sample parameter"],
    Float[np.ndarray, "*case parameter"],
    Float[np.ndarray, "*case"],
]:
    """Compute log Bayes factor (nats), posterior mean and standard deviation of sizes, and detectability.

    Leading axes of nulls and priors are broadcast against each other (``case``).

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
    scaled = information * (prior_sd[..., :, None] * prior_sd[..., None, :])
    precision = np.eye(len(one_sided)) + scaled
    covariance = np.linalg.inv(precision)
    scaled_slope = slope * prior_sd[..., None, :]
    mean = scaled_slope @ covariance
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    evidence = 0.5 * np.sum(scaled_slope * mean, axis=-1) - 0.5 * np.linalg.slogdet(precision)[1][..., None]
    bounded = mean.copy()
    if one_sided.any():
        of_one_sided = mean[..., one_sided]
        correct_sign = log_ndtr(of_one_sided / sd[..., None, one_sided])
        evidence = evidence + np.sum(np.log(2.0) + correct_sign, axis=-1)
        bounded[..., one_sided] = np.maximum(of_one_sided, 0.0)
    detectability = np.asarray(np.sqrt(np.max(np.diagonal(scaled, axis1=-2, axis2=-1), axis=-1)))
    return evidence, bounded * prior_sd[..., None, :], sd * prior_sd, detectability


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
