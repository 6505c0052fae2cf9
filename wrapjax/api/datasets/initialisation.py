"""Lengths to start a calibration from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wrapjax.api.datasets.labelled import Column, labelled
from wrapjax.model import QUANTITIES

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.api.calibrating.initialisation import Initialisation


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
