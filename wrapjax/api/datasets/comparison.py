"""What several methods found on several legs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.api.datasets.labelled import ERROR, MOMENT, USE, Column, labelled
from wrapjax.model import QUANTITIES
from wrapjax.subject.legs import name_without_side

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.report.comparison.samples import ComparedLeg

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
