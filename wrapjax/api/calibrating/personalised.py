"""The model that a calibration found, as a file that OpenSim opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wrapjax.calibrate import CalibrationResult
from wrapjax.geometry.surfaces import NOMINAL
from wrapjax.osim import write_personalised_model
from wrapjax.subject import Subject


def write_model(subject: Subject, result: CalibrationResult, file: Path) -> None:
    """Write a subject's model with its cylinders, fiber and slack lengths as calibrated.

    Parameters
    ----------
    subject, result
        What was calibrated, and what came of it. Cylinders that were held stay as they are; so do
        muscles that are not driven.
    file
        Where to; written whole or not at all.
    """
    wraps = {}
    if result.freedom.wraps is not None:
        values = NOMINAL + result.freedom.wraps.changes_of(np.asarray(result.parameters.path_changes))
        wraps = dict(zip(result.freedom.wraps.names, map(tuple, values.tolist()), strict=True))
    found = result.parameters
    lengths = np.stack([found.optimal_fiber_length, found.tendon_slack_length], axis=1)
    muscles = dict(zip(result.muscles, map(tuple, lengths.tolist()), strict=True))
    write_personalised_model(subject.model_file, file, wraps, muscles)
