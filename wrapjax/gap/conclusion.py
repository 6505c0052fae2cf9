"""From scores to what is said: refits of what is likely, probabilities, ties, how far the error shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from wrapjax.gap.advice import advise
from wrapjax.gap.certificate import unfinished
from wrapjax.gap.effect import Effect, Effects, NotTestable
from wrapjax.gap.held_out import CrossFit, amount_covariance, cross_fit, speed_conflict
from wrapjax.gap.linearized import LinearGap, phase_frames
from wrapjax.gap.muscle_share import muscle_share
from wrapjax.gap.null import best_null, nulls
from wrapjax.gap.prediction import predicted_moments
from wrapjax.gap.refit import joint_problem
from wrapjax.gap.result import (
    Advice,
    Alternative,
    Amount,
    Certificate,
    EffectFinding,
    Estimate,
    GapResult,
    MuscleShare,
    Released,
)
from wrapjax.gap.score import Candidate, Score, Scored, likeness, score_each
from wrapjax.gap.shrinkage import cycle_errors, shrinkage
from wrapjax.gap.verdict import (
    UNSEEN,
    Tuning,
    credible_set,
    decision,
    judge,
    probabilities,
    tie_of,
)
from wrapjax.gap.where import Where

if TYPE_CHECKING:
    from wrapjax.gap.investigation import Investigation, Watch

#: Effects that are fitted together with all that is calibrated, and that are compared with one another.
REFITS, COMPARED = 3, 8
#: Share of people with nothing amiss whose strongest evidence is above the alarm level.
ALARM_SHARE = 0.025


@dataclass(frozen=True)
class Scene:
    """What is known once effects are scored.

    Parameters
    ----------
    case
        What is looked at.
    effects
        By id, over the calibration cycles.
    gap, sizes
        Straight lines, and standard deviations of measured moments (N m).
    plain, place, certificate
        The plain model: fits to parts of the cycles, what they leave, and whether they are good enough.
    amount_weight
        What a squared prior standard deviation costs in a refit.
    scored, strongest_of_twins
        Of the subject, and the strongest evidence in each person with nothing amiss.
    tuning
        Constants of the verdict.
    """

    case: Investigation
    effects: dict[str, Effect]
    gap: LinearGap
    sizes: Float[np.ndarray, " coordinate"]
    plain: CrossFit
    place: Where
    certificate: Certificate
    amount_weight: float
    scored: Scored
    strongest_of_twins: Float[np.ndarray, " twin"]
    tuning: Tuning

    @property
    def candidates(self) -> dict[str, Candidate]:
        """By id."""
        return {candidate.id: candidate for candidate in self.gap.candidates}

    @property
    def scores(self) -> dict[str, Score]:
        """By id, the strongest evidence first."""
        return {one.id: one for one in sorted(self.scored.scores, key=lambda one: -one.evidence)}


@dataclass(frozen=True)
class _Refitted:
    """An effect, or several, fitted together with what is calibrated."""

    ids: tuple[str, ...]
    effects: Effects
    fit: CrossFit


def conclude(scene: Scene, watch: Watch) -> GapResult:
    """Say which effects explain the error, and how far it shrinks."""
    case, tuning, scores = scene.case, scene.tuning, scene.scores
    evidence = {id: one.evidence for id, one in scores.items()}
    leading = [id for id in scores if evidence[id] > 0.0][:REFITS]
    with watch.during("refits", f"fitting {', '.join(leading) or 'no effect'} with all that is calibrated"):
        refits = {id: _refit(scene, (id,)) for id in leading}
        refitted = _refitted_evidence(scene, refits)
    settled = evidence | refitted
    with watch.during("verdict", "comparing effects"):
        order = sorted(settled, key=lambda id: -settled[id])
        compared = tuple(order[:COMPARED])
        apart = _apart(scene, compared)
        tie = tie_of(order[0], compared, apart, settled) if order else ()
        twins = scene.strongest_of_twins
        alarm = max(tuning.alarm, float(np.quantile(twins, 1.0 - ALARM_SHARE)) if len(twins) else 0.0)
        found = probabilities(settled, scene.scored.structured, tuning)
        controls = [id for id, effect in scene.effects.items() if effect.negative_control]
        verdict = judge(found, settled, tie, alarm, controls)
    accepted = verdict.named or verdict.tie
    shown = [id for id in order if id in refits]
    shown.sort(key=lambda id: (id not in accepted, order.index(id)))
    with watch.during("shrinkage", "measuring how far the error shrinks"):
        alternatives = tuple(_alternative(scene, refits[id]) for id in shown)
    findings = tuple(
        _finding(
            scene, scores[id], found.effects[id], refitted.get(id), refits.get(id), alarm, id in accepted
        )
        for id in sorted(scores, key=lambda id: -found.effects[id])
    )
    hidden = tuple(
        NotTestable(
            id, f"one of expected size would show by {one.detectability:.1f} standard deviations only"
        )
        for id, one in scores.items()
        if one.detectability < UNSEEN
    )
    return GapResult(
        outcome=verdict.outcome,
        reason=verdict.reason,
        named=verdict.named,
        ties=(verdict.tie,) if verdict.tie else (),
        credible_set=credible_set(found, tie, tuning.set_level),
        effects=findings,
        none_probability=found.none,
        unknown_probability=found.unknown,
        not_testable=(*_untestable(case), *hidden),
        withheld=case.withheld,
        coordinates=case.context.coordinates,
        trials=case.context.trials,
        recordings=case.recordings,
        uses=case.uses,
        speeds=case.context.speeds,
        time=case.time,
        measured=case.measured,
        plain=scene.plain.predicted,
        budget=scene.place.budget,
        budget_speeds=scene.place.speeds,
        explainable_share=scene.place.explainable,
        alternatives=alternatives,
        shares={one.ids[0]: one.held_out_cycles.value for one in alternatives if one.held_out_cycles.known},
        likeness=(compared, apart),
        muscles=_muscles(scene),
        alarm=alarm,
        global_p=float((1 + np.sum(twins >= settled[order[0]])) / (1 + len(twins))) if order else 1.0,
        advice=_advice(scene, verdict.tie, compared, apart),
        certificate=scene.certificate,
        seconds=watch.seconds,
    )


def stopped(
    case: Investigation,
    outcome: str,
    reason: str,
    seconds: dict[str, float],
    plain: Float[np.ndarray, "cycle coordinate frame"] | None = None,
    place: Where | None = None,
    certificate: Certificate | None = None,
) -> GapResult:
    """Say why there is no diagnosis, and what is known all the same."""
    nothing = Effects(())
    modelled = case.predict(nothing)(case.variables, np.zeros(0)) if plain is None else plain
    return GapResult(
        outcome=outcome,
        reason=reason,
        named=(),
        ties=(),
        credible_set=(),
        effects=(),
        none_probability=0.0,
        unknown_probability=1.0,
        not_testable=_untestable(case),
        withheld=case.withheld,
        coordinates=case.context.coordinates,
        trials=case.context.trials,
        recordings=case.recordings,
        uses=case.uses,
        speeds=case.context.speeds,
        time=case.time,
        measured=case.measured,
        plain=modelled,
        budget=None if place is None else place.budget,
        budget_speeds=np.zeros(0) if place is None else place.speeds,
        explainable_share=Estimate.unknown(reason) if place is None else place.explainable,
        alternatives=(),
        shares={},
        likeness=((), np.zeros((0, 0))),
        muscles=None,
        alarm=np.nan,
        global_p=np.nan,
        advice=(),
        certificate=certificate or unfinished(case.outcomes, reason),
        seconds=seconds,
    )


def _untestable(case: Investigation) -> tuple[NotTestable, ...]:
    return tuple(entry for entry in case.entries if isinstance(entry, NotTestable))


def _refit(scene: Scene, ids: tuple[str, ...]) -> _Refitted:
    """Fit effects with the same effort as the plain model, from their most plausible amounts."""
    case, scores = scene.case, scene.scores
    shapes = tuple(scores[id].variant for id in ids)
    parts = [scores[id].part for id in ids]
    seen = Effects(tuple(scene.effects[id].only(part) for id, part in zip(ids, parts, strict=True)), shapes)
    known = {entry.id: entry for entry in case.entries if isinstance(entry, Effect)}
    whole = Effects(tuple(known[id].only(part) for id, part in zip(ids, parts, strict=True)), shapes)
    amounts = np.concatenate([scores[id].amounts[list(part)] for id, part in zip(ids, parts, strict=True)])
    start = np.clip(amounts, seen.lower, seen.upper)
    plain = scene.plain.full.calibrated
    problem = joint_problem(case.problem, seen, plain, start, scene.amount_weight)
    fit = cross_fit(
        problem,
        np.concatenate([plain, start / seen.prior_sd]),
        case.plan,
        case.speeds,
        case.predict(whole),
    )
    return _Refitted(ids, seen, fit)


def _refitted_evidence(scene: Scene, refits: dict[str, _Refitted]) -> dict[str, float]:
    """Give the evidence for each effect where its joint fit ended, along the same lines.

    What a straight line made too much or too little of is put right; noise and lines stay what they were,
    so that all hypotheses are judged alike.
    """
    if not refits:
        return {}
    gap, case = scene.gap, scene.case
    cycles, frames = case.plan.calibration, phase_frames(case.measured.shape[-1])
    columns = gap.slopes.reshape(len(gap.slopes), -1)
    expected = scene.plain.full.calibrated - gap.away
    residuals, chosen = [], []
    for id, refit in refits.items():
        full, candidate = refit.fit.full, scene.candidates[id]
        moments = _moments_of(scene, refit)
        left = (case.measured[cycles] - moments)[..., frames].ravel()
        own = list(scene.scores[id].part)
        shape = candidate.variants[scene.scores[id].variant][own]
        residuals.append(left + (full.calibrated - expected) @ columns + full.amounts @ shape)
        chosen.append(Candidate(id, (shape,), candidate.prior_sd[own], candidate.one_sided[own]))
    found = score_each(np.array(residuals), nulls(gap, scene.sizes), chosen)
    before = logsumexp(scene.scored.plausible)
    # Each hypothesis on its own residual; other shapes and parts were plausible before, too.
    return {
        id: float(
            one.scores[place].evidence
            + logsumexp(one.plausible)
            - before
            + scene.candidates[id].log_prior(scene.scores[id].part)
        )
        for place, (id, one) in enumerate(zip(refits, found, strict=True))
    }


def _moments_of(scene: Scene, refit: _Refitted) -> Float[np.ndarray, "cycle coordinate frame"]:
    """Predict the calibration cycles by the fit that has seen them all."""
    problem, full = scene.case.problem, refit.fit.full
    parameters = problem.parameters(jnp.asarray(full.calibrated))
    found = predicted_moments(
        problem.curves, parameters, problem.recording, refit.effects, jnp.asarray(full.amounts)
    )
    return np.asarray(found)


def _apart(scene: Scene, ids: Sequence[str]) -> Float[np.ndarray, "effect effect"]:
    """Say how much of each effect each other one cannot imitate, under what residuals speak for."""
    covariance = best_null(scene.gap, scene.sizes, scene.scored).covariance
    scores, candidates = scene.scores, scene.candidates
    wholes = [candidates[id].variants[scores[id].variant] for id in ids]
    shapes = [whole[list(scores[id].part)] for id, whole in zip(ids, wholes, strict=True)]
    signals = [scores[id].amounts @ whole for id, whole in zip(ids, wholes, strict=True)]
    return np.asarray(likeness(signals, shapes, covariance)) if ids else np.zeros((0, 0))


def _alternative(scene: Scene, refit: _Refitted) -> Alternative:
    case, fit, plain = scene.case, refit.fit, scene.plain
    measured, speeds, floor = case.measured, case.speeds, scene.place.floor
    before, after = (cycle_errors(measured - one.predicted) for one in (plain, fit))
    held = np.array([use != "calibration" for use in case.uses]) & ~case.plan.new_speed
    # Where few cycles were kept for validation, those left out one by one count as well.
    counted = (
        held if held.sum() >= 2 * len(case.plan.counts) and len(case.plan.counts) else ~case.plan.new_speed
    )
    return Alternative(
        ids=refit.ids,
        predicted=fit.predicted,
        held_out_cycles=shrinkage(before[counted], after[counted], floor[counted], speeds[counted]),
        held_out_speed=_at_other_speed(scene, fit),
        gains=tuple(
            float(np.mean((before - after)[case.plan.calibration[block]])) for block in case.plan.blocks
        ),
        speed_conflict=speed_conflict(fit, scene.amount_weight),
        released=_released(scene, fit),
    )


def _at_other_speed(scene: Scene, fit: CrossFit) -> Estimate:
    case, plain = scene.case, scene.plain
    if plain.at_other_speed is None or fit.at_other_speed is None:
        return Estimate.unknown("one speed was recorded")
    counted = case.plan.new_speed if case.plan.new_speed.any() else np.ones(len(case.uses), dtype=bool)
    before, after = (
        cycle_errors(case.measured - np.asarray(one.at_other_speed))[counted] for one in (plain, fit)
    )
    return shrinkage(before, after, scene.place.floor[counted], case.speeds[counted])


def _released(scene: Scene, fit: CrossFit) -> tuple[Released, ...]:
    """Compare what was calibrated without and with the effect."""
    problem = scene.case.problem
    before, after = scene.plain.full.calibrated, fit.full.calibrated
    sd = np.sqrt(np.sum(scene.gap.spread**2, axis=1))
    stuck = (before <= np.asarray(problem.lower)) | (before >= np.asarray(problem.upper))
    rows = zip(problem.variables.labels, before, after, sd, stuck, strict=True)
    return tuple(
        Released(label, float(was), float(now), float(spread), bool(held))
        for label, was, now, spread, held in rows
    )


def _finding(
    scene: Scene,
    score: Score,
    probability: float,
    refitted: float | None,
    refit: _Refitted | None,
    alarm: float,
    accepted: bool,
) -> EffectFinding:
    effect = scene.effects[score.id]
    amounts, sd = score.amounts, score.sd
    if refit is not None:
        own = list(score.part)
        amounts, sd = np.zeros(len(score.amounts)), np.zeros(len(score.amounts))
        amounts[own] = refit.fit.full.amounts
        sd[own] = np.sqrt(np.diag(amount_covariance(refit.fit.full, scene.amount_weight)))
    return EffectFinding(
        id=score.id,
        probability=probability,
        evidence=score.evidence,
        refitted=refitted,
        detectability=score.detectability,
        decision=decision(
            score.evidence if refitted is None else refitted, score.detectability, alarm, accepted
        ),
        amounts=_amounts(effect, amounts, sd),
        negative_control=effect.negative_control,
    )


def _amounts(
    effect: Effect, amounts: Float[np.ndarray, " amount"], sd: Float[np.ndarray, " amount"]
) -> tuple[Amount, ...]:
    """Read amounts in what is reported; deviations by differences."""
    values = {name: float(value) for name, value in effect.readings(jnp.asarray(amounts)).items()}
    spread = dict.fromkeys(values, 0.0)
    for place, own in enumerate(sd):
        moved = np.array(amounts, dtype=float)
        moved[place] += 1e-3 * own
        for name, value in effect.readings(jnp.asarray(moved)).items():
            spread[name] += ((float(value) - values[name]) / 1e-3) ** 2
    units = dict(effect.reported) or {entry.name: entry.unit for entry in effect.parameters}
    return tuple(
        Amount(name, value, float(np.sqrt(spread[name])), units[name]) for name, value in values.items()
    )


def _muscles(scene: Scene) -> MuscleShare:
    case, gap = scene.case, scene.gap
    cycles, frames = case.plan.calibration, phase_frames(case.measured.shape[-1])
    residual = scene.place.residual[cycles][..., frames]
    force = np.asarray(case.context.parameters.max_isometric_force)
    within = np.concatenate(
        [
            residual[gap.speeds == speed] - residual[gap.speeds == speed].mean(axis=0)
            for speed in set(gap.speeds)
        ]
    )
    arms = gap.muscle_errors.arms / force[:, None, None, None]
    return muscle_share(
        case.context.muscles, residual, arms, force, within.std(axis=(0, 2)), np.asarray(gap.speeds)
    )


def _advice(
    scene: Scene,
    tie: Sequence[str],
    compared: Sequence[str],
    apart: Float[np.ndarray, "effect effect"],
) -> tuple[Advice, ...]:
    if not tie:
        return ()
    places = [compared.index(id) for id in tie]
    pairs = [max(apart[one, other], apart[other, one]) for one in places for other in places if one < other]
    found = advise(tie, float(min(pairs)), len(scene.case.plan.calibration))
    return () if found is None else (found,)
