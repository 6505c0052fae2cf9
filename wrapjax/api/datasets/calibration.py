"""What a calibration found."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrapjax.api.datasets.labelled import MOMENT, Column, labelled, of_trials
from wrapjax.calibrate import CalibrationResult
from wrapjax.geometry.surfaces import NOMINAL
from wrapjax.model import QUANTITIES

if TYPE_CHECKING:
    from xarray import Dataset

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
