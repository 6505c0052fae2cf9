"""How much better each effect explains residuals than no effect does, without refitting anything.

A score test in Bayes' form. With residuals r of null covariance V, an effect's signatures J and the prior
N(0, T) of its amounts, s = J'V^-1 r and I = J'V^-1 J give the amounts that are most plausible,
(I + T^-1)^-1 s, and the logarithm of the ratio of the evidence for the effect to that against it. It is a
modification index with a scale for what is plausible and a price for what is flexible.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int
from scipy.special import log_ndtr, logsumexp

from wrapjax.diagnosis.null_covariance import Matrix
from wrapjax.diagnosis.projection import Candidate, Null, Projection, project

#: An effect may be smaller or larger than its prior expects: its amounts share one of these sizes, as far as
#: their limits let them.
SIZES = (0.1, 0.3, 1.0, 3.0)


@dataclass(frozen=True)
class Score:
    """What a score test says of an effect.

    Parameters
    ----------
    id
        Of the effect.
    evidence
        Logarithm of the ratio of evidences, in nats: positive for the effect.
    variant, part, size
        The shape that explains most, the numbers of the amounts that are not zero, and how large they are as
        a rule, in what their prior expects.
    amounts, sd
        Most plausible amounts of that shape, in their units, and how well they are known.
    detectability
        Of an effect of the size that its prior expects, in standard deviations: below 2 the recording
        cannot show it, whatever it says.
    """

    id: str
    evidence: float
    variant: int
    part: tuple[int, ...]
    size: float
    effect_sizes: Float[np.ndarray, " parameter"]
    sd: Float[np.ndarray, " parameter"]
    detectability: float


@dataclass(frozen=True)
class Scored:
    """What a score test says of a residual.

    Parameters
    ----------
    scores
        One a candidate, in their order.
    plausible
        Logarithm of how plausible each null is, without any effect.
    """

    scores: tuple[Score, ...]
    plausible: Float[np.ndarray, " null"]

    @property
    def structured(self) -> float:
        """Evidence (nats) for errors that no effect is known for, against the first null, which has least."""
        return float(logsumexp(self.plausible) - self.plausible[0])


def score_each(
    residuals: Float[np.ndarray, "sample row"], nulls: Iterable[Null], candidates: Sequence[Candidate]
) -> tuple[Scored, ...]:
    """Score every candidate against all nulls together, on several residuals that share these.

    Each hypothesis is averaged over the nulls for itself: an effect that explains the residual earns the
    evidence of a null that has less to explain.

    Parameters
    ----------
    residuals
        Each at the prior mean of what was calibrated: its give is part of the nulls.
    nulls
        Of different strengths of what cannot be named.
    candidates
        In any order.
    """
    return score_projected([project(residuals, null, candidates) for null in nulls], candidates)


def score_projected(projections: Sequence[Projection], candidates: Sequence[Candidate]) -> tuple[Scored, ...]:
    """Score every candidate against all nulls together; see `score_each`."""
    by_null = [_against_all(one, candidates) for one in projections]
    plausible = np.array([one.weight for one in projections])
    usual = logsumexp(plausible, axis=0)
    every = []
    for sample in range(plausible.shape[1]):
        own = []
        for number, candidate in enumerate(candidates):
            found = [own_null[number] for own_null in by_null]
            joint = plausible[:, sample] + [one_null.evidence[sample] for one_null in found]
            chosen = found[int(np.argmax(joint))]
            place = int(chosen.best[sample])
            one = chosen.hypotheses[place]
            # Of the null that residuals speak for, whatever the effect.
            detectability = found[int(np.argmax(plausible[:, sample]))].detectability
            own.append(
                Score(
                    candidate.id,
                    float(logsumexp(joint) - usual[sample]),
                    one.variant,
                    one.part,
                    one.size,
                    one.effect_sizes[sample],
                    one.sd,
                    detectability,
                )
            )
        every.append(Scored(tuple(own), plausible[:, sample]))
    return tuple(every)


@dataclass(frozen=True)
class _Hypothesis:
    variant: int
    part: tuple[int, ...]
    size: float
    evidence: Float[np.ndarray, " sample"]
    #: Zero beside the part.
    effect_sizes: Float[np.ndarray, "sample parameter"]
    sd: Float[np.ndarray, " parameter"]
    detectability: float
    log_prior: float


@dataclass(frozen=True)
class _Found:
    hypotheses: tuple[_Hypothesis, ...]
    evidence: Float[np.ndarray, " sample"]
    #: Which hypothesis explains most.
    best: Int[np.ndarray, " sample"]

    @property
    def detectability(self) -> float:
        return max(one.detectability for one in self.hypotheses)


def _against_all(projection: Projection, candidates: Sequence[Candidate]) -> list[_Found]:
    """Score all candidates against one null."""
    found, first = [], 0
    for candidate in candidates:
        shapes = []
        for _ in candidate.variants:
            own = slice(first, first := first + len(candidate.prior_sd))
            shapes.append((projection.slope[:, own], projection.information[own, own]))
        found.append(_against(shapes, candidate))
    return found


def _against(
    shapes: Sequence[tuple[Float[np.ndarray, "sample parameter"], Float[np.ndarray, "parameter parameter"]]],
    candidate: Candidate,
) -> _Found:
    """Score one candidate by s and I of its shapes; these are equally plausible before."""
    tried = []
    limit = np.broadcast_to(candidate.limit, candidate.prior_sd.shape)
    for variant, (slope, information) in enumerate(shapes):
        for (part, share), size in product(candidate.hypotheses, SIZES):
            own = np.array(part)
            evidence, effect_sizes, sd, detectability = evidence_of(
                slope[:, own],
                information[np.ix_(own, own)],
                candidate.expected(size)[own],
                candidate.one_sided[own],
            )
            placed = np.zeros((len(slope), len(candidate.prior_sd)))
            # A normal posterior ends nowhere.
            placed[:, own] = np.clip(effect_sizes, -limit[own], limit[own])
            spread = np.zeros(len(candidate.prior_sd))
            spread[own] = sd
            log_prior = np.log(share / len(candidate.variants) / len(SIZES))
            tried.append(
                _Hypothesis(variant, part, size, evidence, placed, spread, detectability / size, log_prior)
            )
    weighed = np.array([one.evidence + one.log_prior for one in tried])
    return _Found(tuple(tried), logsumexp(weighed, axis=0), np.argmax(weighed, axis=0))


def evidence_of(
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
    unit = (slope * prior_sd) @ covariance
    sd = np.sqrt(np.diag(covariance))
    evidence = 0.5 * np.sum(slope * prior_sd * unit, axis=-1) - 0.5 * np.linalg.slogdet(precision)[1]
    kept = unit.copy()
    if one_sided.any():
        own = unit[..., one_sided]
        evidence = evidence + np.sum(np.log(2.0) + log_ndtr(own / sd[one_sided]), axis=-1)
        kept[..., one_sided] = np.maximum(own, 0.0)
    detectability = float(np.sqrt(np.max(np.diag(scaled))))
    return np.asarray(evidence), kept * prior_sd, sd * prior_sd, detectability


def likeness(
    signals: Sequence[Float[np.ndarray, " row"]],
    # Of as many rows each, but of any number of amounts.
    signatures: Sequence[Float[np.ndarray, "_ row"]],
    covariance: Matrix,
) -> Float[np.ndarray, "effect other"]:
    """Say how much of each effect (row) each other (column) cannot imitate: squared deviations.

    Below 9 both ways, two effects are a tie: this recording cannot tell one from the other.

    Parameters
    ----------
    signals
        What each effect does at its most plausible amounts.
    signatures
        Of each, by unit amounts.
    covariance
        The null's.
    """
    factor = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)

    def white(rows: Float[np.ndarray, "_ row"]) -> Float[np.ndarray, "row _"]:
        return scipy.linalg.solve_triangular(factor, rows.T, lower=True, check_finite=False)

    seen = white(np.array(signals))
    total = np.sum(seen**2, axis=0)
    found = np.zeros((len(signals), len(signatures)))
    for column, signature in enumerate(signatures):
        # A basis of all that this effect can do; what is nearly zero of it is rounding.
        left, sizes, _ = np.linalg.svd(white(signature), full_matrices=False)
        basis = left[:, sizes > 1e-8 * sizes.max(initial=0.0)]
        found[:, column] = total - np.sum((basis.T @ seen) ** 2, axis=0)
    return np.maximum(found, 0.0)
