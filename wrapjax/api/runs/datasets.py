"""Results as labelled arrays, for people who think in `xarray`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from wrapjax.calibrate import CalibrationResult
from wrapjax.contact.compartments import COMPARTMENTS
from wrapjax.contact.result import ContactResult
from wrapjax.gap.result import GapResult
from wrapjax.model import QUANTITIES

if TYPE_CHECKING:
    from xarray import Dataset

#: Axes, unit, meaning and values of a variable.
_Column = tuple[tuple[str, ...], str, str, Any]

_MOMENT = ("trial", "coordinate", "frame")
_CURVE = ("trial", "muscle", "frame")


def calibration_dataset(result: CalibrationResult) -> Dataset:
    """Label what a calibration found: moments, what each muscle does, and its parameters.

    Parameters
    ----------
    result
        Of one leg.

    Returns
    -------
    Dataset
        SI units, which ``attrs`` of each variable say. Forces are along the tendon, in N; moments in N m,
        with the signs of the model's coordinates.
    """
    states = result.states

    def of_muscles(values: Any) -> np.ndarray:
        return np.moveaxis(np.asarray(values), 0, 1)

    columns: dict[str, _Column] = {
        "measured_moment": (_MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "modelled_moment": (_MOMENT, "N m", "joint moment by the calibrated model", result.modelled),
        "initial_moment": (_MOMENT, "N m", "joint moment before calibration", result.initial_modelled),
        "excitation": (_CURVE, "1", "EMG after delay and scale", of_muscles(states.excitation)),
        "activation": (_CURVE, "1", "muscle activation", of_muscles(states.activation)),
        "active_force": (_CURVE, "N", "active force", of_muscles(states.fiber.active_force)),
        "passive_force": (_CURVE, "N", "passive force", of_muscles(states.fiber.passive_force)),
        "tendon_force": (_CURVE, "N", "force on the bones", of_muscles(states.fiber.tendon_force)),
        "normalized_fiber_length": (
            _CURVE,
            "1",
            "fiber length over its optimum",
            of_muscles(states.fiber.normalized_length),
        ),
        "normalized_fiber_velocity": (
            _CURVE,
            "1",
            "fiber velocity over its maximum, shortening negative",
            of_muscles(states.fiber.normalized_velocity),
        ),
        "muscle_tendon_length": (_CURVE, "m", "length of the whole path", of_muscles(states.path.length)),
        "moment_arm": (
            ("trial", "muscle", "coordinate", "frame"),
            "m",
            "moment arm, -dL/dq",
            of_muscles(states.path.moment_arm),
        ),
    }
    for name, quantity in QUANTITIES.items():
        columns[name] = (("muscle",), quantity.unit, quantity.meaning, getattr(result.parameters, name))
    labels = {
        "trial": result.trials,
        "coordinate": result.coordinates,
        "muscle": result.muscles,
        "frame": np.arange(result.time.shape[1]),
    }
    attributes = {"method": result.method, "curves": result.curves, "status": result.solution.status.value}
    return _dataset(columns, labels, _of_trials(result), attributes)


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
    columns: dict[str, _Column] = {
        "measured_moment": (_MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "predicted_moment": (
            ("model", *_MOMENT),
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
    return _dataset(columns, labels, _of_trials(result), attributes)


def contact_dataset(result: ContactResult) -> Dataset:
    """Label what joints bear, by run, and which moments no muscle explains.

    Returns
    -------
    Dataset
        Forces in N, of the distal bone on the proximal one, along the proximal one's axes.
    """
    columns: dict[str, _Column] = {
        "contact_force": (
            ("run", "trial", "joint", "axis", "frame"),
            "N",
            f"{result.kind.replace('_', ' ')} on the proximal bone, along its axes",
            np.stack([run.force for run in result.runs]),
        ),
        "contact_force_magnitude": (
            ("run", "trial", "joint", "frame"),
            "N",
            f"size of the {result.kind.replace('_', ' ')}",
            np.stack([run.magnitude for run in result.runs]),
        ),
        "unexplained_moment": (
            ("run", *_MOMENT),
            "N m",
            "measured joint moment less those of all muscles",
            np.stack([run.undriven.residual for run in result.runs]),
        ),
    }
    if result.condyle_distance is not None:
        columns["knee_compartment_force"] = (
            ("run", "trial", "compartment", "frame"),
            "N",
            "what presses either side of the knee together",
            np.stack([run.compartments for run in result.runs if run.compartments is not None]),
        )
    labels = {
        "run": [run.label for run in result.runs],
        "trial": result.trials,
        "joint": list(result.joints),
        "compartment": COMPARTMENTS,
        "axis": ("x", "y", "z"),
        "coordinate": result.coordinates,
        "frame": np.arange(result.time.shape[1]),
    }
    of_trials: dict[str, _Column] = {
        "use": (("trial",), "", "calibration or validation", list(result.uses)),
        "time": (("trial", "frame"), "s", "time in the recording", result.time),
    }
    attributes = {"kind": result.kind, "reason": result.reason, "bodyweight_N": f"{result.bodyweight:.6g}"}
    return _dataset(columns, labels, of_trials, attributes)


def _of_trials(result: CalibrationResult | GapResult) -> dict[str, _Column]:
    """What is known of each cycle."""
    return {
        "use": (("trial",), "", "calibration or validation", list(result.uses)),
        "speed": (("trial",), "m/s", "walking speed", result.speeds),
        "time": (("trial", "frame"), "s", "time in the recording", result.time),
    }


def _dataset(
    columns: Mapping[str, _Column],
    labels: Mapping[str, Any],
    of_trials: Mapping[str, _Column],
    attributes: Mapping[str, str],
) -> Dataset:
    import xarray

    def labelled(column: _Column) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
        axes, unit, meaning, values = column
        return axes, np.asarray(values), {"units": unit, "long_name": meaning}

    return xarray.Dataset(
        {name: labelled(column) for name, column in columns.items()},
        coords={
            **{name: list(values) for name, values in labels.items()},
            **{name: labelled(column) for name, column in of_trials.items()},
        },
        attrs=dict(attributes),
    )
