"""Effects fitted together with what is calibrated, and how far the error shrinks by that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.case import Scene
from wrapjax.diagnosis.effects.effect import Effect, Effects
from wrapjax.diagnosis.held_out import CrossFit, cross_fit, speed_conflict
from wrapjax.diagnosis.refit import Refit, fit_jointly, joint_problem
from wrapjax.diagnosis.result import Alternative, Estimate, Released
from wrapjax.diagnosis.shrinkage import cycle_errors, shrinkage

#: Slopes by amounts are drawn anew where this one ends: far from where a refit starts they mislead it.
_FIRST = ProjectedLevenbergMarquardt(gtol=1e-2, ftol=1e-3, max_iterations=15)


@dataclass(frozen=True)
class Refitted:
    """An effect, or several, fitted together with what is calibrated."""

    ids: tuple[str, ...]
    #: Over the calibration cycles, and over all.
    effects: Effects
    everywhere: Effects
    #: To all calibration cycles.
    fit: Refit


def refit(scene: Scene, ids: tuple[str, ...]) -> Refitted:
    """Fit effects with the same effort as the plain model, from their most plausible amounts."""
    case, scores = scene.case, scene.scores
    shapes = tuple(scores[id].variant for id in ids)
    parts = [scores[id].part for id in ids]
    known = {entry.id: entry for entry in case.entries if isinstance(entry, Effect)}
    seen, whole = (
        Effects(
            tuple(every[id].only(part).of_size(scores[id].size) for id, part in zip(ids, parts, strict=True)),
            shapes,
        )
        for every in (scene.effects, known)
    )
    effect_sizes = np.concatenate(
        [scores[id].effect_sizes[list(part)] for id, part in zip(ids, parts, strict=True)]
    )
    start = np.clip(effect_sizes, seen.lower, seen.upper)
    plain = scene.look.plain.full.calibrated
    first = joint_problem(case.problem, seen, plain, start, scene.look.effect_size_weight)
    near = fit_jointly(first, np.concatenate([plain, start / seen.prior_sd]), solver=_FIRST, kept=case.kept)
    problem = joint_problem(
        case.problem, seen, near.calibrated, near.effect_sizes, scene.look.effect_size_weight
    )
    return Refitted(ids, seen, whole, fit_jointly(problem, near.variables, kept=case.kept))


def alternative(scene: Scene, refitted: Refitted) -> Alternative:
    """Say what an effect takes away on cycles that its fits have not seen, and what it released."""
    case, plain = scene.case, scene.look.plain
    start, everywhere = refitted.fit, case.predict(refitted.everywhere)
    fit = cross_fit(start.problem, start.variables, case.plan, case.speeds, everywhere, case.kept)
    measured, speeds, floor = case.measured, case.speeds, scene.look.place.floor
    before, after = (cycle_errors(measured - one.predicted) for one in (plain, fit))
    held = np.array([use != "calibration" for use in case.uses]) & ~case.plan.new_speed
    # Where few cycles were kept for validation, those left out one by one count as well.
    counted = (
        held if held.sum() >= 2 * len(case.plan.counts) and len(case.plan.counts) else ~case.plan.new_speed
    )
    return Alternative(
        ids=refitted.ids,
        predicted=fit.predicted,
        held_out_cycles=shrinkage(before[counted], after[counted], floor.of(counted), speeds[counted]),
        held_out_speed=_at_other_speed(scene, fit),
        gains=_gains(scene, before - after),
        speed_conflict=speed_conflict(fit, scene.look.effect_size_weight),
        released=_released(scene, fit),
    )


def _gains(scene: Scene, fall: Float[np.ndarray, " cycle"]) -> tuple[float, ...]:
    """Turn falls of mean squared errors into nats, block by block: see `effect_size_weight`."""
    plan = scene.case.plan
    by_cycle = 0.5 * fall / (MOMENT_ERROR**2 * scene.look.effect_size_weight * len(plan.calibration))
    return tuple(float(np.sum(by_cycle[plan.calibration[block]])) for block in plan.blocks)


def _at_other_speed(scene: Scene, fit: CrossFit) -> Estimate:
    case, plain = scene.case, scene.look.plain
    if plain.at_other_speed is None or fit.at_other_speed is None:
        return Estimate.unknown("one speed was recorded")
    counted = case.plan.new_speed if case.plan.new_speed.any() else np.ones(len(case.uses), dtype=bool)
    before, after = (
        cycle_errors(case.measured - np.asarray(one.at_other_speed))[counted] for one in (plain, fit)
    )
    return shrinkage(before, after, scene.look.place.floor.of(counted), case.speeds[counted])


def _released(scene: Scene, fit: CrossFit) -> tuple[Released, ...]:
    """Compare what was calibrated without and with the effect."""
    problem = scene.case.problem
    before, after = scene.look.plain.full.calibrated, fit.full.calibrated
    sd = np.sqrt(np.sum(scene.gap.spread**2, axis=1))
    stuck = (before <= np.asarray(problem.lower)) | (before >= np.asarray(problem.upper))
    rows = zip(problem.variables.labels, before, after, sd, stuck, strict=True)
    return tuple(
        Released(label, float(was), float(now), float(spread), bool(held))
        for label, was, now, spread, held in rows
    )
