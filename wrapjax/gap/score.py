"""How much better each effect explains residuals than no effect does, without refitting anything.

A score test in Bayes' form. With residuals r of null covariance V, an effect's signatures J and the prior
N(0, T) of its amounts, s = J'V^-1 r and I = J'V^-1 J give the amounts that are most plausible,
(I + T^-1)^-1 s, and the logarithm of the ratio of the evidence for the effect to that against it. It is a
modification index with a scale for what is plausible and a price for what is flexible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float
from scipy.special import log_ndtr, logsumexp

from wrapjax.gap.covariance import Matrix

Signature = Float[np.ndarray, "parameter row"]


@dataclass(frozen=True)
class Candidate:
    """An effect as a score test sees it.

    Parameters
    ----------
    id
        Of the effect.
    variants
        Signatures of each of its shapes, N m a unit of each amount.
    prior_sd
        Of its amounts.
    one_sided
        Which of them cannot be negative.
    """

    id: str
    variants: tuple[Signature, ...]
    prior_sd: Float[np.ndarray, " parameter"]
    one_sided: Bool[np.ndarray, " parameter"]


@dataclass(frozen=True)
class Score:
    """What a score test says of an effect.

    Parameters
    ----------
    id
        Of the effect.
    evidence
        Logarithm of the ratio of evidences, in nats: positive for the effect.
    variant
        The shape that explains most.
    amounts, sd
        Most plausible amounts of that shape, in their units, and how well they are known.
    detectability
        Of an effect of the size that its prior expects, in standard deviations: below 2 the recording
        cannot show it, whatever it says.
    """

    id: str
    evidence: float
    variant: int
    amounts: Float[np.ndarray, " parameter"]
    sd: Float[np.ndarray, " parameter"]
    detectability: float


@dataclass(frozen=True)
class Null:
    """One null hypothesis: a covariance, and how plausible it was before."""

    covariance: Matrix
    log_prior: float = 0.0


def score(
    residual: Float[np.ndarray, " row"], nulls: Sequence[Null], candidates: Sequence[Candidate]
) -> tuple[Score, ...]:
    """Score every candidate against all nulls together.

    Each hypothesis is averaged over the nulls for itself: an effect that explains the residual earns the
    evidence of a null that has less to explain.

    Parameters
    ----------
    residual
        At the prior mean of what was calibrated: its give is part of the nulls.
    nulls
        Of different strengths of what cannot be named.
    candidates
        In any order.
    """
    weights = np.zeros(len(nulls))
    by_null: list[list[_Found]] = []
    for place, null in enumerate(nulls):
        factor = scipy.linalg.cholesky(null.covariance, lower=True, check_finite=False)
        seen = scipy.linalg.solve_triangular(factor, residual, lower=True, check_finite=False)
        weights[place] = null.log_prior - 0.5 * seen @ seen - np.sum(np.log(np.diag(factor)))
        by_null.append([_against(factor, seen, candidate) for candidate in candidates])
    usual = logsumexp(weights)
    scores = []
    for place, candidate in enumerate(candidates):
        found = [one[place] for one in by_null]
        joint = weights + [one.evidence for one in found]
        chosen = found[int(np.argmax(joint))]
        # Of the null that residuals speak for, whatever the effect.
        detectability = found[int(np.argmax(weights))].detectability
        evidence = float(logsumexp(joint) - usual)
        scores.append(Score(candidate.id, evidence, chosen.variant, chosen.amounts, chosen.sd, detectability))
    return tuple(scores)


@dataclass(frozen=True)
class _Found:
    evidence: float
    variant: int
    amounts: np.ndarray
    sd: np.ndarray
    detectability: float


def _against(factor: Matrix, seen: Float[np.ndarray, " row"], candidate: Candidate) -> _Found:
    """Score one candidate against one null; its variants are equally plausible before."""
    found = []
    for signature in candidate.variants:
        white = scipy.linalg.solve_triangular(factor, signature.T, lower=True, check_finite=False)
        found.append(evidence_of(white.T @ seen, white.T @ white, candidate.prior_sd, candidate.one_sided))
    best = int(np.argmax([one[0] for one in found]))
    evidence = float(logsumexp([one[0] for one in found]) - np.log(len(found)))
    return _Found(evidence, best, found[best][1], found[best][2], max(one[3] for one in found))


def evidence_of(
    slope: Float[np.ndarray, " parameter"],
    information: Float[np.ndarray, "parameter parameter"],
    prior_sd: Float[np.ndarray, " parameter"],
    one_sided: Bool[np.ndarray, " parameter"],
) -> tuple[float, Float[np.ndarray, " parameter"], Float[np.ndarray, " parameter"], float]:
    """Give evidence (nats), most plausible amounts, their standard deviations, and detectability.

    Parameters
    ----------
    slope, information
        s and I.
    prior_sd
        Of normal priors; of half-normal ones before they are folded.
    one_sided
        Which amounts cannot be negative. Their shares of the posterior on the right side of zero are
        taken one by one, which is exact for a single one.
    """
    scaled = information * np.outer(prior_sd, prior_sd)
    precision = np.eye(len(prior_sd)) + scaled
    covariance = np.linalg.inv(precision)
    unit = covariance @ (slope * prior_sd)
    sd = np.sqrt(np.diag(covariance))
    evidence = 0.5 * (slope * prior_sd) @ unit - 0.5 * np.linalg.slogdet(precision)[1]
    kept = unit.copy()
    if one_sided.any():
        evidence += float(np.sum(np.log(2.0) + log_ndtr(unit[one_sided] / sd[one_sided])))
        kept[one_sided] = np.maximum(kept[one_sided], 0.0)
    detectability = float(np.sqrt(np.max(np.diag(scaled))))
    return float(evidence), kept * prior_sd, sd * prior_sd, detectability


def inimitable(
    of: Signature,
    by: Float[np.ndarray, "other row"],
    covariance: Matrix,
    amounts: Float[np.ndarray, " parameter"],
) -> float:
    """Say how much of one effect another cannot imitate, D in squared standard deviations.

    Below 9 both ways, two effects are a tie: this recording cannot tell one from the other.

    Parameters
    ----------
    of, by
        Signatures of the one, and of the other.
    covariance
        The null's.
    amounts
        Of the one.
    """
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    own, other = (
        scipy.linalg.solve_triangular(factor, signature.T, lower=True, check_finite=False)
        for signature in (of, by)
    )
    seen = own @ amounts
    left = seen - other @ np.linalg.lstsq(other, seen, rcond=None)[0]
    return float(left @ left)
