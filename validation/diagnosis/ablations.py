"""What each term of the null hypothesis is worth: the score test again, whole and with one term left out.

They rank by the straight lines' evidence alone, without refits and without what is made of it afterwards, so
that each differs from `score_alone` by its term and by nothing else. The alarm level is the diagnosis's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.score import score_each

Sizes = Float[np.ndarray, " coordinate"]
#: Straight lines, and standard deviations of measured moments (N m), with a term left out of them.
Ablation = Callable[[LinearizedModel, Sizes], tuple[LinearizedModel, Sizes]]


def ablated(
    ablation: Ablation, gap: LinearizedModel, sizes: Sizes, detection_threshold: float
) -> dict[str, tuple[float, bool]]:
    """Score all effects with a term left out.

    Returns
    -------
    By id, the evidence in nats, and whether it is above the alarm level.
    """
    gap, sizes = ablation(gap, sizes)
    (found,) = score_each(gap.residual.reshape(1, -1), nulls(gap, sizes), gap.candidates)
    return {one.id: (one.evidence, one.evidence > detection_threshold) for one in found.scores}


def _whole(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    return gap, sizes


def _without_input_errors(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    """EMG and angles are taken for exact; what differs between cycles is all noise of moments."""
    return replace(gap, input_errors=()), sizes


def _without_muscle_errors(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    none = replace(gap.muscle_errors, arms=np.zeros_like(gap.muscle_errors.arms))
    return replace(gap, muscle_errors=none), sizes


def _without_repeated(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    return gap, np.zeros_like(sizes)


def _without_nuisances(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    """No other force curves or activation dynamics, and envelopes that no filter has touched."""
    return replace(gap, nuisances=np.zeros_like(gap.nuisances)), sizes


def _without_give(gap: LinearizedModel, sizes: Sizes) -> tuple[LinearizedModel, Sizes]:
    """What was calibrated is taken for known: it gives way to nothing, and residuals are as it left them."""
    return replace(gap, spread=np.zeros_like(gap.spread), residual=gap.fitted), sizes


#: By the name under which it is scored.
ABLATIONS: dict[str, Ablation] = {
    "score_alone": _whole,
    "without_input_errors": _without_input_errors,
    "without_muscle_errors": _without_muscle_errors,
    "without_repeated": _without_repeated,
    "without_nuisances": _without_nuisances,
    "without_give": _without_give,
}
