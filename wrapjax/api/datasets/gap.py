"""What a diagnosis found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrapjax.api.datasets.labelled import MOMENT, Column, labelled, of_trials
from wrapjax.gap.result import GapResult

if TYPE_CHECKING:
    from xarray import Dataset


def gap_dataset(result: GapResult) -> Dataset:
    """Label the moments of a diagnosis, measured and predicted, and its evidence by effect.

    Returns
    -------
    Dataset
        ``predicted_moment`` leads with ``model``: ``plain``, then what was fitted with an effect (or
        several, joined by ``+``). Every cycle is from a fit that has not seen it.
    """
    models = ("plain", *("+".join(one.ids) for one in result.alternatives))
    predicted = np.stack([result.plain, *(one.predicted for one in result.alternatives)])
    effects = tuple(finding.id for finding in result.effects)
    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "predicted_moment": (
            ("model", *MOMENT),
            "N m",
            "joint moment by fits that have not seen the cycle",
            predicted,
        ),
        "probability": (
            ("effect",),
            "1",
            "that this effect is missing",
            [finding.probability for finding in result.effects],
        ),
        "evidence": (
            ("effect",),
            "nat",
            "log of the Bayes factor against the plain model",
            [finding.evidence for finding in result.effects],
        ),
        "detectability": (
            ("effect",),
            "1",
            "standard deviations that an effect of the expected size would stand out by",
            [finding.detectability for finding in result.effects],
        ),
    }
    labels = {
        "model": models,
        "trial": result.trials,
        "coordinate": result.coordinates,
        "effect": effects,
        "frame": np.arange(result.time.shape[1]),
    }
    attributes = {"outcome": result.outcome, "reason": result.reason, "named": ", ".join(result.named)}
    return labelled(columns, labels, of_trials(result), attributes)
