"""What all labelled arrays share: axes, units, and what is known of each cycle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from wrapjax.calibrate import CalibrationResult
from wrapjax.gap.result import GapResult
from wrapjax.subject import Trials

if TYPE_CHECKING:
    from xarray import Dataset

#: Axes, unit, meaning and values of a variable.
Column = tuple[tuple[str, ...], str, str, Any]

MOMENT = ("trial", "coordinate", "frame")
USE = "calibration or validation"
ERROR = (
    ("trial", "coordinate"),
    "N m",
    "mean over frames of the absolute difference of modelled and measured moment",
)


def of_trials(result: CalibrationResult | GapResult | Trials) -> dict[str, Column]:
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
