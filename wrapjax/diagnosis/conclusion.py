"""From scores to what is said: refits of what is likely, probabilities, ties, how far the error shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.advice import advise
from wrapjax.diagnosis.alternatives import Refitted, alternative, refit
from wrapjax.diagnosis.case import DiagnosisInput, Look, Scene
from wrapjax.diagnosis.convergence_check import unfinished
from wrapjax.diagnosis.effects.effect import Effect, Effects, NotTestable
from wrapjax.diagnosis.error_budget import BINS
from wrapjax.diagnosis.held_out import effect_size_covariance
from wrapjax.diagnosis.linearization import phase_frames
from wrapjax.diagnosis.muscle_share import muscle_share
from wrapjax.diagnosis.null import best_null
from wrapjax.diagnosis.result import (
    Advice,
    Alternative,
    DiagnosisResult,
    EffectFinding,
    EffectSize,
    Estimate,
    MuscleShare,
)
from wrapjax.diagnosis.score import SIZES, Score, likeness
from wrapjax.diagnosis.shrinkage import shapley
from wrapjax.diagnosis.verdict import (
    UNSEEN,
    credible_set,
    decision,
    each_helps,
    judge,
    may_be_several,
    probabilities,
    several,
    tie_of,
)
from wrapjax.progress import Stopwatch

#: Effects that are compared with one another, and that are fitted together with all that is calibrated: those
#: that lead along straight lines. Joint fits confirm them on cycles kept back and say how far the error
#: shrinks, but do not rank: how calibration then bends, and the noise that many amounts take, would pass for
#: evidence.
COMPARED, TRIED = 8, 2


def conclude(scene: Scene, watch: Stopwatch) -> DiagnosisResult:
    """Say which effects explain the error, and how far it shrinks."""
    case, constants, scores = scene.case, scene.constants, scene.scores
    evidence = {id: one.evidence for id, one in scores.items()}
    order = list(scores)
    tried = [id for id in order if evidence[id] > 0.0][:TRIED]
    with watch.during("refits", f"fitting {', '.join(tried) or 'no effect'} with all that is calibrated"):
        refits = {id: refit(scene, (id,)) for id in tried}
    with watch.during("shrinkage", "measuring how far the error shrinks"):
        shrunk = {id: alternative(scene, refits[id]) for id in tried}
    with watch.during("verdict", "comparing effects"):
        compared = tuple(order[:COMPARED])
        apart = _apart(scene, compared)
        tie = tie_of(order[0], compared, apart, evidence) if order else ()
        null_replicates, detection_threshold = scene.strongest_of_null, scene.detection_threshold
        found = probabilities(evidence, scene.scored.structured, constants)
        controls = [id for id, effect in scene.effects.items() if effect.negative_control]
        unseen = [id for id, one in scores.items() if max(SIZES) * one.detectability < UNSEEN]
        gains = {id: one.gains for id, one in shrunk.items()}
        verdict = judge(found, evidence, tie, detection_threshold, controls, unseen, gains)
    accepted = verdict.named or verdict.tie
    shown = [id for id in order if id in shrunk]
    shown.sort(key=lambda id: (id not in accepted, order.index(id)))
    alternatives = tuple(shrunk[id] for id in shown)
    if may_be_several(verdict, scene.together, (*controls, *unseen)):
        with watch.during("together", f"fitting {', '.join(scene.together)} together"):
            parts = _parts_of(scene, shrunk)
        if each_helps(scene.together, {ids: one.gains for ids, one in parts.items()}):
            verdict = several(scene.together)
            accepted = verdict.named
            others = [one for one in alternatives if one.ids not in parts]
            alternatives = (*sorted(parts.values(), key=lambda one: -len(one.ids)), *others)
    findings = tuple(
        _finding(scene, scores[id], found.effects[id], refits.get(id), detection_threshold, id in accepted)
        for id in sorted(scores, key=lambda id: -found.effects[id])
    )
    hidden = tuple(
        NotTestable(
            id, f"one of expected size would show by {one.detectability:.1f} standard deviations only"
        )
        for id, one in scores.items()
        if one.detectability < UNSEEN and id not in accepted
    )
    silent = stopped(
        case,
        verdict.outcome,
        verdict.reason,
        watch.seconds,
        scene.look,
    )
    return replace(
        silent,
        named=verdict.named,
        ties=(verdict.tie,) if verdict.tie else (),
        credible_set=credible_set(found, tie, constants.set_level),
        effects=findings,
        none_probability=found.none,
        unknown_probability=found.unknown,
        not_testable=(*silent.not_testable, *hidden),
        alternatives=alternatives,
        shares=_shares(alternatives, verdict.named),
        likeness=(compared, apart),
        muscles=_muscles(scene),
        detection_threshold=detection_threshold,
        global_p=float((1 + np.sum(null_replicates >= evidence[order[0]])) / (1 + len(null_replicates)))
        if order
        else 1.0,
        advice=_advice(scene, verdict.tie, compared, apart),
        lines=scene.gap,
    )


def _parts_of(scene: Scene, known: Mapping[str, Alternative]) -> dict[tuple[str, ...], Alternative]:
    """Fit effects that stand together, and any part of them, in their order."""
    sizes = range(1, len(scene.together) + 1)
    parts = [part for size in sizes for part in combinations(scene.together, size)]
    return {
        part: known[part[0]]
        if len(part) == 1 and part[0] in known
        else alternative(scene, refit(scene, part))
        for part in parts
    }


def stopped(
    case: DiagnosisInput,
    outcome: str,
    reason: str,
    seconds: dict[str, float],
    look: Look | None = None,
) -> DiagnosisResult:
    """Say why there is no diagnosis, and what is known all the same; effects are not spoken of."""
    nothing = Effects(())
    modelled = case.predict(nothing)(case.variables, np.zeros(0)) if look is None else look.plain.predicted
    return DiagnosisResult(
        outcome=outcome,
        reason=reason,
        named=(),
        ties=(),
        credible_set=(),
        effects=(),
        none_probability=0.0,
        unknown_probability=1.0,
        not_testable=tuple(entry for entry in case.entries if isinstance(entry, NotTestable)),
        withheld=case.withheld,
        coordinates=case.context.coordinates,
        trials=case.context.trials,
        recordings=case.recordings,
        uses=case.uses,
        speeds=case.context.speeds,
        time=case.time,
        measured=case.measured,
        plain=modelled,
        budget=None if look is None else look.place.budget,
        budget_speeds=np.zeros(0) if look is None else look.place.speeds,
        map=np.zeros((0, len(case.context.coordinates), BINS)) if look is None else look.place.map,
        explainable_share=Estimate.unknown(reason) if look is None else look.place.explainable,
        alternatives=(),
        shares={},
        likeness=((), np.zeros((0, 0))),
        muscles=None,
        detection_threshold=np.nan,
        global_p=np.nan,
        advice=(),
        convergence_check=unfinished(case.outcomes, reason) if look is None else look.convergence_check,
        seconds=seconds,
    )


def _apart(scene: Scene, ids: Sequence[str]) -> Float[np.ndarray, "effect effect"]:
    """Say how much of each effect each other one cannot imitate, under what residuals speak for."""
    covariance = best_null(scene.gap, scene.sizes, scene.scored).covariance
    scores, candidates = scene.scores, scene.candidates
    wholes = [candidates[id].variants[scores[id].variant] for id in ids]
    shapes = [whole[list(scores[id].part)] for id, whole in zip(ids, wholes, strict=True)]
    signals = [scores[id].effect_sizes @ whole for id, whole in zip(ids, wholes, strict=True)]
    return np.asarray(likeness(signals, shapes, covariance)) if ids else np.zeros((0, 0))


def _shares(alternatives: Sequence[Alternative], named: tuple[str, ...]) -> dict[str, float]:
    """Share out what named effects remove together; of members of a tie each would remove the same error."""
    removed = {one.ids: one.held_out_cycles.value for one in alternatives if one.held_out_cycles.known}
    if not all(part in removed for size in range(len(named)) for part in combinations(named, size + 1)):
        return {}
    return shapley(named, lambda part: removed[part] if part else 0.0)


def _finding(
    scene: Scene,
    score: Score,
    probability: float,
    refit: Refitted | None,
    detection_threshold: float,
    accepted: bool,
) -> EffectFinding:
    effect = scene.effects[score.id]
    effect_sizes, sd = score.effect_sizes, score.sd
    if refit is not None:
        own = list(score.part)
        effect_sizes, sd = np.zeros(len(score.effect_sizes)), np.zeros(len(score.effect_sizes))
        effect_sizes[own] = refit.fit.effect_sizes
        sd[own] = np.sqrt(np.diag(effect_size_covariance(refit.fit, scene.look.effect_size_weight)))
    return EffectFinding(
        id=score.id,
        probability=probability,
        evidence=score.evidence,
        detectability=score.detectability,
        decision=decision(score.evidence, score.detectability, detection_threshold, accepted),
        effect_sizes=_amounts(effect, effect_sizes, sd),
        negative_control=effect.negative_control,
    )


def _amounts(
    effect: Effect, effect_sizes: Float[np.ndarray, " amount"], sd: Float[np.ndarray, " amount"]
) -> tuple[EffectSize, ...]:
    """Read amounts in what is reported; deviations by differences."""
    values = {name: float(value) for name, value in effect.readings(jnp.asarray(effect_sizes)).items()}
    spread = dict.fromkeys(values, 0.0)
    for place, own in enumerate(sd):
        moved = np.array(effect_sizes, dtype=float)
        moved[place] += 1e-3 * own
        for name, value in effect.readings(jnp.asarray(moved)).items():
            spread[name] += ((float(value) - values[name]) / 1e-3) ** 2
    units = dict(effect.reported) or {entry.name: entry.unit for entry in effect.parameters}
    return tuple(
        EffectSize(name, value, float(np.sqrt(spread[name])), units[name]) for name, value in values.items()
    )


def _muscles(scene: Scene) -> MuscleShare:
    case, gap = scene.case, scene.gap
    cycles, frames = case.plan.calibration, phase_frames(case.measured.shape[-1])
    residual = scene.look.place.residual[cycles][..., frames]
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
