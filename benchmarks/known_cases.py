"""Cases of a development bank, with their truth, as every null hypothesis sees them: scored in a moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.banks import CLEAR
from benchmarks.lines import Lines, development_lines
from wrapjax.gap.conclude.verdict import Probabilities
from wrapjax.gap.evidence.null import nulls
from wrapjax.gap.evidence.projection import Candidate, Projection, project
from wrapjax.gap.evidence.score import score_projected

#: What a truth without any effect is called among probabilities; pairs have no one right name.
_OTHERWISE = {"none": "none", "outside": "unknown"}
#: Nats by which a null is less likely than the likeliest.
_RULED_OUT = 12.0


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


@dataclass(frozen=True)
class Known:
    """A case through every null hypothesis, and its truth.

    Parameters
    ----------
    truth
        Of the bank.
    candidates
        Its effects.
    projections
        One a null.
    """

    truth: dict[str, Any]
    candidates: tuple[Candidate, ...]
    projections: tuple[Projection, ...]

    def scored(self) -> Scored:
        """Score effects."""
        (found,) = score_projected(self.projections, self.candidates)
        return Scored(self.truth, {one.id: one.evidence for one in found.scores}, found.structured)


def read(bank: Path, lines: Path) -> list[Known]:
    """Take in all cases whose lines are there; raises what `development_lines` does."""
    found = []
    for truth, own in development_lines(bank, lines):
        candidates = own.gap.candidates
        residual = own.gap.residual.reshape(1, -1)
        found.append(Known(truth, candidates, _seen(residual, own, candidates)))
    return found


def _seen(
    residual: Float[np.ndarray, "1 row"], lines: Lines, candidates: Sequence[Candidate]
) -> tuple[Projection, ...]:
    """Look through every null but those that the residual rules out; the first is what others count from."""
    first, *others = (project(residual, null, candidates) for null in nulls(lines.gap, lines.sizes))
    likeliest = max(float(one.weight[0]) for one in (first, *others))
    return (first, *(one for one in others if one.weight[0] > likeliest - _RULED_OUT))


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
