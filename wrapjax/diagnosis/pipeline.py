"""Steps of a diagnosis, from its input to its result, each from the results of the earlier ones.

``fit_baseline`` -> ``linearize`` -> ``localize`` -> ``score`` -> ``refit`` -> ``verify`` -> ``decide`` ->
``examine_claim``

Refits and their verification come in two rounds: single effects first, then, where the decision on these
allows it, the subsets of effects that are jointly significant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.claim import examine_claim
from wrapjax.diagnosis.claims.decision import DecisionConstants, decide, subsets_to_refit
from wrapjax.diagnosis.claims.gates import adequacy_of_plain_model
from wrapjax.diagnosis.evidence.law_evidence import law_evidence
from wrapjax.diagnosis.evidence.linearization import linearize
from wrapjax.diagnosis.evidence.other_tasks import OtherTasks, task_evidence
from wrapjax.diagnosis.evidence.score import score
from wrapjax.diagnosis.fits.baseline import BaselineFit, fit_baseline
from wrapjax.diagnosis.fits.refit import Ids, Refit, effects_to_refit, refit
from wrapjax.diagnosis.fits.verification import verify
from wrapjax.diagnosis.inputs.input import DiagnosisInput
from wrapjax.diagnosis.localization import localize
from wrapjax.diagnosis.null_hypotheses.null_replicates import NullModel, null_replicate_residuals
from wrapjax.diagnosis.result import DiagnosisResult, diagnosis_result, result_without_diagnosis
from wrapjax.diagnosis.uncertain_joints import uncertain_joints
from wrapjax.progress import Stopwatch

#: Fewest calibration cycles at any one speed.
FEWEST_CYCLES = 3


@dataclass(frozen=True)
class CatalogueIndependent:
    """Results that do not depend on the catalogue, and that a diagnosis with another catalogue can use again.

    Parameters
    ----------
    baseline
        Baseline fit.
    null_residuals
        Residuals of null replicates, N m; None where the baseline fit has not converged.
    """

    baseline: BaselineFit
    null_residuals: Float[np.ndarray, "replicate row"] | None = None


def run_diagnosis(
    data: DiagnosisInput,
    *,
    constants: DecisionConstants,
    null_replicates: int,
    seed: int = 0,
    known: CatalogueIndependent | None = None,
    other_tasks: OtherTasks | None = None,
    log: Callable[[str], None] = lambda line: None,
    seconds: dict[str, float] | None = None,
) -> tuple[DiagnosisResult, CatalogueIndependent | None]:
    """Run all steps of a diagnosis.

    Parameters
    ----------
    data
        Input of the diagnosis.
    constants
        Constants of the decision.
    null_replicates, seed
        Number of null replicates, and seed of their simulation.
    known
        Results of an earlier diagnosis of this subject with another catalogue; its null replicates are used.
    other_tasks
        Recorded tasks other than gait; None if there are none.
    log
        Function called with a line at each step.
    seconds
        Time that earlier steps took, s.

    Returns
    -------
    result, independent
        Result, and the part of the computation that does not depend on the catalogue; None where there are
        too few cycles.
    """
    watch = Stopwatch(log, dict(seconds or {}))
    plan = data.plan
    fewest = int(plan.counts.min()) if len(plan.counts) else 0
    if fewest < FEWEST_CYCLES:
        reason = (
            f"{fewest} calibration cycle{'' if fewest == 1 else 's'} at one speed; {FEWEST_CYCLES} are the "
            "fewest that show what repeats"
        )
        return result_without_diagnosis(data, "insufficient_data", reason, watch.seconds), None
    if known is None:
        with watch.during("plain_model", "fitting the plain model to parts of the cycles"):
            baseline = fit_baseline(data)
    else:
        baseline = known.baseline
    if not baseline.convergence_check.holds:
        reason = baseline.convergence_check.problems[0]
        localization = localize(data, baseline, None)
        result = result_without_diagnosis(
            data, "not_converged", reason, watch.seconds, baseline, localization
        )
        return result, CatalogueIndependent(baseline)
    with watch.during("signatures", "computing the signature of every effect"):
        linearized = linearize(data, baseline.variables)
        localization = localize(data, baseline, linearized)
        joints = uncertain_joints(data, linearized, baseline.variables)
    null_residuals = None if known is None else known.null_residuals
    if null_residuals is None:
        with watch.during("twins", f"simulating {null_replicates} null replicates"):
            model = NullModel(
                data.law.free,
                data.law.with_free_law(baseline.variables),
                data.calibration_recording,
                linearized,
                linearized.noise,
            )
            null_residuals = null_replicate_residuals(model, null_replicates, seed)
    with watch.during("score", "scoring effects"):
        scores = score(
            linearized, data.measured_moment_sd, null_residuals, constants.least_detection_threshold
        )
        laws = law_evidence(data.law, baseline.variables, linearized, scores.null.covariance)
    of_tasks = None
    if other_tasks is not None:
        with watch.during("other_tasks", "scoring effects on other tasks"):
            of_tasks, scores = task_evidence(data, other_tasks, linearized, baseline.variables, scores)
    singles = effects_to_refit(scores)
    names = ", ".join(id for ids in singles for id in ids) or "no effect"
    with watch.during("refits", f"fitting {names} with all calibrated parameters"):
        refits = refit(data, baseline, scores, singles)
    with watch.during("shrinkage", "measuring how far the error shrinks"):
        verification = verify(data, baseline, linearized, localization, refits, scores.of_single_cycles)
    with watch.during("verdict", "comparing effects"):
        plain = adequacy_of_plain_model(
            linearized, null_residuals, data.measured_moment_sd, constants.adequacy_factor
        )
        decision = decide(data, scores, verification, constants, plain.relative)
    joint: dict[Ids, Refit] = {}
    if subsets := subsets_to_refit(data, scores, verification, decision):
        with watch.during("together", f"fitting {', '.join(scores.jointly_significant)} together"):
            joint = refit(data, baseline, scores, subsets)
            together = verify(data, baseline, linearized, localization, joint, scores.of_single_cycles)
            verification = verification.joined(together)
            decision = decide(data, scores, verification, constants, plain.relative)
    with watch.during("gates", "examining the claim"):
        decision = examine_claim(
            data, linearized, scores, null_residuals, refits | joint, decision, constants, plain
        )
    result = diagnosis_result(
        data=data,
        baseline=baseline,
        linearized=linearized,
        localization=localization,
        scores=scores,
        refits=refits,
        verification=verification,
        decision=decision,
        law_evidence=laws,
        task_evidence=of_tasks,
        joints=joints,
        seconds=watch.seconds,
    )
    return result, CatalogueIndependent(baseline, null_residuals)
