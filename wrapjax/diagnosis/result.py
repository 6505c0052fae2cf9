"""Result of a diagnosis as plain arrays, assembled from the results of all steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.advice import Advice, advise
from wrapjax.diagnosis.claims.decision import Decision, describe_effect
from wrapjax.diagnosis.claims.gates import Gates
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, family_probabilities
from wrapjax.diagnosis.effects.effect import Effect, Effects, NotTestable
from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.evidence.other_tasks import TaskEvidence
from wrapjax.diagnosis.evidence.score import Scores
from wrapjax.diagnosis.evidence.score_test import MIN_DETECTABILITY, Score
from wrapjax.diagnosis.fits.baseline import BaselineFit, ConvergenceCheck, unchecked_convergence
from wrapjax.diagnosis.fits.joint_fit import effect_size_covariance
from wrapjax.diagnosis.fits.refit import Ids, Refit
from wrapjax.diagnosis.fits.verification import Verification, VerifiedRefit, shapley_values
from wrapjax.diagnosis.inputs.input import DiagnosisInput
from wrapjax.diagnosis.localization import BINS, ErrorBudget, Localization, MuscleShare
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import CapacityShare, undriven_capacity
from wrapjax.diagnosis.uncertain_joints import UncertainJoints


@dataclass(frozen=True)
class EffectSize:
    """Value and standard deviation of one reported quantity of an effect, in physical units."""

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class EffectFinding:
    """Finding on one effect that is testable with this recording.

    Parameters
    ----------
    id
        Identifier of the effect.
    probability
        Probability among all effects, no effect, and causes outside the catalogue; 0 to 1.
    evidence
        Log Bayes factor of the effect against no effect, nats.
    detectability
        Signal-to-noise ratio of an effect of its prior size, d'; below 2 this recording could not show it.
    decision
        Phrase that describes the decision on the effect.
    effect_sizes
        Most plausible effect sizes.
    negative_control
        Whether the effect cannot be present in such a recording.
    """

    id: str
    probability: float
    evidence: float
    detectability: float
    decision: str
    effect_sizes: tuple[EffectSize, ...]
    negative_control: bool = False


@dataclass(frozen=True)
class DiagnosisResult:
    """Where the moment error is, which effect explains it best, and how far it shrinks.

    Parameters
    ----------
    outcome, reason
        One of `decision.OUTCOMES`, and a sentence that gives the reason.
    named, ties, credible_set
        Identifiers of effects; see `decision.Decision`. The set may contain ``none_of_these``.
    effects
        Findings on all effects that could be tested, the most probable first.
    none_probability, unknown_probability
        Probability of no effect, and of a cause outside the catalogue.
    not_testable, withheld
        Effects for which the subject or the recording lacks something, and those left out of the catalogue on
        request.
    coordinates, trials, recordings, uses, speeds, time
        Names of the coordinates; and name, recording, use, speed (m/s, NaN if unknown) and time (s) of each
        cycle.
    measured, plain
        Measured joint moments, and those of the plain model from fits that did not use the cycle, N m.
    budget, budget_speeds
        Parts of the plain model's error, and the speed of each row, m/s; None with too few cycles.
    error_map
        Root mean square of the repeatable error, N m, by speed as the budget; empty where that is None.
    explainable_share
        Share of the error above the noise floor.
    refits
        Refits with effects, the most probable first.
    shares
        Share of the explainable error that each named effect removes: Shapley values over all orders.
    distinguishability
        Identifiers, and the squared distance of each effect (row) from the span of each other one (column),
        in squared standard deviations.
    muscle_share
        Muscle forces that would remove the error; None without a diagnosis.
    detection_threshold, global_p
        Evidence that few null replicates exceed, nats; and the share of null replicates whose strongest
        evidence reaches that of the subject.
    advice
        Experiments that would tell members of a tie apart.
    convergence_check
        Whether the baseline fit may be used.
    seconds
        Time of each step, s.
    linearized
        Linearised model that was scored; None without a diagnosis.
    family, family_probability, credible_families, best_partial, gates
        See `decision.Decision`; the probability is that of the named family.
    muscle_law, law_evidence
        Parameters of the muscle law of the person, by name; and evidence for published laws against it, nats.
    undriven_capacity
        Share of the moment capacity of muscles without EMG, by coordinate.
    task_evidence
        What tasks other than gait added to the evidence; None if there are none.
    joints
        What uncertain places of joints do; None without a diagnosis, or where the recording does not show it.
    undetectable
        Those of ``effects`` that this recording would not show if they had their expected size.
    """

    outcome: str
    reason: str
    named: tuple[str, ...]
    ties: tuple[tuple[str, ...], ...]
    credible_set: tuple[str, ...]
    effects: tuple[EffectFinding, ...]
    none_probability: float
    unknown_probability: float
    not_testable: tuple[NotTestable, ...]
    withheld: tuple[str, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    recordings: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " cycle"]
    time: Float[np.ndarray, "cycle frame"]
    measured: Float[np.ndarray, "cycle coordinate frame"]
    plain: Float[np.ndarray, "cycle coordinate frame"]
    budget: ErrorBudget | None
    budget_speeds: Float[np.ndarray, " speed"]
    error_map: Float[np.ndarray, "speed coordinate bin"]
    explainable_share: Estimate
    refits: tuple[VerifiedRefit, ...]
    shares: dict[str, float]
    distinguishability: tuple[tuple[str, ...], Float[np.ndarray, "effect effect"]]
    muscle_share: MuscleShare | None
    detection_threshold: float
    global_p: float
    advice: tuple[Advice, ...]
    convergence_check: ConvergenceCheck
    seconds: dict[str, float]
    linearized: LinearizedModel | None = None
    family: str = ""
    family_probability: float = 0.0
    credible_families: tuple[str, ...] = ()
    best_partial: tuple[str, ...] = ()
    gates: Gates | None = None
    muscle_law: dict[str, float] = field(default_factory=dict)
    law_evidence: dict[str, float] = field(default_factory=dict)
    undriven_capacity: Mapping[str, CapacityShare] = field(default_factory=dict)
    task_evidence: TaskEvidence | None = None
    joints: UncertainJoints | None = None
    undetectable: tuple[NotTestable, ...] = ()


def result_without_diagnosis(
    data: DiagnosisInput,
    outcome: str,
    reason: str,
    seconds: dict[str, float],
    baseline: BaselineFit | None = None,
    localization: Localization | None = None,
) -> DiagnosisResult:
    """Assemble the result of a diagnosis that ended before effects were scored.

    Parameters
    ----------
    data
        Input of the diagnosis.
    outcome, reason
        Outcome, and a sentence that gives the reason.
    seconds
        Time of each step, s.
    baseline, localization
        Results of the steps before the end; None where they were not run.
    """
    if baseline is None:
        plain = data.prediction(Effects(()))(data.variables, np.zeros(0))
        check = unchecked_convergence(data.outcomes, reason)
    else:
        plain, check = baseline.fit.predicted, baseline.convergence_check
    return DiagnosisResult(
        outcome=outcome,
        reason=reason,
        named=(),
        ties=(),
        credible_set=(),
        effects=(),
        none_probability=0.0,
        unknown_probability=1.0,
        # Nuisance effects are never named, so that it does not matter to a reader that one is missing.
        not_testable=tuple(
            entry
            for entry in data.entries
            if isinstance(entry, NotTestable) and not CATALOGUE[entry.id].nuisance
        ),
        withheld=data.withheld,
        coordinates=data.context.coordinates,
        trials=data.context.trials,
        recordings=data.recordings,
        uses=data.uses,
        speeds=data.context.speeds,
        time=data.time,
        measured=data.measured,
        plain=plain,
        budget=None if localization is None else localization.budget,
        budget_speeds=np.zeros(0) if localization is None else localization.speeds,
        error_map=(
            np.zeros((0, len(data.context.coordinates), BINS))
            if localization is None
            else localization.error_map
        ),
        explainable_share=(
            Estimate.unknown(reason) if localization is None else localization.explainable_share
        ),
        refits=(),
        shares={},
        distinguishability=((), np.zeros((0, 0))),
        muscle_share=None,
        detection_threshold=np.nan,
        global_p=np.nan,
        advice=(),
        convergence_check=check,
        seconds=seconds,
        muscle_law=data.law.law,
        undriven_capacity=undriven_capacity(data.context),
    )


def diagnosis_result(
    *,
    data: DiagnosisInput,
    baseline: BaselineFit,
    linearized: LinearizedModel,
    localization: Localization,
    scores: Scores,
    refits: Mapping[Ids, Refit],
    verification: Verification,
    decision: Decision,
    law_evidence: dict[str, float],
    seconds: dict[str, float],
    task_evidence: TaskEvidence | None = None,
    joints: UncertainJoints | None = None,
) -> DiagnosisResult:
    """Assemble the result of a diagnosis from the results of all steps.

    Parameters
    ----------
    data, baseline, linearized, localization, scores
        Results of the steps up to the scores.
    refits
        Refits of single effects; their effect sizes are reported.
    verification, decision
        Verified refits, and the decision.
    law_evidence
        Evidence for published muscle laws, nats.
    seconds
        Time of each step, s.
    task_evidence
        What tasks other than gait added to the evidence.
    joints
        What uncertain places of joints do.
    """
    probability = decision.probabilities
    assert probability is not None
    findings = tuple(
        _finding(data, baseline, scores, decision, scores.by_id[id], refits.get((id,)))
        for id in sorted(scores.by_id, key=lambda id: -probability.effects[id])
    )
    undetectable = tuple(
        NotTestable(
            id, f"one of expected size would show by {one.detectability:.1f} standard deviations only"
        )
        for id, one in scores.by_id.items()
        # A larger effect than expected can show where one of expected size could not.
        if one.detectability < MIN_DETECTABILITY
        and one.evidence <= scores.detection_threshold
        and id not in (*decision.accepted, *decision.best_partial)
    )
    hidden = {entry.id for entry in undetectable}
    shown = _shown_refits(decision, verification, [ids for ids in refits if not hidden.intersection(ids)])
    result = result_without_diagnosis(
        data, decision.outcome, decision.reason, seconds, baseline, localization
    )
    return replace(
        result,
        law_evidence=law_evidence,
        named=decision.named,
        ties=(decision.tie,) if decision.tie else (),
        credible_set=decision.credible_set,
        effects=findings,
        none_probability=probability.none,
        unknown_probability=probability.unknown,
        undetectable=undetectable,
        refits=shown,
        shares=_shares(shown, decision.named),
        distinguishability=(scores.compared, scores.distinguishability),
        muscle_share=localization.muscle_share,
        detection_threshold=scores.detection_threshold,
        global_p=scores.global_p,
        advice=_advice(data, scores, decision.tie),
        linearized=linearized,
        family=decision.family,
        family_probability=family_probabilities(probability.effects).get(decision.family, 0.0),
        credible_families=decision.credible_families,
        best_partial=decision.best_partial,
        gates=decision.gates,
        task_evidence=task_evidence,
        joints=joints,
    )


def _shown_refits(
    decision: Decision, verification: Verification, singles: Sequence[Ids]
) -> tuple[VerifiedRefit, ...]:
    """Order refits: those of accepted effects first, jointly named ones before their subsets.

    Refits of subsets are shown only where several effects are named.
    """
    if len(decision.named) > 1:
        sizes = range(len(decision.named), 0, -1)
        first = [subset for size in sizes for subset in combinations(decision.named, size)]
    else:
        first = [ids for ids in singles if ids[0] in decision.accepted]
    others = [ids for ids in singles if ids not in first]
    return tuple(verification.refits[ids] for ids in (*first, *others))


def _shares(refits: Sequence[VerifiedRefit], named: Ids) -> dict[str, float]:
    """Distribute the shrinkage by named effects; not for a tie, whose members would remove the same error."""
    removed = {one.ids: one.held_out_cycles.value for one in refits if one.held_out_cycles.known}
    if not all(part in removed for size in range(len(named)) for part in combinations(named, size + 1)):
        return {}
    return shapley_values(named, lambda part: removed[part] if part else 0.0)


def _finding(
    data: DiagnosisInput,
    baseline: BaselineFit,
    scores: Scores,
    decision: Decision,
    score: Score,
    refit: Refit | None,
) -> EffectFinding:
    """Report an effect with the sizes of its refit where there is one, else with those of its score."""
    assert decision.probabilities is not None
    effect = data.calibration_effects[score.id]
    effect_sizes, sd = score.effect_sizes, score.sd
    if refit is not None:
        part = list(score.part)
        effect_sizes, sd = np.zeros(len(score.effect_sizes)), np.zeros(len(score.effect_sizes))
        effect_sizes[part] = refit.fit.effect_sizes
        sd[part] = np.sqrt(np.diag(effect_size_covariance(refit.fit, baseline.effect_size_weight)))
    return EffectFinding(
        id=score.id,
        probability=decision.probabilities.effects[score.id],
        evidence=score.evidence,
        detectability=score.detectability,
        decision=describe_effect(
            score.evidence,
            score.detectability,
            scores.detection_threshold,
            named=score.id in decision.accepted,
            refused=score.id in decision.best_partial,
        ),
        effect_sizes=_reported_sizes(effect, effect_sizes, sd),
        negative_control=effect.negative_control,
    )


def _reported_sizes(
    effect: Effect, effect_sizes: Float[np.ndarray, " parameter"], sd: Float[np.ndarray, " parameter"]
) -> tuple[EffectSize, ...]:
    """Convert effect sizes to the reported quantities; their standard deviations by finite differences."""
    values = {name: float(value) for name, value in effect.reported_values(jnp.asarray(effect_sizes)).items()}
    variances = dict.fromkeys(values, 0.0)
    for place, deviation in enumerate(sd):
        moved = np.array(effect_sizes, dtype=float)
        moved[place] += 1e-3 * deviation
        for name, value in effect.reported_values(jnp.asarray(moved)).items():
            variances[name] += ((float(value) - values[name]) / 1e-3) ** 2
    units = dict(effect.reported) or {entry.name: entry.unit for entry in effect.parameters}
    return tuple(
        EffectSize(name, value, float(np.sqrt(variances[name])), units[name])
        for name, value in values.items()
    )


def _advice(data: DiagnosisInput, scores: Scores, tie: Sequence[str]) -> tuple[Advice, ...]:
    """Advise on the experiment that tells members of a tie apart."""
    if not tie:
        return ()
    places = [scores.compared.index(id) for id in tie]
    distances = scores.distinguishability
    pairs = [
        max(distances[one, other], distances[other, one]) for one in places for other in places if one < other
    ]
    advice = advise(tie, float(min(pairs)), len(data.plan.calibration))
    return () if advice is None else (advice,)
