"""Cases of a development bank scored in their linearized models, with their truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.diagnosis.bank_cases import CLEAR
from validation.diagnosis.linearizations import development_linearizations
from wrapjax.diagnosis.decision import Probabilities
from wrapjax.diagnosis.gates import adequacy
from wrapjax.diagnosis.null_covariance import nulls
from wrapjax.diagnosis.residual_fit import ResidualModel
from wrapjax.diagnosis.score_test import score_each

#: Correct outcome of cases without a cause in the catalogue; pairs have no single correct answer.
_OUTCOMES = {"none": "none", "outside": "unknown"}


@dataclass(frozen=True)
class ScoredCase:
    """Score of a case, with its truth.

    Parameters
    ----------
    truth
        Truth of the case.
    evidence, structured
        Log Bayes factor of each effect, and evidence for a structured residual, see `probabilities`; nats.
    left
        Repeatable error that the plain model leaves, relative to the 95th percentile of null replicates.
    """

    truth: dict[str, Any]
    evidence: Mapping[str, float]
    structured: float
    left: float = 1.0

    @property
    def accepted(self) -> set[str]:
        """Effects that are correct to name: the causes, and those tied with them."""
        return {*(cause["id"] for cause in self.truth["causes"]), *self.truth["ties"]}

    @property
    def clear(self) -> bool:
        """Whether it has a single, identifiable cause."""
        return bool(self.truth["tier"] == "single" and self.truth["d_star"] > CLEAR)

    @property
    def ranked(self) -> list[str]:
        """Effects by decreasing evidence."""
        return sorted(self.evidence, key=lambda id: -self.evidence[id])

    def correct_probability(self, stated: Probabilities) -> float | None:
        """Return the probability of the correct answers; None for a pair."""
        tier = self.truth["tier"]
        if tier == "pair":
            return None
        if tier in _OUTCOMES:
            return float(getattr(stated, _OUTCOMES[tier]))
        return sum(share for id, share in stated.effects.items() if id in self.accepted)


def score_cases(bank: Path, lines: Path) -> list[ScoredCase]:
    """Score all linearized cases; raises the errors of `development_linearizations`."""
    found = []
    for truth, own in development_linearizations(bank, lines):
        residual = own.linearized.residual.reshape(1, -1)
        (scored,) = score_each(
            residual, nulls(own.linearized, own.recorded.measured_moment_sd), own.linearized.candidates
        )
        linearized = own.linearized
        adequate = adequacy(
            ResidualModel.of(linearized), linearized, own.null_residuals, linearized.nuisances[:0]
        )
        found.append(
            ScoredCase(
                truth,
                {one.id: one.evidence for one in scored.scores},
                scored.structured_evidence,
                adequate.left_rms / adequate.floor_rms,
            )
        )
    return found


def ranking(cases: Sequence[ScoredCase]) -> str:
    """Describe how often an identifiable cause is first and among the first three, and by EMG noise."""

    def first_of(own: Sequence[ScoredCase]) -> str:
        return f"{sum(one.ranked[0] in one.accepted for one in own)} of {len(own)}"

    clear = [one for one in cases if one.clear]
    three = sum(bool(set(one.ranked[:3]) & one.accepted) for one in clear)
    levels = sorted({one.truth["emg_noise"] for one in clear})
    by_noise = (
        f"{first_of([one for one in clear if one.truth['emg_noise'] == level])} at {level:.0%}"
        for level in levels
    )
    return f"first {first_of(clear)} (EMG noise: {', '.join(by_noise)}), among three {three}"
