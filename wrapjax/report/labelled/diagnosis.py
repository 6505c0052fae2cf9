"""xarray datasets of what a diagnosis and a protocol found; see `wrapjax.report.labelled.arrays`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrapjax.report.labelled.arrays import MOMENT, Column, cycle_columns, labelled

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.diagnosis.conditions.condition_contrast import DifferenceResult
    from wrapjax.diagnosis.protocol.result import ProtocolResult
    from wrapjax.diagnosis.result import DiagnosisResult


def diagnosis_dataset(result: DiagnosisResult) -> Dataset:
    """Make a dataset of a diagnosis: measured and predicted moments, and the evidence for each effect.

    Returns
    -------
    Dataset
        The first axis of ``predicted_moment`` is ``model``: ``plain``, then the models that were refitted
        with an effect (or several, joined by ``+``). Each cycle is predicted by a fit without that cycle.
    """
    models = ("plain", *("+".join(refit.ids) for refit in result.refits))
    predicted = np.stack([result.plain, *(refit.predicted for refit in result.refits)])
    effects = tuple(finding.id for finding in result.effects)
    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "predicted_moment": (
            ("model", *MOMENT),
            "N m",
            "joint moment by fits to which the cycle was held out",
            predicted,
        ),
        "probability": (
            ("effect",),
            "1",
            "probability that the model lacks this effect",
            [finding.probability for finding in result.effects],
        ),
        "evidence": (
            ("effect",),
            "nat",
            "log Bayes factor against the plain model",
            [finding.evidence for finding in result.effects],
        ),
        "detectability": (
            ("effect",),
            "1",
            "signal-to-noise ratio of an effect of its prior size, in standard deviations",
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
    attributes["family"] = result.family
    return labelled(columns, labels, cycle_columns(result.uses, result.speeds, result.time), attributes)


def protocol_dataset(result: ProtocolResult) -> Dataset:
    """Make a dataset of what trials add: along ``step``, the recordings, then one trial after another."""
    steps = (result.before, *(one.detected for one in result.advised))
    added = [0.0, *(one.information for one in result.advised)]
    expected = [result.expected_before, *(one.expected_evidence for one in result.advised)]
    by_effect = ("step", "effect")
    columns: dict[str, Column] = {
        "detectability": (
            by_effect,
            "1",
            "signal-to-noise ratio of an effect of its prior size, in standard deviations",
            [one.detectability for one in steps],
        ),
        "apart": (
            (*by_effect, "other"),
            "1",
            "squared Mahalanobis distance of an effect from none, another one allowed for",
            [one.apart for one in steps],
        ),
        "information": (("step",), "nat", "information on what is undecided that the step adds", added),
        "expected_evidence": (("step",), "nat", "expected evidence for an undecided effect", expected),
    }
    labels = {
        "step": ("recorded", *(one.trial.id for one in result.advised)),
        "effect": result.effects,
        "other": result.effects,
    }
    weight: Column = (("effect",), "1", "how undecided the effect is", result.weights)
    return labelled(columns, labels, {"weight": weight}, {"name": result.name, "basis": result.basis})


def difference_dataset(result: DifferenceResult) -> Dataset:
    """Make a dataset of the difference of two conditions, and the evidence for effects of one of them."""
    curve, contrast = ("speed", "coordinate", "phase"), result.contrast
    columns: dict[str, Column] = {
        "measured_difference": (
            curve,
            "N m",
            "mean measured moment of the first condition less that of the second",
            result.measured_difference,
        ),
        "residual_difference": (
            curve,
            "N m",
            "mean residual of the first condition less that of the second",
            contrast.difference,
        ),
        "explained": (curve, "N m", "contribution of the strongest effect", contrast.predicted),
        "evidence": (
            ("hypothesis",),
            "nat",
            "log Bayes factor of the effect in one condition alone",
            [one.evidence for one in contrast.scores],
        ),
    }
    places = [result.conditions[0 if one.first else 1] for one in contrast.directions]
    labels = {
        "speed": result.speeds,
        "coordinate": result.coordinates,
        "phase": np.arange(contrast.difference.shape[-1]),
        "hypothesis": np.arange(len(contrast.scores)),
    }
    axis = ("hypothesis",)
    coordinates: dict[str, Column] = {
        "effect": (axis, "", "effect", [one.id for one in contrast.directions]),
        "condition": (axis, "", "condition that has the effect", places),
    }
    return labelled(columns, labels, coordinates, {"outcome": result.outcome})
