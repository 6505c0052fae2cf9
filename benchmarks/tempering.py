"""How bold evidence is: constants that turn nats into probabilities, from cases whose truth is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from wrapjax.gap.conclude.verdict import Probabilities, Tuning, probabilities

#: What a truth without any effect is called among probabilities; pairs have no one right name.
_OTHERWISE = {"none": "none", "outside": "unknown"}
#: Probability that is given to what was thought impossible: one case alone must not decide everything.
_FLOOR = 1e-3
# Finer changes of a constant than this mean nothing among a hundred cases.
_ENOUGH = {"xatol": 0.02, "fatol": 1e-4}
#: Share of cases without effect that may have more evidence than the alarm.
_ALARMS = 0.025


@dataclass(frozen=True)
class Scored:
    """What a score says of a case, and its truth.

    Parameters
    ----------
    truth
        Of the bank.
    evidence, structured
        See `probabilities`.
    """

    truth: dict[str, Any]
    evidence: Mapping[str, float]
    structured: float

    def right(self, found: Probabilities) -> float | None:
        """Give the probability of what is true of the case; None for a pair."""
        tier = self.truth["tier"]
        if tier == "pair":
            return None
        if tier in _OTHERWISE:
            return float(getattr(found, _OTHERWISE[tier]))
        accepted = {*(cause["id"] for cause in self.truth["causes"]), *self.truth["ties"]}
        return sum(share for id, share in found.effects.items() if id in accepted)


def surprise(cases: Sequence[Scored], tuning: Tuning) -> float:
    """Give the mean of less the logarithm of the probability of what is true (nats)."""
    found = [one.right(probabilities(one.evidence, one.structured, tuning)) for one in cases]
    return -float(np.mean([np.log(max(share, _FLOOR)) for share in found if share is not None]))


def tempered(cases: Sequence[Scored], tuning: Tuning) -> Tuning:
    """Choose temperature, offset and what is unknown so that cases surprise least, and the alarm.

    Parameters
    ----------
    cases
        All tiers but pairs are looked at; some must be without effect.
    tuning
        Where the search begins, and all other constants.
    """

    def at(point: Float[np.ndarray, " constant"]) -> Tuning:
        return replace(
            tuning,
            temperature=float(np.exp(point[0])),
            offset=float(point[1]),
            structured_offset=float(point[2]),
            structured_scale=float(np.exp(point[3])),
        )

    start = [
        np.log(tuning.temperature),
        tuning.offset,
        tuning.structured_offset,
        np.log(tuning.structured_scale),
    ]
    found = minimize(lambda point: surprise(cases, at(point)), start, method="Nelder-Mead", options=_ENOUGH)
    nothing = [max(one.evidence.values()) for one in cases if one.truth["tier"] == "none"]
    best = at(found.x)
    return replace(
        best,
        temperature=round(best.temperature, 2),
        offset=round(best.offset, 2),
        structured_offset=round(best.structured_offset, 1),
        structured_scale=round(best.structured_scale, 1),
        alarm=float(np.ceil(10.0 * np.quantile(nothing, 1.0 - _ALARMS)) / 10.0),
    )
