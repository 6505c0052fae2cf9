"""xarray datasets of results, with labelled axes, units and meanings.

One function for each kind of result. xarray is imported only when a dataset is made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.contact_forces.contact_result import COMPARTMENTS, ContactResult
from wrapjax.model.parameters import QUANTITIES
from wrapjax.subject.subject import name_without_side
from wrapjax.subject.trials import Trials

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.calibration.initialisation import Initialisation
    from wrapjax.calibration.uncertainty.intervals import Spread
    from wrapjax.comparison.samples import ComparedLeg

#: Axes, unit, meaning and values of a variable of a dataset.
Column = tuple[tuple[str, ...], str, str, Any]

MOMENT = ("trial", "coordinate", "frame")
USE = "calibration or validation"


def cycle_columns(uses: Sequence[str], speeds: Any, time: Any) -> dict[str, Column]:
    """Make the columns of use, walking speed (m/s) and time (s) of each cycle."""
    return {
        "use": (("trial",), "", USE, list(uses)),
        "speed": (("trial",), "m/s", "walking speed", speeds),
        "time": (("trial", "frame"), "s", "time in the recording", time),
    }


def _moment_columns(measured: Any, modelled: Any, axes: tuple[str, ...] = ()) -> dict[str, Column]:
    """Make the columns of moments and their errors (N m); ``axes`` precede those of the modelled moments."""
    error = "mean over frames of the absolute difference of modelled and measured moment"
    return {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", measured),
        "modelled_moment": ((*axes, *MOMENT), "N m", "joint moment by the calibrated model", modelled),
        "mean_absolute_error": (
            (*axes, "trial", "coordinate"),
            "N m",
            error,
            np.abs(modelled - measured).mean(axis=-1),
        ),
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
        Variables by name.
    labels
        Names or numbers along each axis.
    coordinates
        Further coordinates of an axis, such as the walking speed of a cycle.
    attributes
        Attributes of the dataset.
    """
    import xarray

    def variable(column: Column) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
        axes, unit, meaning, values = column
        return axes, np.asarray(values), {"units": unit, "long_name": meaning}

    return xarray.Dataset(
        {name: variable(column) for name, column in columns.items()},
        coords={
            **{name: list(values) for name, values in labels.items()},
            **{name: variable(column) for name, column in coordinates.items()},
        },
        attrs=dict(attributes),
    )


_CURVE = ("trial", "muscle", "frame")
#: Meaning of a wrap parameter by the first part of its name.
_WRAP_MEANINGS = {
    "translation": "translation of the wrap along its nominal frame",
    "rotation": "rotation of the wrap about its frame, first x, then its own y and then its own z axis",
    "radius": "factor of all sizes",
    "second": "further factor of the second size",
    "third": "further factor of the third size",
}


def calibration_dataset(result: CalibrationResult) -> Dataset:
    """Make a dataset of a calibration: moments, muscle states and parameters.

    Parameters
    ----------
    result
        Result of one leg.

    Returns
    -------
    Dataset
        SI units, stated in ``attrs`` of each variable. Forces are along the tendon, in N; moments in N m,
        with the signs of the model's coordinates. If wraps were free, their parameters by ``wrap``; if
        synergies drove muscles, ``synergy_weight`` by ``extrapolated_excitation`` and ``command``.
    """
    states = result.states

    def trial_first(values: Any) -> np.ndarray:
        return np.moveaxis(np.asarray(values), 0, 1)

    columns: dict[str, Column] = {
        "measured_moment": (MOMENT, "N m", "joint moment by inverse dynamics", result.measured),
        "modelled_moment": (MOMENT, "N m", "joint moment by the calibrated model", result.modelled),
        "initial_moment": (MOMENT, "N m", "joint moment before calibration", result.initial_modelled),
        "excitation": (_CURVE, "1", "EMG after delay and scale", trial_first(states.excitation)),
        "activation": (_CURVE, "1", "muscle activation", trial_first(states.activation)),
        "active_force": (_CURVE, "N", "active force", trial_first(states.fiber.active_force)),
        "passive_force": (_CURVE, "N", "passive force", trial_first(states.fiber.passive_force)),
        "tendon_force": (_CURVE, "N", "tendon force", trial_first(states.fiber.tendon_force)),
        "normalized_fiber_length": (
            _CURVE,
            "1",
            "fiber length over its optimum",
            trial_first(states.fiber.normalized_length),
        ),
        "normalized_fiber_velocity": (
            _CURVE,
            "1",
            "fiber velocity over its maximum, shortening negative",
            trial_first(states.fiber.normalized_velocity),
        ),
        "muscle_tendon_length": (
            _CURVE,
            "m",
            "length of the muscle-tendon path",
            trial_first(states.path.length),
        ),
    }
    arm_axes = ("trial", "muscle", "coordinate", "frame")
    columns["moment_arm"] = (arm_axes, "m", "moment arm, -dL/dq", trial_first(states.path.moment_arm))
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
        values = wraps.values_of(np.asarray(result.parameters.path_changes))
        for name, unit, column in zip(wraps.quantities, wraps.units, values.T, strict=True):
            columns[name] = (("wrap",), unit, _WRAP_MEANINGS[name.split("_")[0]], column)
    if synergies is not None:
        labels |= {"extrapolated_excitation": synergies.names, "command": synergies.labels}
        rows = [int(np.argmax(synergies.places == number)) for number in range(len(synergies.names))]
        columns["synergy_weight"] = (
            ("extrapolated_excitation", "command"),
            "1",
            "weight of a synergy signal in the excitation of muscles without an electrode; the last is of a "
            "constant",
            np.asarray(result.parameters.synergy_weights)[rows],
        )
    attributes = {
        "method": result.method,
        "curves": result.curves,
        "tendon": result.tendon,
        "muscle_law": result.muscle_law,
        "status": result.solution.status.value,
    }
    return labelled(columns, labels, cycle_columns(result.uses, result.speeds, result.time), attributes)


#: ``method`` would collide with an option of xarray's `sel`.
_METHOD = "calibration_method"


def comparison_dataset(legs: Sequence[ComparedLeg], methods: Sequence[str]) -> Dataset:
    """Make a dataset of moments and parameters of several legs by several methods.

    Parameters
    ----------
    legs
        Calibrated legs.
    methods
        Names of the methods.

    Returns
    -------
    Dataset
        Cycles of all legs are concatenated along ``trial``, as ``<leg>/<cycle>``; coordinates and muscles
        have their names without ``_l`` and ``_r``, with NaN where a leg lacks one. Moments in N m,
        parameters in SI units.
    """
    coordinates = _united([leg.recorded.coordinates for leg in legs])
    muscles = _united([leg.recorded.muscles for leg in legs])
    cycles = [(leg, trial) for leg in legs for trial in range(len(leg.recorded.trials))]

    def moments(field: str, method: str | None = None) -> np.ndarray:
        filled = []
        for leg, trial in cycles:
            result = leg.recorded if method is None else leg.results[method]
            filled.append(_placed(getattr(result, field)[trial], result.coordinates, coordinates))
        return np.stack(filled)

    measured = moments("measured")
    modelled = np.stack([moments("modelled", method) for method in methods])
    columns = _moment_columns(measured, modelled, (_METHOD,))
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
        "leg_of_trial": (("trial",), "", "leg of the cycle", [leg.label for leg, _ in cycles]),
        **cycle_columns(
            [leg.recorded.uses[trial] for leg, trial in cycles],
            [leg.recorded.speeds[trial] for leg, trial in cycles],
            np.stack([leg.recorded.time[trial] for leg, trial in cycles]),
        ),
    }
    return labelled(columns, labels, of_cycles, {})


def _united(names: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """List all names without their sides, each once, in order of first occurrence."""
    return tuple(dict.fromkeys(name_without_side(name) for leg in names for name in leg))


def _placed(values: np.ndarray, names: Sequence[str], places: Sequence[str]) -> np.ndarray:
    """Arrange rows in the order of ``places`` by their names without sides; NaN where there is no row."""
    filled = np.full((len(places), *values.shape[1:]), np.nan)
    filled[[places.index(name_without_side(name)) for name in names]] = values
    return filled


def contact_dataset(result: ContactResult) -> Dataset:
    """Make a dataset of joint contact forces and of moments that muscles leave unexplained, by run.

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
            f"magnitude of the {result.kind.replace('_', ' ')}",
            np.stack([run.magnitude for run in result.runs]),
        ),
        "unexplained_moment": (
            ("run", *MOMENT),
            "N m",
            "measured joint moment minus the moments of all muscles",
            np.stack([run.undriven.residual for run in result.runs]),
        ),
    }
    if result.condyle_distance is not None:
        columns["knee_compartment_force"] = (
            ("run", "trial", "compartment", "frame"),
            "N",
            "compressive force in each compartment of the knee",
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
            "phase of the gait cycle from foot strike; above 100 after the next foot strike",
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
    """Make a dataset of measured moments and those that an earlier calibration predicts.

    Parameters
    ----------
    trials
        Cycles of the evaluated subject.
    modelled
        Predicted joint moments in N m, with the signs of the model's coordinates.
    attributes
        Attributes of the dataset, such as the subject and the run.
    """
    labels = {
        "trial": trials.names,
        "coordinate": trials.moment_coordinates,
        "frame": np.arange(trials.time.shape[1]),
    }
    cycles = cycle_columns(trials.uses, trials.speeds, trials.time)
    return labelled(_moment_columns(trials.moments, modelled), labels, cycles, attributes)


def initialisation_dataset(initialisation: Initialisation) -> Dataset:
    """Make a dataset of initial lengths, normalised fiber lengths in walking, and passive moments.

    Returns
    -------
    Dataset
        ``stage`` is ``before``, then ``after``. Lengths in m; passive moments in N m, with the signs of the
        model's coordinates, NaN where none was recorded; samples of all passive trials are concatenated.
    """
    stages = (initialisation.before, initialisation.after)
    by_muscle = ("stage", "muscle")
    columns: dict[str, Column] = {
        name: (
            by_muscle,
            QUANTITIES[name].unit,
            QUANTITIES[name].meaning,
            [getattr(muscles, name) for muscles in stages],
        )
        for name in ("optimal_fiber_length", "tendon_slack_length")
    }
    for place, end in enumerate(("shortest", "longest")):
        meaning = f"{end} fiber length in walking over the optimal fiber length"
        columns[f"{end}_normalized_fiber_length"] = (
            by_muscle,
            "1",
            meaning,
            initialisation.ranges[:, :, place],
        )
    measured, *modelled = initialisation.passive
    columns |= {
        "measured_passive_moment": (
            ("coordinate", "sample"),
            "N m",
            "joint moment measured with relaxed muscles",
            measured,
        ),
        "modelled_passive_moment": (
            ("stage", "coordinate", "sample"),
            "N m",
            "joint moment by passive muscle forces",
            np.stack(modelled),
        ),
    }
    trials = [trial.name for trial in initialisation.subject.passive for _ in range(trial.moments.shape[1])]
    labels = {
        "stage": ("before", "after"),
        "muscle": initialisation.after.names,
        "coordinate": initialisation.subject.trials.moment_coordinates,
        "sample": np.arange(measured.shape[1]),
    }
    origin = (("sample",), "", "passive trial that the sample is from", np.array(trials, dtype=str))
    attributes = {"subject": initialisation.subject.name, "status": initialisation.status.value}
    return labelled(columns, labels, {"passive_trial": origin}, attributes)


def spread_dataset(spread: Spread, way: str) -> Dataset:
    """Make a dataset of calibrated parameters, their standard deviations and 90 % intervals."""
    axis, own = ("parameter",), "as stated in unit"
    columns: dict[str, Column] = {
        "value": (axis, own, "calibrated value", spread.value),
        "sd": (axis, own, "standard deviation", spread.deviation),
        "low": (axis, own, "lower end of the 90 % interval", spread.low),
        "high": (axis, own, "upper end of the 90 % interval", spread.high),
        "prior_sd": (axis, own, "standard deviation without the moments", spread.prior_deviation),
        "identified": (axis, "", "whether moments reduce it by a fifth or more", spread.identified),
    }
    unit: Column = (axis, "", "unit of the parameter", list(spread.units))
    return labelled(columns, {"parameter": spread.labels}, {"unit": unit}, {"way": way})


def cohort_dataset(subjects: Mapping[str, Mapping[str, Any]]) -> Dataset:
    """Make a dataset of mean absolute errors (N m) of finished subjects; NaN where there is none.

    Parameters
    ----------
    subjects
        Entries of ``cohort.json`` by subject.
    """
    uses = ("calibration", "validation")
    errors = {
        (name, use): {key: value for key, value in (entry["mae_Nm"].get(use) or {}).items() if key != "mean"}
        for name, entry in subjects.items()
        for use in uses
    }
    coordinates = tuple(dict.fromkeys(key for values in errors.values() for key in values))
    table = [
        [[errors[name, use].get(key, np.nan) for key in coordinates] for use in uses] for name in subjects
    ]
    axes, meaning = ("subject", "use", "coordinate"), "mean absolute error of the joint moments"
    labels = {"subject": tuple(subjects), "use": uses, "coordinate": coordinates}
    shape = (len(subjects), len(uses), len(coordinates))
    return labelled({"mean_absolute_error": (axes, "N m", meaning, np.reshape(table, shape))}, labels, {}, {})
