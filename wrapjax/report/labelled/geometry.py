"""xarray datasets of muscle paths, motions and joints; see `wrapjax.report.labelled.arrays`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.report.labelled.arrays import Column, labelled

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.joints.result import JointPersonalisation
    from wrapjax.path_sources.muscle_paths import MusclePaths, PathValues
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.preprocessing.inverse_kinematics import InverseKinematics


def muscle_path_dataset(
    paths: MusclePaths, poses: Float[np.ndarray, "pose coordinate"], values: PathValues
) -> Dataset:
    """Make a dataset of lengths and moment arms in poses (rad or m)."""
    columns: dict[str, Column] = {
        "coordinate_value": (("pose", "coordinate"), "rad or m", "pose", poses),
        "length": (("pose", "muscle"), "m", "length of muscle and tendon", values.length),
        "moment_arm": (
            ("pose", "coordinate", "muscle"),
            "m (m/rad)",
            "moment arm, the negative derivative of the length",
            values.moment_arm,
        ),
        "touching": (("pose", "muscle"), "", "whether the muscle touches a wrap", values.touching),
    }
    labels = {"pose": np.arange(len(poses)), "coordinate": paths.coordinates, "muscle": paths.muscles}
    return labelled(columns, labels, {}, {"mode": paths.mode})


def inverse_kinematics_dataset(result: InverseKinematics) -> Dataset:
    """Make a dataset of a motion: coordinates (rad or m) and markers in ground (m)."""
    place = ("marker", "frame", "axis")
    columns: dict[str, Column] = {
        "coordinate_value": (
            ("coordinate", "frame"),
            "rad or m",
            "joint angle or displacement",
            result.values,
        ),
        "model_marker": (place, "m", "position of the model's marker in ground", result.positions),
        "measured_marker": (place, "m", "measured position in ground", result.measured),
        "marker_distance": (("marker", "frame"), "m", "distance of both", result.distances),
    }
    labels = {
        "coordinate": result.coordinates,
        "marker": result.markers,
        "frame": np.arange(result.time.size),
        "axis": ("x", "y", "z"),
    }
    of_coordinate, meaning = ("coordinate",), "whether the markers determine the coordinate"
    coordinates: dict[str, Column] = {
        "time": (("frame",), "s", "time in the recording", result.time),
        "unit": (of_coordinate, "", "unit of the coordinate", np.where(result.rotational, "rad", "m")),
        "determined": (of_coordinate, "", meaning, result.determined),
        "weight": (("marker",), "1", "weight of the marker", result.weights),
    }
    return labelled(columns, labels, coordinates, {})


def fit_dataset(fit: Fit) -> Dataset:
    """Make a dataset of the errors of polynomial paths, by muscle, in poses that were not used in fitting."""
    axis, errors = ("muscle",), list(fit.errors.values())
    columns: dict[str, Column] = {
        f"{what}_{how}": (
            axis,
            unit,
            f"{meaning} of the {what.replace('_', ' ')}",
            [1e-3 * getattr(one, f"{what}_{how}_mm") for one in errors],
        )
        for what, unit in (("length", "m"), ("moment_arm", "m/rad"))
        for how, meaning in (("rmse", "root mean square error"), ("max", "largest error"))
    }
    columns["terms"] = (axis, "1", "number of coefficients", [one.terms for one in errors])
    columns["wrapped"] = (axis, "", "whether the muscle has wraps", [one.wrapped for one in errors])
    return labelled(columns, {"muscle": tuple(fit.errors)}, {}, {"geometry": fit.geometry})


def joints_dataset(result: JointPersonalisation) -> Dataset:
    """Make a dataset of freed values of joints, scales and markers, and of marker distances by trial."""
    axis, own, parameters = ("parameter",), "as stated in unit", result.parameters
    markers = tuple(dict.fromkeys(name for trial in result.trials for name in trial.after.markers))
    distance = np.full((len(result.trials), 2, len(markers)), np.nan)
    for row, trial in enumerate(result.trials):
        for column, one in enumerate((trial.before, trial.after)):
            places = [markers.index(name) for name in one.markers]
            distance[row, column, places] = np.sqrt(np.nanmean(one.distances**2, axis=1))
    columns: dict[str, Column] = {
        "value": (axis, own, "difference from the starting model", result.values),
        "sd": (axis, own, "posterior standard deviation", result.posterior.sd),
        "prior_sd": (axis, own, "prior standard deviation", [one.sd for one in parameters]),
        "determined": (axis, "", "whether markers determine the value", result.posterior.determined),
        "marker_distance": (
            ("trial", "stage", "marker"),
            "m",
            "root mean square distance of the model's marker from the measured one",
            distance,
        ),
    }
    labels = {
        "parameter": [one.name for one in parameters],
        "trial": [trial.name for trial in result.trials],
        "stage": ("before", "after"),
        "marker": markers,
    }
    unit: Column = (axis, "", "unit of the parameter", [one.unit for one in parameters])
    return labelled(columns, labels, {"unit": unit}, {"subject": result.settings.name})
