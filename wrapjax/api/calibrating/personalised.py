"""The model that a calibration found, as a file that OpenSim opens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wrapjax.calibrate import CalibrationResult
from wrapjax.geometry.surfaces import NOMINAL
from wrapjax.osim import MuscleConstants, write_personalised_model
from wrapjax.subject import Subject
from wrapjax.subject.model_file import MuscleParameters, read_model_file


def write_model(subject: Subject, result: CalibrationResult, file: Path) -> None:
    """Write a subject's model with its cylinders and muscles as calibrated.

    Parameters
    ----------
    subject, result
        What was calibrated, and what came of it. Cylinders that were held stay as they are. Driven muscles
        get all constants that the calibration had, those too that it held; others of the leg get what the
        subject says of them, where that is not what the model says.
    file
        Where to; written whole or not at all.
    """
    wraps = {}
    if result.freedom.wraps is not None:
        values = NOMINAL + result.freedom.wraps.changes_of(np.asarray(result.parameters.path_changes))
        wraps = dict(zip(result.freedom.wraps.names, map(tuple, values.tolist()), strict=True))
    muscles = dict(_undriven(subject)) | dict(_constants(_calibrated(result)))
    write_personalised_model(subject.model_file, file, wraps, muscles)


def _calibrated(result: CalibrationResult) -> MuscleParameters:
    found = result.parameters
    return MuscleParameters(
        names=result.muscles,
        max_isometric_force=np.asarray(found.max_isometric_force),
        optimal_fiber_length=np.asarray(found.optimal_fiber_length),
        tendon_slack_length=np.asarray(found.tendon_slack_length),
        pennation_angle=np.asarray(found.pennation_angle),
    )


def _undriven(subject: Subject) -> Iterator[tuple[str, MuscleConstants]]:
    """Give constants of muscles that nothing drives, where the subject's table differs from its model."""
    if subject.undriven_parameters is None:
        return
    in_model = dict(_constants(read_model_file(subject.model_file).muscles))
    for name, constants in _constants(subject.undriven_parameters):
        if constants != in_model[name]:
            yield name, constants


def _constants(muscles: MuscleParameters) -> Iterator[tuple[str, MuscleConstants]]:
    columns = (
        muscles.optimal_fiber_length,
        muscles.tendon_slack_length,
        muscles.max_isometric_force,
        muscles.pennation_angle,
    )
    for name, *values in zip(muscles.names, *(column.tolist() for column in columns), strict=True):
        yield name, MuscleConstants(*values)
