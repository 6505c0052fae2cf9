"""What all labelled arrays share: axes, units, and what is known of each cycle.

What a calibration found.

What several methods found on several legs.

What joints bear.

What a finished calibration predicts on other cycles.

What a diagnosis found.

Lengths to start a calibration from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.contact_forces.result import COMPARTMENTS, ContactResult
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.model.parameters import QUANTITIES
from wrapjax.subject.subject import name_without_side
from wrapjax.subject.trials import Trials

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.calibration.initialisation import Initialisation
    from wrapjax.comparison.samples import ComparedLeg

#: Axes, unit, meaning and values of a variable.
Column = tuple[tuple[str, ...], str, str, Any]

MOMENT = ("trial", "coordinate", "frame")
USE = "calibration or validation"
ERROR = (
    ("trial", "coordinate"),
    "N m",
    "mean over frames of the absolute difference of modelled and measured moment",
)


def of_trials(result: CalibrationResult | DiagnosisResult | Trials) -> dict[str, Column]:
    """What is known of each cycle."""
    return {
        "use": (("trial",), "", USE, list(result.uses)),
        "speed": (("trial",), "m/s", "walking speed", result.speeds),
        "time": (("trial", "frame"), "s", "time in the recording", result.time),
    }


def labelled(
    columns: Mapping[str, Column],
    labels: Mapping[str, Any],
    coordinates: Mapping[str, Column],
    attributes: Mapping[str, str],
) -> Dataset:
    """Make a dataset.

    Parameters
    ----------
    columns
        What is to be read, by name.
    labels
        Names or numbers along each axis.
    coordinates
        What goes with an axis beside its labels: when and how a cycle was walked, for example.
    attributes
        What is known of the whole.
    """
    import xarray

    def of_xarray(column: Column) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
        axes, unit, meaning, values = column
        return axes, np.asarray(values), {"units": unit, "long_name": meaning}

    return xarray.Dataset(
        {name: of_xarray(column) for name, column in columns.items()},
        coords={
            **{name: list(values) for name, values in labels.items()},
            **{name: of_xarray(column) for name, column in coordinates.items()},
        },
        attrs=dict(attributes),
    )


_CURVE = ("trial", "muscle", "frame")
#: By the first part of its name, what a cylinder's parameter is.
_WRAP_MEANINGS = {
    "translation": "shift of the cylinder along its nominal frame",
    "rotation": "turn of the cylinder about its frame, first x and then its own y axis",
    "radius": "radius over the nominal one",
}


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
        with the signs of the model's coordinates. Where cylinders were free, their parameters by ``wrap``;
        where synergies drove muscles, ``synergy_weight`` by ``extrapolated_excitation`` and ``command``.
    """
    states = result.states

    def of_muscles(values: Any) -> np.ndarray:
        return np.moveaxis(np.asarray(values), 0, 1)

    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "modelled_moment": (MOMENT, "N m", "joint moment by the calibrated model", result.modelled),
        "initial_moment": (MOMENT, "N m", "joint moment before calibration", result.initial_modelled),
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
    labels: dict[str, Any] = {
        "trial": result.trials,
        "coordinate": result.coordinates,
        "muscle": result.muscles,
        "frame": np.arange(result.time.shape[1]),
    }
    wraps, synergies = result.freedom.wraps, result.freedom.synergies
    if wraps is not None:
        labels["wrap"] = wraps.names
        values = NOMINAL + wraps.changes_of(np.asarray(result.parameters.path_changes))
        for name, unit, column in zip(wraps.quantities, wraps.units, values.T, strict=True):
            columns[name] = (("wrap",), unit, _WRAP_MEANINGS[name.split("_")[0]], column)
    if synergies is not None:
        labels |= {"extrapolated_excitation": synergies.names, "command": synergies.labels}
        rows = [int(np.argmax(synergies.places == number)) for number in range(len(synergies.names))]
        columns["synergy_weight"] = (
            ("extrapolated_excitation", "command"),
            "1",
            "weight of a synergy's command in an excitation that nobody measured, the last of a constant",
            np.asarray(result.parameters.synergy_weights)[rows],
        )
    attributes = {
        "method": result.method,
        "curves": result.curves,
        "tendon": result.tendon,
        "status": result.solution.status.value,
    }
    return labelled(columns, labels, of_trials(result), attributes)


#: Not ``method``, which `sel` of xarray takes for its own option.
_METHOD = "calibration_method"


def comparison_dataset(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Dataset:
    """Label moments and parameters of several legs by several methods.

    Parameters
    ----------
    legs
        Every calibrated leg.
    methods
        The first is the one that others are compared with.

    Returns
    -------
    Dataset
        Cycles of all legs stand one after the other along ``trial``, as ``<leg>/<cycle>``; coordinates and
        muscles go by their names without ``_l`` and ``_r``, with NaN where a leg lacks one. Moments in N m,
        parameters in SI units.
    """
    coordinates = _united([leg.recorded.coordinates for leg in legs])
    muscles = _united([leg.recorded.muscles for leg in legs])
    cycles = [(leg, trial) for leg in legs for trial in range(len(leg.recorded.trials))]

    def moments(of: str, method: str | None = None) -> np.ndarray:
        filled = []
        for leg, trial in cycles:
            result = leg.recorded if method is None else leg.results[method]
            filled.append(_placed(getattr(result, of)[trial], result.coordinates, coordinates))
        return np.stack(filled)

    measured = moments("measured")
    modelled = np.stack([moments("modelled", method) for method in methods])
    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", measured),
        "modelled_moment": ((_METHOD, *MOMENT), "N m", "joint moment by the calibrated model", modelled),
        "mean_absolute_error": (
            (_METHOD, *ERROR[0]),
            *ERROR[1:],
            np.abs(modelled - measured).mean(axis=3),
        ),
    }
    for name, quantity in QUANTITIES.items():
        values = [
            [
                _placed(
                    np.asarray(getattr(leg.results[method].parameters, name)), leg.recorded.muscles, muscles
                )
                for leg in legs
            ]
            for method in methods
        ]
        columns[name] = ((_METHOD, "leg", "muscle"), quantity.unit, quantity.meaning, values)
    labels = {
        _METHOD: methods,
        "leg": [leg.label for leg in legs],
        "trial": [f"{leg.label}/{leg.recorded.trials[trial]}" for leg, trial in cycles],
        "coordinate": coordinates,
        "muscle": muscles,
        "frame": np.arange(measured.shape[2]),
    }
    of_cycles: dict[str, Column] = {
        "leg_of_trial": (("trial",), "", "leg that walked it", [leg.label for leg, _ in cycles]),
        "use": (("trial",), "", USE, [leg.recorded.uses[trial] for leg, trial in cycles]),
        "speed": (("trial",), "m/s", "walking speed", [leg.recorded.speeds[trial] for leg, trial in cycles]),
        "time": (
            ("trial", "frame"),
            "s",
            "time in the recording",
            np.stack([leg.recorded.time[trial] for leg, trial in cycles]),
        ),
    }
    return labelled(columns, labels, of_cycles, {})


def _united(names: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """List all names without their sides, each once, in the order in which they come."""
    return tuple(dict.fromkeys(name_without_side(name) for own in names for name in own))


def _placed(values: np.ndarray, names: Sequence[str], places: Sequence[str]) -> np.ndarray:
    """Put rows where their names without sides have their places; NaN elsewhere."""
    filled = np.full((len(places), *values.shape[1:]), np.nan)
    filled[[places.index(name_without_side(name)) for name in names]] = values
    return filled


def contact_dataset(result: ContactResult) -> Dataset:
    """Label what joints bear, by run, and which moments no muscle explains.

    Returns
    -------
    Dataset
        Forces in N, of the distal bone on the proximal one, along the proximal one's axes.
    """
    columns: dict[str, Column] = {
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
            ("run", *MOMENT),
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
    of_cycles: dict[str, Column] = {
        "use": (("trial",), "", USE, list(result.uses)),
        "time": (("trial", "frame"), "s", "time in the recording", result.time),
        "gait_phase": (
            ("trial", "frame"),
            "%",
            "of the gait cycle, from the foot's strike, beyond 100 after the next one",
            result.phase,
        ),
    }
    attributes = {"kind": result.kind, "reason": result.reason, "bodyweight_N": f"{result.bodyweight:.6g}"}
    return labelled(columns, labels, of_cycles, attributes)


def evaluation_dataset(
    trials: Trials,
    modelled: Float[np.ndarray, "trial coordinate frame"],
    attributes: Mapping[str, str],
) -> Dataset:
    """Label what a finished calibration predicts on a subject's cycles, beside what was measured.

    Parameters
    ----------
    trials
        The cycles.
    modelled
        Joint moments in N m, with the signs of the model's coordinates.
    attributes
        What is known of both: whose, and by which run.
    """
    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", trials.moments),
        "modelled_moment": (MOMENT, "N m", "joint moment by the finished calibration", modelled),
        "mean_absolute_error": (*ERROR, np.abs(modelled - trials.moments).mean(axis=2)),
    }
    labels = {
        "trial": trials.names,
        "coordinate": trials.moment_coordinates,
        "frame": np.arange(trials.time.shape[1]),
    }
    return labelled(columns, labels, of_trials(trials), attributes)


def diagnosis_dataset(result: DiagnosisResult) -> Dataset:
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


def initialisation_dataset(found: Initialisation) -> Dataset:
    """Label lengths to start from, where fibers then work in walking, and passive moments.

    Returns
    -------
    Dataset
        ``stage`` is before, then after. Lengths in m; passive moments in N m, with the signs of the model's
        coordinates, NaN where none was recorded, the samples of all passive trials one after the other.
    """
    stages = (found.before, found.after)
    by_muscle = ("stage", "muscle")
    columns: dict[str, Column] = {
        name: (
            by_muscle,
            QUANTITIES[name].unit,
            QUANTITIES[name].meaning,
            [getattr(one, name) for one in stages],
        )
        for name in ("optimal_fiber_length", "tendon_slack_length")
    }
    for place, end in enumerate(("shortest", "longest")):
        meaning = f"{end} fiber length in walking over its optimum"
        columns[f"{end}_normalized_fiber_length"] = (by_muscle, "1", meaning, found.ranges[:, :, place])
    measured, *modelled = found.passive
    columns |= {
        "measured_passive_moment": (
            ("coordinate", "sample"),
            "N m",
            "joint moment recorded with muscles at rest",
            measured,
        ),
        "modelled_passive_moment": (
            ("stage", "coordinate", "sample"),
            "N m",
            "joint moment by passive muscle forces",
            np.stack(modelled),
        ),
    }
    trials = [trial.name for trial in found.subject.passive for _ in range(trial.moments.shape[1])]
    labels = {
        "stage": ("before", "after"),
        "muscle": found.after.names,
        "coordinate": found.subject.trials.moment_coordinates,
        "sample": np.arange(measured.shape[1]),
    }
    of_samples: dict[str, Column] = {
        "passive_trial": (
            ("sample",),
            "",
            "passive trial that the sample is from",
            np.array(trials, dtype=str),
        )
    }
    attributes = {"subject": found.subject.name, "status": found.status.value}
    return labelled(columns, labels, of_samples, attributes)
