"""Score test with one term of the null hypothesis left out, to measure the contribution of each term.

Effects are ranked by the evidence of the linearized model alone, without refits and further decisions, so
that each ablation differs from `score_alone` only by its term. The detection threshold is that of the
diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.evidence.score_test import score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls

MomentSd = Float[np.ndarray, " coordinate"]
#: Function that removes a term from a linearized model and the standard deviations of measured moments (N m).
Ablation = Callable[[LinearizedModel, MomentSd], tuple[LinearizedModel, MomentSd]]


def score_ablated(
    ablation: Ablation, linearized: LinearizedModel, measured_moment_sd: MomentSd, detection_threshold: float
) -> dict[str, tuple[float, bool]]:
    """Score all effects with a term left out.

    Returns
    -------
    dict
        Log Bayes factor (nats) of each effect, and whether it exceeds the detection threshold.
    """
    linearized, measured_moment_sd = ablation(linearized, measured_moment_sd)
    (scored,) = score_each(
        linearized.residual.reshape(1, -1), nulls(linearized, measured_moment_sd), linearized.candidates
    )
    return {one.id: (one.evidence, one.evidence > detection_threshold) for one in scored.scores}


def _complete(linearized: LinearizedModel, measured_moment_sd: MomentSd) -> tuple[LinearizedModel, MomentSd]:
    return linearized, measured_moment_sd


def _without_input_errors(
    linearized: LinearizedModel, measured_moment_sd: MomentSd
) -> tuple[LinearizedModel, MomentSd]:
    """Assume exact EMG and angles, so that all cycle noise is noise of moments."""
    return replace(linearized, input_errors=()), measured_moment_sd


def _without_muscle_errors(
    linearized: LinearizedModel, measured_moment_sd: MomentSd
) -> tuple[LinearizedModel, MomentSd]:
    none = replace(linearized.muscle_errors, arms=np.zeros_like(linearized.muscle_errors.arms))
    return replace(linearized, muscle_errors=none), measured_moment_sd


def _without_repeated(
    linearized: LinearizedModel, measured_moment_sd: MomentSd
) -> tuple[LinearizedModel, MomentSd]:
    return linearized, np.zeros_like(measured_moment_sd)


def _without_nuisances(
    linearized: LinearizedModel, measured_moment_sd: MomentSd
) -> tuple[LinearizedModel, MomentSd]:
    """Assume the model's muscle curves and activation dynamics, and unfiltered envelopes."""
    return replace(linearized, nuisances=np.zeros_like(linearized.nuisances)), measured_moment_sd


def _without_give(
    linearized: LinearizedModel, measured_moment_sd: MomentSd
) -> tuple[LinearizedModel, MomentSd]:
    """Assume known calibrated parameters, which do not compensate for effects."""
    return replace(
        linearized, prior_root=np.zeros_like(linearized.prior_root), residual=linearized.fitted_residual
    ), measured_moment_sd


#: Ablations by the name of the answerer.
ABLATIONS: dict[str, Ablation] = {
    "score_alone": _complete,
    "without_input_errors": _without_input_errors,
    "without_muscle_errors": _without_muscle_errors,
    "without_repeated": _without_repeated,
    "without_nuisances": _without_nuisances,
    "without_give": _without_give,
}
