"""What a finished calibration predicts on other cycles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from wrapjax.api.datasets.labelled import ERROR, MOMENT, Column, labelled, of_trials
from wrapjax.subject import Trials

if TYPE_CHECKING:
    from xarray import Dataset


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
