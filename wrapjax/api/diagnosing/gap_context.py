"""From a calibrated subject to what effects know of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrapjax.api.calibrating.assembly import recording
from wrapjax.api.calibrating.calibration import Calibration
from wrapjax.api.calibrating.undriven import other_muscles
from wrapjax.api.diagnosing.path_changes import (
    attachment_changes,
    deformed_foot,
    misplaced_joints,
    paths_by_angle,
    wrap_changes,
)
from wrapjax.api.paths.exact import engine_of
from wrapjax.calibrate import Objective
from wrapjax.errors import InputError
from wrapjax.gap import AtBound, Context
from wrapjax.geometry import fixed_path
from wrapjax.geometry.engine import ExactPaths
from wrapjax.measurement import INDEPENDENT, measured_changes, recorded_walk
from wrapjax.model import QUANTITIES, Recording
from wrapjax.subject import Subject


def gap_context(calibration: Calibration) -> tuple[Recording, Context]:
    """Gather what effects need, over all of a subject's cycles, those for validation too.

    Paths are held as calibration left them. What cannot be had (cylinders that the exact engine does not
    know, muscles without EMG that it cannot lay) is left out, and effects say so.

    Parameters
    ----------
    calibration
        Of one leg.

    Returns
    -------
    recording, context
        What the forward model takes in, with held paths, and what effects know.
    """
    subject, fit, result = calibration.subject, calibration.fit, calibration.result
    trials = subject.trials
    inputs = recording(subject, trials, fit.paths(subject, trials, result.freedom))
    paths = inputs.path.at(result.parameters.path_changes)
    inputs = replace(inputs, path=fixed_path(paths))
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    engine = _engine(subject)
    by_angle = paths_by_angle(fit, subject)
    others, no_others = other_muscles(subject, result.curves)
    walk, no_changes = recorded_walk(subject)
    changes = {} if walk is None else measured_changes(walk)
    misplaced = {} if walk is None or engine is None else misplaced_joints(engine, subject, walk, changes)
    if walk is not None and by_angle is not None:
        misplaced |= deformed_foot(by_angle, subject, paths, walk)
    context = Context(
        muscles=subject.muscles.names,
        channels=trials.channels,
        muscle_channels=subject.muscle_channels,
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        angles=trials.angles[:, columns],
        velocities=trials.angular_velocities[:, columns],
        step=np.diff(trials.time[:, [0, -1]])[:, 0] / (trials.time.shape[1] - 1),
        speeds=trials.speeds,
        order=np.linspace(0.0, 1.0, len(trials)),
        padding=trials.padding,
        parameters=result.parameters,
        paths=paths,
        paretic=subject.paretic,
        others=others,
        no_others=no_others,
        paths_by_angle=by_angle,
        wraps=None if engine is None else wrap_changes(engine, subject),
        attachments=None if engine is None else attachment_changes(engine, subject),
        at_bounds=_at_bounds(calibration),
        path_changes=misplaced,
        measured_changes=changes,
        no_measured_changes=no_changes or INDEPENDENT,
    )
    return inputs, context


def _at_bounds(calibration: Calibration) -> tuple[AtBound, ...]:
    """Find the muscles' parameters that ended on a bound."""
    result = calibration.result
    solution = result.outcomes[result.chosen].solution
    problem = solution.problem
    assert isinstance(problem, Objective)
    variables = problem.variables
    found = []
    for label in result.at_bounds:
        place = variables.labels.index(label)
        muscle, name = label.rsplit(".", 1)
        if name not in QUANTITIES or muscle not in result.muscles:
            continue
        scale = variables.scale[result.muscles.index(muscle), variables.names.index(name)]
        lower, upper = scale * variables.lower[place], scale * variables.upper[place]
        outward = 1 if solution.variables[place] >= variables.upper[place] else -1
        # What cannot be zero must not get there.
        limit = upper - lower if outward > 0 or lower <= 0.0 else min(upper - lower, 0.9 * lower)
        precision = variables.prior_precision[place]
        sd = min(scale / precision if precision > 0.0 else np.inf, 0.25 * (upper - lower), 0.5 * limit)
        found.append(AtBound(muscle, name, outward, float(sd), QUANTITIES[name].unit, float(limit)))
    return tuple(found)


def _engine(subject: Subject) -> ExactPaths | None:
    """Build the exact engine of a subject's muscles; None where a path has what it does not know."""
    try:
        return engine_of(subject)
    except InputError:
        return None
