"""From a calibrated subject to what effects know of it."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.api.calibrating.assembly import recording
from wrapjax.api.calibrating.calibration import Calibration
from wrapjax.api.calibrating.undriven import other_muscles
from wrapjax.api.paths.cylinders import freed_wraps
from wrapjax.api.paths.exact import ExactGeometry, engine_of, touched_cylinders
from wrapjax.api.paths.fitting import Fit
from wrapjax.calibrate import Objective
from wrapjax.errors import InputError
from wrapjax.gap import AtBound, Context, PathChanges
from wrapjax.geometry import PathState, fixed_path
from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.path_slopes import slopes_by_angles, slopes_by_ends, slopes_by_wraps
from wrapjax.geometry.wrap_boxes import USUAL_TRANSLATION
from wrapjax.measurement import measured_changes
from wrapjax.model import QUANTITIES, Recording
from wrapjax.subject import Subject

#: How far a muscle's end may be from where the model has it (m): personalised paths have moment arms that
#: differ from the model's by 4 to 12 mm.
_ATTACHMENT_SD = 0.005


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
    wraps, attachments = _engine_changes(subject)
    others, no_others = other_muscles(subject, result.curves)
    changes, no_changes = measured_changes(subject)
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
        paths_by_angle=_paths_by_angle(fit, subject),
        wraps=wraps,
        attachments=attachments,
        at_bounds=_at_bounds(calibration),
        measured_changes=changes,
        no_measured_changes=no_changes,
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


def _paths_by_angle(fit: Fit | ExactGeometry, subject: Subject) -> PathState | None:
    """Differentiate polynomial paths by the angles that moments are about; None for other paths."""
    if not isinstance(fit, Fit):
        return None
    trials, surrogate = subject.trials, fit.surrogate.of_muscles(subject.muscles.names)
    recorded = [trials.coordinates.index(name) for name in surrogate.coordinates]
    return slopes_by_angles(
        surrogate,
        trials.angles[:, recorded],
        trials.angular_velocities[:, recorded],
        trials.moment_coordinates,
    )


def _engine_changes(subject: Subject) -> tuple[PathChanges | None, PathChanges | None]:
    """Ask the exact engine how paths follow their cylinders and their ends, to first order."""
    try:
        engine = engine_of(subject)
    except InputError:
        return None, None
    return _wrap_changes(engine, subject), _attachment_changes(engine, subject)


def _wrap_changes(engine: ExactPaths, subject: Subject) -> PathChanges | None:
    _, touched = touched_cylinders(engine, subject.trials)
    if not touched:
        return None
    # How far each could move takes long to find; of an effect only what is usual counts.
    usual = dict.fromkeys(touched, USUAL_TRANSLATION)
    freed = freed_wraps([engine.wraps_of(name) for name in engine.muscles], usual)
    moving = np.asarray((freed.places >= 0).any(axis=1))
    count = len(freed.quantities)
    places = freed.places[:, :, None] * count + np.arange(count)
    return PathChanges(
        paths=Partial(_along, slopes_by_wraps(engine, *_laid_through(engine, subject), moving)),
        places=np.where(freed.places[:, :, None] < 0, -1, places).reshape(len(engine.muscles), -1),
        names=tuple(f"{wrap}.{quantity}" for wrap in freed.names for quantity in freed.quantities),
        units=freed.units * len(freed.names),
        prior_sd=tuple(freed.prior_sd.ravel().tolist()),
    )


def _attachment_changes(engine: ExactPaths, subject: Subject) -> PathChanges:
    count = len(engine.muscles)
    ends = [f"{end}_{axis}_m" for end in ("origin", "insertion") for axis in "xyz"]
    return PathChanges(
        paths=Partial(_along, slopes_by_ends(engine, *_laid_through(engine, subject))),
        places=np.arange(6 * count).reshape(count, 6),
        names=tuple(f"{muscle}.{end}" for muscle in engine.muscles for end in ends),
        units=("m",) * (6 * count),
        prior_sd=(_ATTACHMENT_SD,) * (6 * count),
    )


def _laid_through(
    engine: ExactPaths, subject: Subject
) -> tuple[Float[np.ndarray, "trial _ frame"], Float[np.ndarray, "trial _ frame"], tuple[str, ...]]:
    """Angles and rates of the engine's coordinates, and what moment arms are wanted about."""
    trials = subject.trials
    columns = [trials.coordinates.index(name) for name in engine.coordinates]
    return trials.angles[:, columns], trials.angular_velocities[:, columns], trials.moment_coordinates


def _along(slopes: PathState, changes: Float[Array, "muscle mode"]) -> PathState:
    return jax.tree.map(lambda leaf: jnp.einsum("mk,mk...->m...", changes, leaf), slopes)
