"""Cases of a development bank scored in their linearized models, with their truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from validation.diagnosis.bank_cases import CLEAR
from validation.diagnosis.linearizations import LinearizedCase, development_files, load_valid
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.claims.claim import apply_gates, claimed_effects, with_family
from wrapjax.diagnosis.claims.decision import (
    Decision,
    DecisionConstants,
    Probabilities,
    decide_on_single_effect,
    family_levels,
    probabilities,
    probabilities_of_refused,
    set_levels,
    tied_effects,
)
from wrapjax.diagnosis.claims.gates import (
    MOST_DEVIATIONS,
    Adequate,
    Gates,
    adequacy,
    moment_accuracy,
    part_scores,
    plausibility,
    scaled_signatures,
    specificity,
    stability,
)
from wrapjax.diagnosis.claims.residual_fit import ResidualModel
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, family_of
from wrapjax.diagnosis.evidence.score import score
from wrapjax.diagnosis.evidence.score_test import Score
from wrapjax.errors import InputError, Problem
from wrapjax.progress import print_progress

_CONTROLS = tuple(id for id, one in CATALOGUE.items() if one.negative_control)
#: World in which names are not scored, and which no constant is fitted to: its model errors are larger than
#: any effect.
GROSS_MISFIT = "gross_misfit"
#: Correct outcome of cases without a cause in the catalogue; pairs have no single correct answer.
OUTCOMES = {"none": "none", "outside": "unknown"}
_ADEQUATE = Adequate(1.0, 1.0)


@dataclass(frozen=True)
class ScoredCase:
    """Score of a case, with its truth.

    Parameters
    ----------
    truth
        Truth of the case.
    evidence
        Log Bayes factor of each effect, nats.
    plain, accuracy
        Gate for an adequate plain model, with a factor of one; and the accuracy of the moments, N m.
    claim
        What the gates need for a claim of the strongest effect; None if it was not computed.
    detectability
        d' of each effect of its prior size, see `Score`.
    """

    truth: dict[str, Any]
    evidence: Mapping[str, float]
    plain: Adequate = _ADEQUATE
    accuracy: float = 0.0
    claim: StrongestEffect | None = None
    detectability: Mapping[str, float] = field(default_factory=dict)

    @property
    def left(self) -> float:
        """Repeatable error that the plain model leaves, relative to what a factor of one allows."""
        return self.error_left(1.0)

    def error_left(self, adequacy_factor: float) -> float:
        """Repeatable error that the plain model leaves, relative to what the gate allows by this factor."""
        return self.plain.left_rms / max(adequacy_factor * self.plain.floor_rms, self.accuracy)

    def stated(self, constants: DecisionConstants) -> Probabilities:
        """Probabilities by these constants, after the gates if these were computed."""
        if self.claim is None:
            return self.stated_by_evidence(constants)
        stated = decision_on(self, constants).probabilities
        assert stated is not None
        return stated

    def stated_by_evidence(self, constants: DecisionConstants) -> Probabilities:
        """Probabilities by these constants without regard to gates."""
        return probabilities(self.evidence, self.error_left(constants.adequacy_factor), constants)

    @property
    def accepted(self) -> set[str]:
        """Effects that are correct to name: the causes, and those tied with them."""
        return {*(cause["id"] for cause in self.truth["causes"]), *self.truth["ties"]}

    @property
    def clear(self) -> bool:
        """Whether it has a single, identifiable cause."""
        return bool(self.truth["tier"] == "single" and self.truth["d_star"] > CLEAR)

    @property
    def background(self) -> bool:
        """Whether the laboratory or the model has a detectable defect beside the cause."""
        return float((self.truth.get("background") or {}).get("d_star", 0.0)) > CLEAR

    @property
    def nothing_amiss(self) -> bool:
        """Whether it has neither a cause nor a detectable background."""
        return bool(self.truth["tier"] == "none" and not self.background)

    @property
    def ranked(self) -> list[str]:
        """Effects by decreasing evidence."""
        return sorted(self.evidence, key=lambda id: -self.evidence[id])

    def set_level(self, stated: Probabilities) -> float | None:
        """Return the level above which a credible set covers the case; None as in `correct_probability`."""
        if self.correct_probability(stated) is None:
            return None
        correct = self.accepted if self.truth["tier"] == "single" else {"none_of_these"}
        levels = set_levels(stated, () if self.claim is None else self.claim.tie)
        return min((level for ids, level in levels.items() if correct & set(ids)), default=1.0)

    def family_level(self, stated: Probabilities) -> float | None:
        """Return the level above which a credible set of families covers the case; None as in `set_level`.

        Also None for a cause that is no effect of the catalogue under its own name.
        """
        if self.correct_probability(stated) is None:
            return None
        if self.truth["tier"] == "single":
            correct = {family_of(id) for id in self.accepted if id in CATALOGUE}
        else:
            correct = {"none_of_these"}
        levels = family_levels(stated)
        return min((level for id, level in levels.items() if id in correct), default=1.0) if correct else None

    def correct_probability(self, stated: Probabilities) -> float | None:
        """Return the probability of the correct answers; None where no single answer is correct."""
        tier = self.truth["tier"]
        if tier == "pair" or (tier == "none" and self.background):
            return None
        if tier in OUTCOMES:
            return float(getattr(stated, OUTCOMES[tier]))
        return sum(share for id, share in stated.effects.items() if id in self.accepted)


@dataclass(frozen=True)
class StrongestEffect:
    """Gates of the strongest effect of a case, and what a decision needs beside its evidence.

    The gates are those of linearised fits: no refit is made.

    Parameters
    ----------
    tie
        The effect and those that cannot be told from it.
    undetectable
        Effects that the recording could not show.
    null_threshold
        Evidence that few null replicates exceed, nats.
    gates
        Gates for a claim of this effect alone; the factor of the gate for adequate models is one.
    parts
        Scores of all effects on each part of the recording.
    """

    tie: tuple[str, ...]
    undetectable: tuple[str, ...]
    null_threshold: float
    gates: Gates
    parts: Mapping[str, Sequence[Score]]


def score_cases(bank: Path, lines: Path, workers: int) -> list[ScoredCase]:
    """Score all linearized cases, in their order, in this number of processes.

    Raises
    ------
    InputError
        Those of `development_linearizations`; or if a case cannot be scored.
    OSError
        If a truth file is missing.
    """
    files = development_files(bank, lines)
    jobs = {file.stem: (truth, file) for file, truth in files.items()}
    scored = {}
    for number, one in enumerate(run_jobs(_score_file, jobs, workers=workers), 1):
        if one.failure:
            raise InputError(Problem(one.name, f"not scored: {one.failure}"))
        scored[one.name] = one.value
        print_progress(f"scored {number} of {len(jobs)}")
    return [scored[name] for name in jobs]


def _score_file(job: tuple[dict[str, Any], Path]) -> ScoredCase:
    truth, file = job
    return score_case(truth, load_valid(file))


def score_case(truth: dict[str, Any], own: LinearizedCase) -> ScoredCase:
    """Score a linearized case, and examine the claim of its strongest effect."""
    linearized = own.linearized
    scores = score(linearized, own.recorded.measured_moment_sd, own.null_residuals, 0.0)
    model = ResidualModel.of(linearized)
    plain = adequacy(model, linearized, own.null_residuals, linearized.nuisances[:0])
    strongest = next(iter(scores.by_id.values()))
    signatures = scaled_signatures(linearized, strongest)
    parts = part_scores(linearized, own.recorded.measured_moment_sd)
    tie = tied_effects(strongest.id, scores.compared, scores.distinguishability, scores.evidence)
    candidate = next(one for one in linearized.candidates if one.id == strongest.id)
    limit = np.minimum(candidate.limit, MOST_DEVIATIONS * candidate.prior_sd)
    sizes = [
        (strongest.id, float(strongest.effect_sizes[place]), float(limit[place]), "1")
        for place in strongest.part
    ]
    gates = Gates(
        adequacy(model, linearized, own.null_residuals, signatures),
        plausibility(sizes),
        stability(parts, tie, scores.detection_threshold),
        specificity(model, linearized, own.recorded, signatures),
    )
    claim = StrongestEffect(
        tie,
        tuple(id for id, one in scores.by_id.items() if not one.detectable),
        scores.detection_threshold,
        gates,
        parts,
    )
    return ScoredCase(
        truth,
        scores.evidence,
        plain,
        moment_accuracy(own.recorded.measured_moment_sd),
        claim,
        {id: one.detectability for id, one in scores.by_id.items()},
    )


def decision_on(case: ScoredCase, constants: DecisionConstants, ignored: Sequence[str] = ()) -> Decision:
    """Decide on a case from its linearised model; see the module for what this leaves out.

    Parameters
    ----------
    case, constants
        Scored case, and constants of the decision.
    ignored
        Names of gates that every claim passes.
    """
    assert case.claim is not None
    threshold = max(constants.least_detection_threshold, case.claim.null_threshold)
    stated = case.stated_by_evidence(constants)
    decision = decide_on_single_effect(
        stated, case.evidence, case.claim.tie, threshold, _CONTROLS, case.claim.undetectable
    )
    decision = with_family(replace(decision, probabilities=stated), case.evidence, threshold)
    together, any_of = claimed_effects(decision, case.evidence)
    found = case.claim.gates

    def allowed(gate: Adequate) -> Adequate:
        floor = max(constants.adequacy_factor * gate.floor_rms, case.accuracy)
        return replace(gate, floor_rms=np.inf if "adequate" in ignored else floor)

    if not together:
        return apply_gates(decision, Gates(allowed(case.plain)), ())
    stable = stability(case.claim.parts, any_of, threshold)
    gates = Gates(
        allowed(found.adequate),
        None if "plausible" in ignored else found.plausible,
        None if "stable" in ignored else stable,
        None if "specific" in ignored else found.specific,
    )
    decision = apply_gates(decision, gates, decision.accepted or together)
    if not gates.failed:
        return decision
    left = case.error_left(constants.adequacy_factor)
    return replace(decision, probabilities=probabilities_of_refused(case.evidence, left, constants))


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
