"""How bold evidence is: constants that turn nats into probabilities, from cases whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
#: Nats over which what is unknown becomes likelier than nothing: beyond this they say nothing of it.
_FLATTEST = 25.0
#: Share of cases without effect that may have more evidence than the alarm, and more for what is unknown than
#: for nothing.
_ALARMS, _UNKNOWNS = 0.025, 0.10


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
    """Choose constants so that cases surprise least and those without effect rarely set off an alarm.

    Parameters
    ----------
    cases
        All tiers but pairs are looked at; some must be without effect.
    tuning
        Where the search begins, and all other constants.
    """

    nothing = [one for one in cases if one.truth["tier"] == "none"]
    worlds = {one.truth.get("world", "") for one in nothing}

    def rarely(of: Callable[[Scored], float], share: float) -> float:
        """Give what so few of any family exceed."""
        by_world = [[of(one) for one in nothing if one.truth.get("world", "") == world] for world in worlds]
        return max(float(np.quantile(own, 1.0 - share)) for own in by_world)

    tuning = replace(
        tuning,
        alarm=float(np.ceil(10.0 * rarely(lambda one: max(one.evidence.values()), _ALARMS)) / 10.0),
        structured_offset=round(rarely(lambda one: one.structured, _UNKNOWNS), 1),
    )

    def at(point: Float[np.ndarray, " constant"]) -> Tuning:
        temperature, scale = np.exp(point[[0, 2]])
        return replace(
            tuning,
            temperature=float(temperature),
            offset=float(point[1]),
            structured_scale=float(min(scale, _FLATTEST)),
        )

    start = [np.log(tuning.temperature), tuning.offset, np.log(tuning.structured_scale)]
    found = minimize(lambda point: surprise(cases, at(point)), start, method="Nelder-Mead", options=_ENOUGH)
    best = at(found.x)
    return replace(
        best,
        temperature=round(best.temperature, 2),
        offset=round(best.offset, 2),
        structured_scale=round(best.structured_scale, 1),
    )
