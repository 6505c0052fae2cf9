"""Effects that explain a residual only together, or each a part of it.

One cause can hide another, and two can pass for a third. So effects are scored once more beside each of the
strongest: against nulls that have it, with its own prior. Several stand where each stands out beside all the
others, which also takes away again what a later one has made needless.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.projection import Candidate, Projection
from wrapjax.diagnosis.score import SIZES, Score, score_projected

#: Effects that are looked at beside one another: the strongest alone.
POOL = 10
#: Most effects that are said at once.
MOST = 3
#: Nulls less likely than the likeliest by so many nats change nothing that is said, and are left out.
_UNLIKELY = 12.0


def standing_together(
    projections: Sequence[Projection],
    candidates: Sequence[Candidate],
    scores: Mapping[str, Score],
    detection_threshold: float,
) -> tuple[str, ...]:
    """Find several effects that each stand out beside the others.

    Parameters
    ----------
    projections
        Of one residual, through every null.
    candidates
        In the order of the projections' amounts.
    scores
        Of each alone, by id, the strongest first.
    alarm
        Evidence (nats) that an effect alone has to exceed. Pairs are sought among many: beside each other
        both have to exceed it by the logarithm of their number.

    Returns
    -------
    ids
        The strongest alone first; empty where none or one explains as much.
    """
    pool = [one for one in candidates if one.id in list(scores)[:POOL]]
    if len(pool) < 2:
        return ()
    columns, own = _as_they_explain_most(candidates, pool, scores)
    likeliest = max(float(one.weight[0]) for one in projections)
    seen = [_of_columns(one, columns) for one in projections if one.weight[0] > likeliest - _UNLIKELY]

    def beside(*given: str) -> dict[str, float]:
        allowed = [
            _less_likely(one.allowing(_spread(own, dict(zip(given, sizes, strict=True)))), len(sizes))
            for one in seen
            for sizes in product(SIZES, repeat=len(given))
        ]
        (scored,) = score_projected(allowed, own)
        # Other shapes and parts were plausible before, too.
        return {
            one.id: one.evidence + whole.log_prior(scores[one.id].part)
            for one, whole in zip(scored.scores, pool, strict=True)
            if one.id not in given
        }

    beside_one = {one.id: beside(one.id) for one in pool}
    pairs = list(combinations([one.id for one in pool], 2))
    least = detection_threshold + float(np.log(len(pairs)))
    standing = [(a, b) for a, b in pairs if min(beside_one[a][b], beside_one[b][a]) > least]
    if not standing:
        return ()
    found: tuple[str, ...] = max(
        standing, key=lambda pair: scores[pair[0]].evidence + beside_one[pair[0]][pair[1]]
    )
    while len(found) < MOST:
        more = beside(*found)
        if not more or max(more.values()) <= least:
            break
        wider = (*found, max(more, key=lambda id: more[id]))
        if any(beside(*(other for other in wider if other != id))[id] <= least for id in found):
            break
        found = wider
    return tuple(id for id in scores if id in found)


def _as_they_explain_most(
    candidates: Sequence[Candidate], pool: Sequence[Candidate], scores: Mapping[str, Score]
) -> tuple[Int[np.ndarray, " kept"], tuple[Candidate, ...]]:
    """Keep of each in the pool the shape and the part that explain most alone.

    Returns
    -------
    columns, own
        Which of all amounts these are, and what is left of the candidates.
    """
    columns, own, first = [], [], 0
    for one in candidates:
        if any(one is other for other in pool):
            score, part = scores[one.id], np.array(scores[one.id].part)
            columns.append(first + score.variant * len(one.prior_sd) + part)
            shape = one.variants[score.variant][part]
            limit = np.broadcast_to(one.limit, one.prior_sd.shape)[part]
            own.append(Candidate(one.id, (shape,), one.prior_sd[part], one.one_sided[part], limit=limit))
        first += len(one.prior_sd) * len(one.variants)
    return np.concatenate(columns), tuple(own)


def _of_columns(projection: Projection, columns: Int[np.ndarray, " kept"]) -> Projection:
    information = projection.information[np.ix_(columns, columns)]
    return Projection(projection.weight, projection.slope[:, columns], information)


def _spread(own: Sequence[Candidate], sizes: Mapping[str, float]) -> Float[np.ndarray, " kept"]:
    """Standard deviations of all amounts, where some effects are allowed for at these sizes."""
    return np.concatenate([one.expected(sizes.get(one.id, 0.0)) for one in own])


def _less_likely(projection: Projection, given: int) -> Projection:
    """Let all sizes of what is given be equally plausible."""
    return replace(projection, weight=projection.weight - given * np.log(len(SIZES)))
