"""Cases of a development bank: what a score says along their straight lines, beside their truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.diagnosis.bank_cases import CLEAR
from validation.diagnosis.linearizations import development_lines
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.score import score_each
from wrapjax.diagnosis.verdict import Probabilities

#: What a truth without any effect is called among probabilities; pairs have no one right name.
_OTHERWISE = {"none": "none", "outside": "unknown"}


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

    @property
    def accepted(self) -> set[str]:
        """Effects that are right to name: the causes, and what the simulator cannot tell from them."""
        return {*(cause["id"] for cause in self.truth["causes"]), *self.truth["ties"]}

    @property
    def clear(self) -> bool:
        """Whether it has one cause, that can be found at all."""
        return bool(self.truth["tier"] == "single" and self.truth["d_star"] > CLEAR)

    @property
    def ranked(self) -> list[str]:
        """Effects, the strongest evidence first."""
        return sorted(self.evidence, key=lambda id: -self.evidence[id])

    def right(self, found: Probabilities) -> float | None:
        """Give the probability of what is true of the case; None for a pair."""
        tier = self.truth["tier"]
        if tier == "pair":
            return None
        if tier in _OTHERWISE:
            return float(getattr(found, _OTHERWISE[tier]))
        return sum(share for id, share in found.effects.items() if id in self.accepted)


def read(bank: Path, lines: Path) -> list[Scored]:
    """Score all cases whose lines are there; raises what `development_lines` does."""
    found = []
    for truth, own in development_lines(bank, lines):
        residual = own.gap.residual.reshape(1, -1)
        (scored,) = score_each(residual, nulls(own.gap, own.sizes), own.gap.candidates)
        found.append(Scored(truth, {one.id: one.evidence for one in scored.scores}, scored.structured))
    return found


def ranking(cases: Sequence[Scored]) -> str:
    """Say how often the cause is first and among three, over all cases with a clear one and by EMG noise."""

    def first_of(own: Sequence[Scored]) -> str:
        return f"{sum(one.ranked[0] in one.accepted for one in own)} of {len(own)}"

    clear = [one for one in cases if one.clear]
    three = sum(bool(set(one.ranked[:3]) & one.accepted) for one in clear)
    levels = sorted({one.truth["emg_noise"] for one in clear})
    by_noise = (
        f"{first_of([one for one in clear if one.truth['emg_noise'] == level])} at {level:.0%}"
        for level in levels
    )
    return f"first {first_of(clear)} (EMG noise: {', '.join(by_noise)}), among three {three}"
