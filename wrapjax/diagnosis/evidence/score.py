"""Scores of all effects: evidence, detection threshold, effects that are jointly significant, and ties.

Effects can be significant only jointly: one cause can hide another, and two can resemble a third. So effects
are scored again beside each of the strongest: against nulls that contain it, with its own prior. Several
effects are jointly significant where each is significant beside all the others. This criterion also removes
an earlier effect that a later one has made unnecessary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import (
    PRIOR_FACTORS,
    Projection,
    Score,
    ScoreTest,
    distinguishability,
    project,
    score_projected,
)
from wrapjax.diagnosis.null_hypotheses.null_covariance import Null, nulls

#: Share of null replicates whose strongest evidence exceeds the detection threshold.
FALSE_ALARM_RATE = 0.025
#: Number of effects, the strongest first, that are compared with one another.
COMPARED = 8
#: Number of effects, the strongest alone first, that are scored beside one another.
POOL = 10
#: Largest number of effects that are named together.
MOST = 3
# Nulls less plausible than the most plausible one by this many nats do not change the result and are omitted.
_NEGLIGIBLE = 12.0


@dataclass(frozen=True)
class Scores:
    """Scores of all effects of a subject.

    Parameters
    ----------
    by_id
        Score of each effect, the strongest evidence first.
    null_maxima
        Strongest evidence in each null replicate, nats.
    detection_threshold
        Evidence that few null replicates exceed, nats.
    jointly_significant
        Effects that are each significant beside the others, the strongest alone first; empty if none are.
    compared, distinguishability
        Strongest effects, and the squared distance of each (row) from the span of each other (column); see
        `score_test.distinguishability`.
    null
        Most plausible null hypothesis without any effect.
    of_single_cycles
        Effects each of whose parameters changes one cycle alone; see `concerns_single_cycles`.
    added_by_other_tasks
        Part of the evidence that tasks other than gait added, by effect; see
        `wrapjax.diagnosis.evidence.other_tasks`.
    """

    by_id: dict[str, Score]
    null_maxima: Float[np.ndarray, " replicate"]
    detection_threshold: float
    jointly_significant: tuple[str, ...]
    compared: tuple[str, ...]
    distinguishability: Float[np.ndarray, "effect effect"]
    null: Null
    of_single_cycles: tuple[str, ...]
    added_by_other_tasks: Mapping[str, float] = field(default_factory=dict)

    @property
    def evidence(self) -> dict[str, float]:
        """Evidence of each effect, nats, the strongest first."""
        return {id: score.evidence for id, score in self.by_id.items()}

    @property
    def global_p(self) -> float:
        """Share of null replicates whose strongest evidence reaches the subject's; 1 without effects."""
        strongest = next(iter(self.evidence.values()), None)
        if strongest is None:
            return 1.0
        return float((1 + np.sum(self.null_maxima >= strongest)) / (1 + len(self.null_maxima)))


def score(
    linearized: LinearizedModel,
    measured_moment_sd: Float[np.ndarray, " coordinate"],
    null_residuals: Float[np.ndarray, "replicate row"],
    least_threshold: float,
) -> Scores:
    """Score all effects on the subject's residual and on null replicates.

    Parameters
    ----------
    linearized
        Linearised model.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate, N m.
    null_residuals
        Residuals of null replicates, N m.
    least_threshold
        Smallest detection threshold, nats.
    """
    candidates = linearized.candidates
    residuals = np.concatenate([linearized.residual.reshape(1, -1), null_residuals])
    projections = [project(residuals, null, candidates) for null in nulls(linearized, measured_moment_sd)]
    test, *of_replicates = score_projected(projections, candidates)
    null_maxima = np.array(
        [max((one.evidence for one in replicate.scores), default=0.0) for replicate in of_replicates]
    )
    quantile = float(np.quantile(null_maxima, 1.0 - FALSE_ALARM_RATE)) if len(null_maxima) else 0.0
    threshold = max(least_threshold, quantile)
    by_id = {one.id: one for one in sorted(test.scores, key=lambda one: -one.evidence)}
    of_subject = [replace(one, weight=one.weight[:1], slope=one.slope[:1]) for one in projections]
    compared = tuple(by_id)[:COMPARED]
    null = most_plausible_null(linearized, measured_moment_sd, test)
    return Scores(
        by_id=by_id,
        null_maxima=null_maxima,
        detection_threshold=threshold,
        jointly_significant=jointly_significant_effects(of_subject, candidates, by_id, threshold),
        compared=compared,
        distinguishability=_distances(linearized, null, [by_id[id] for id in compared]),
        null=null,
        of_single_cycles=tuple(
            id for id, one in by_id.items() if concerns_single_cycles(effect_signatures(linearized, one))
        ),
    )


def effect_signatures(
    linearized: LinearizedModel, score: Score
) -> Float[np.ndarray, "parameter cycle coordinate phase"]:
    """Return the signatures of the most plausible variant and part of an effect, N m per unit."""
    candidate = next(one for one in linearized.candidates if one.id == score.id)
    part = np.array(score.part)
    return candidate.variants[score.variant][part].reshape(len(part), *linearized.residual.shape)


def concerns_single_cycles(signatures: Float[np.ndarray, "parameter cycle coordinate phase"]) -> bool:
    """Return whether each parameter changes one cycle alone, so that unseen cycles do not test it."""
    return bool((np.count_nonzero(signatures.any(axis=(2, 3)), axis=1) < 2).all())


def _distances(
    linearized: LinearizedModel, null: Null, scores: Sequence[Score]
) -> Float[np.ndarray, "effect effect"]:
    """Compute the distinguishability of effects under a null."""
    if not scores:
        return np.zeros((0, 0))
    candidates = {candidate.id: candidate for candidate in linearized.candidates}
    variants = [candidates[one.id].variants[one.variant] for one in scores]
    signatures = [variant[list(one.part)] for one, variant in zip(scores, variants, strict=True)]
    signals = [one.effect_sizes @ variant for one, variant in zip(scores, variants, strict=True)]
    return distinguishability(signals, signatures, null.covariance)


def most_plausible_null(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"], test: ScoreTest
) -> Null:
    """Compute the null hypothesis with the largest posterior probability."""
    best = int(np.argmax(test.null_weights))
    return next(null for number, null in enumerate(nulls(linearized, measured_moment_sd)) if number == best)


def jointly_significant_effects(
    projections: Sequence[Projection],
    candidates: Sequence[Candidate],
    scores: Mapping[str, Score],
    detection_threshold: float,
) -> tuple[str, ...]:
    """Select effects that are each significant beside the others.

    Parameters
    ----------
    projections
        Projections of one residual by every null.
    candidates
        Effects, in the order of the projections' columns.
    scores
        Score of each effect alone, by id, the strongest first.
    detection_threshold
        Evidence (nats) that an effect alone has to exceed. As pairs are selected among many, both effects of
        a pair have to exceed it by the logarithm of the number of pairs.

    Returns
    -------
    ids
        Identifiers, the strongest alone first; empty where no effect or one explains as much.
    """
    pool = [one for one in candidates if one.id in list(scores)[:POOL]]
    if len(pool) < 2:
        return ()
    columns, reduced = _most_plausible_parts(candidates, pool, scores)
    largest = max(float(one.weight[0]) for one in projections)
    plausible = [
        _select_columns(one, columns) for one in projections if one.weight[0] > largest - _NEGLIGIBLE
    ]

    def evidence_beside(*given: str) -> dict[str, float]:
        allowed = [
            _with_prior_of_factors(
                one.allowing(_prior_sd(reduced, dict(zip(given, factors, strict=True)))), len(factors)
            )
            for one in plausible
            for factors in product(PRIOR_FACTORS, repeat=len(given))
        ]
        (test,) = score_projected(allowed, reduced)
        # The prior counts the other variants and parts, which were plausible before as well.
        return {
            one.id: one.evidence + candidate.log_prior(scores[one.id].part)
            for one, candidate in zip(test.scores, pool, strict=True)
            if one.id not in given
        }

    beside_one = {one.id: evidence_beside(one.id) for one in pool}
    pairs = list(combinations([one.id for one in pool], 2))
    least = detection_threshold + float(np.log(len(pairs)))
    significant = [(a, b) for a, b in pairs if min(beside_one[a][b], beside_one[b][a]) > least]
    if not significant:
        return ()
    chosen: tuple[str, ...] = max(
        significant, key=lambda pair: scores[pair[0]].evidence + beside_one[pair[0]][pair[1]]
    )
    while len(chosen) < MOST:
        more = evidence_beside(*chosen)
        if not more or max(more.values()) <= least:
            break
        wider = (*chosen, max(more, key=lambda id: more[id]))
        if any(evidence_beside(*(other for other in wider if other != id))[id] <= least for id in chosen):
            break
        chosen = wider
    return tuple(id for id in scores if id in chosen)


def _most_plausible_parts(
    candidates: Sequence[Candidate], pool: Sequence[Candidate], scores: Mapping[str, Score]
) -> tuple[Int[np.ndarray, " column"], tuple[Candidate, ...]]:
    """Reduce each candidate of the pool to the variant and the part that are most plausible alone.

    Returns
    -------
    columns, reduced
        Their columns among those of all candidates, and the reduced candidates.
    """
    columns, reduced, first = [], [], 0
    for candidate in candidates:
        if any(candidate is other for other in pool):
            alone = scores[candidate.id]
            part = np.array(alone.part)
            columns.append(first + alone.variant * len(candidate.prior_sd) + part)
            signature = candidate.variants[alone.variant][part]
            limit = np.broadcast_to(candidate.limit, candidate.prior_sd.shape)[part]
            prior_sd, one_sided = candidate.prior_sd[part], candidate.one_sided[part]
            reduced.append(Candidate(candidate.id, (signature,), prior_sd, one_sided, limit=limit))
        first += len(candidate.prior_sd) * len(candidate.variants)
    return np.concatenate(columns), tuple(reduced)


def _select_columns(projection: Projection, columns: Int[np.ndarray, " column"]) -> Projection:
    information = projection.information[np.ix_(columns, columns)]
    return Projection(projection.weight, projection.slope[:, columns], information)


def _prior_sd(candidates: Sequence[Candidate], factors: Mapping[str, float]) -> Float[np.ndarray, " column"]:
    """Prior standard deviations of all parameters: scaled by the factor of each effect, zero without one."""
    return np.concatenate([one.scaled_prior_sd(factors.get(one.id, 0.0)) for one in candidates])


def _with_prior_of_factors(projection: Projection, effects: int) -> Projection:
    """Give all factors on the prior of this number of effects equal prior probabilities."""
    return replace(projection, weight=projection.weight - effects * np.log(len(PRIOR_FACTORS)))
