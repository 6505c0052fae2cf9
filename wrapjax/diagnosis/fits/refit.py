"""Refits: the strongest effects fitted together with all calibrated parameters.

Refits confirm effects on held-out cycles and show how far the error shrinks; they do not rank effects. The
nonlinear response of the calibration and the noise that many parameters absorb would pass for evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.evidence.score import Scores
from wrapjax.diagnosis.fits.baseline import BaselineFit
from wrapjax.diagnosis.fits.cross_validation import CrossFit, cross_fit
from wrapjax.diagnosis.fits.joint_fit import JointFit, fit_jointly, joint_problem
from wrapjax.diagnosis.inputs.input import DiagnosisInput

#: Largest number of effects that are refitted alone.
REFITTED = 2
#: Solver of a first fit, at whose end the derivatives by effect sizes are computed again: those at the start
#: of a refit, far from its end, would mislead it.
FIRST_SOLVER = ProjectedLevenbergMarquardt(gtol=1e-2, ftol=1e-3, max_iterations=15)

#: Identifiers of one effect, or of several that are fitted together.
Ids = tuple[str, ...]


@dataclass(frozen=True)
class Refit:
    """One effect, or several, fitted together with all calibrated parameters.

    Parameters
    ----------
    ids
        Identifiers of the effects.
    fit
        Fit to all calibration cycles.
    cross_fit
        Fits to all and parts of the cycles.
    residual
        Measured less predicted moments of the calibration cycles by the fit to all of them, N m.
    """

    ids: Ids
    fit: JointFit
    cross_fit: CrossFit
    residual: Float[np.ndarray, "cycle coordinate frame"]


def effects_to_refit(scores: Scores) -> tuple[Ids, ...]:
    """Select the strongest effect, if its evidence is positive, and further ones that are significant.

    Each is refitted alone. A decision needs the refit of the strongest; others are refitted to be compared
    with it, which says nothing where their evidence is that of noise.
    """
    first = [id for id, evidence in scores.evidence.items() if evidence > 0.0][:REFITTED]
    significant = [id for id in first[1:] if scores.evidence[id] > scores.detection_threshold]
    return tuple((id,) for id in (*first[:1], *significant))


def refit(
    data: DiagnosisInput, baseline: BaselineFit, scores: Scores, combinations: Sequence[Ids]
) -> dict[Ids, Refit]:
    """Fit effects together with all calibrated parameters, to all and parts of the cycles.

    Parameters
    ----------
    data, baseline, scores
        Input of the diagnosis, its baseline fit, and scores of all effects.
    combinations
        Identifiers of the effects of each refit.
    """
    return {ids: _refit(data, baseline, scores, ids) for ids in combinations}


def _refit(data: DiagnosisInput, baseline: BaselineFit, scores: Scores, ids: Ids) -> Refit:
    """Fit from the most plausible effect sizes, by the solver that fitted the plain model."""
    chosen = [scores.by_id[id] for id in ids]
    calibration, all_cycles = (
        Effects(
            tuple(effects[one.id].only(one.part).of_size(one.prior_factor) for one in chosen),
            tuple(one.variant for one in chosen),
        )
        for effects in (data.calibration_effects, data.effects)
    )
    effect_sizes = np.concatenate([one.effect_sizes[list(one.part)] for one in chosen])
    start = np.clip(effect_sizes, calibration.lower, calibration.upper)
    weight = baseline.effect_size_weight
    first = fit_jointly(
        joint_problem(data.problem, calibration, baseline.variables, start, weight),
        np.concatenate([baseline.variables, start / calibration.prior_sd]),
        solver=FIRST_SOLVER,
        cache=data.cache,
    )
    problem = joint_problem(data.problem, calibration, first.calibrated, first.effect_sizes, weight)
    fit = fit_jointly(problem, first.variables, cache=data.cache)
    prediction = data.prediction(all_cycles)
    predicted = prediction(fit.calibrated, fit.effect_sizes)
    return Refit(
        ids,
        fit,
        cross_fit(fit.problem, fit.variables, data.plan, data.speeds, prediction, data.cache),
        (data.measured - predicted)[data.plan.calibration],
    )
