"""From a calibrated subject to what effects know of it.

How a subject's recorded paths follow cylinders, ends, joints and angles: what effects on geometry need.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from wrapjax.calibration.calibration import Calibration
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.context import AtBound, Context, PathChanges, change_id, known_shape
from wrapjax.diagnosis.inverse_dynamics.measured_changes import INDEPENDENT, measured_changes, recorded_walk
from wrapjax.diagnosis.inverse_dynamics.recorded_walk import Walk
from wrapjax.diagnosis.inverse_dynamics.wrong_inputs import TURNS, foot_loads, turn_sign
from wrapjax.errors import InputError
from wrapjax.geometry.engine import ExactPaths
from wrapjax.geometry.joint_changes import with_moved_joint, with_rotated_joint_axes
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.path_derivatives import (
    derivatives_by_angles,
    derivatives_by_ends,
    derivatives_by_model_changes,
    derivatives_by_wrap_parameters,
)
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.geometry.wrap_bounds import USUAL_TRANSLATION
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import QUANTITIES
from wrapjax.path_sources.exact import ExactGeometry, build_engine, freed_wraps, touched_wraps
from wrapjax.path_sources.model_inputs import recording
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import build_undriven_muscles
from wrapjax.subject.subject import Subject

#: How far a muscle's end may be from where the model has it (m): personalised paths have moment arms that
#: differ from the model's by 4 to 12 mm.
_ATTACHMENT_SD = 0.005

_Misplace = Callable[[ModelDescription, str, int, float], ModelDescription]
_ModelAt = Callable[[float], ModelDescription]


def paths_by_angle(fit: Fit | ExactGeometry, subject: Subject) -> PathState | None:
    """Differentiate polynomial paths by the angles that moments are about; None for other paths."""
    if not isinstance(fit, Fit):
        return None
    trials, surrogate = subject.trials, fit.surrogate.select_muscles(subject.muscles.names)
    recorded = [trials.coordinates.index(name) for name in surrogate.coordinates]
    return derivatives_by_angles(
        surrogate,
        trials.angles[:, recorded],
        trials.angular_velocities[:, recorded],
        trials.moment_coordinates,
    )


def wrap_changes(engine: ExactPaths, subject: Subject) -> PathChanges | None:
    """Say how paths follow their cylinders; None where none is touched."""
    _, touched = touched_wraps(engine, subject.trials)
    if not touched:
        return None
    # How far each could move takes long to find; of an effect only what is usual counts.
    usual = dict.fromkeys(touched, USUAL_TRANSLATION)
    freed = freed_wraps([engine.wraps_of(name) for name in engine.muscles], usual)
    moving = np.asarray((freed.places >= 0).any(axis=1))
    count = len(freed.quantities)
    places = freed.places[:, :, None] * count + np.arange(count)
    return PathChanges(
        paths=Partial(
            _along, derivatives_by_wrap_parameters(engine, *_laid_through(engine, subject), moving)
        ),
        places=np.where(freed.places[:, :, None] < 0, -1, places).reshape(len(engine.muscles), -1),
        names=tuple(f"{wrap}.{quantity}" for wrap in freed.names for quantity in freed.quantities),
        units=freed.units * len(freed.names),
        prior_sd=tuple(freed.prior_sd.ravel().tolist()),
    )


def attachment_changes(engine: ExactPaths, subject: Subject) -> PathChanges:
    """Say how paths follow their muscles' ends."""
    count = len(engine.muscles)
    ends = [f"{end}_{axis}_m" for end in ("origin", "insertion") for axis in "xyz"]
    return PathChanges(
        paths=Partial(_along, derivatives_by_ends(engine, *_laid_through(engine, subject))),
        places=np.arange(6 * count).reshape(count, 6),
        names=tuple(f"{muscle}.{end}" for muscle in engine.muscles for end in ends),
        units=("m",) * (6 * count),
        prior_sd=(_ATTACHMENT_SD,) * (6 * count),
    )


def misplaced_joints(
    engine: ExactPaths, subject: Subject, walk: Walk, wanted: Collection[str]
) -> dict[str, PathState]:
    """Say by how much paths differ where the laboratory's model has a joint in a wrong place.

    Parameters
    ----------
    engine, subject, walk
        Of one leg.
    wanted
        Ids of effects, or of their shapes; of these, those of ``hip_center_offset`` and
        ``joint_axis_rotation`` are looked at.

    Returns
    -------
    dict
        As `Context.path_changes`: where the model's joint is too far forward, the person's is behind it.
    """
    hip = ((0, 1.0), (1, 1.0), (2, walk.outward))
    ways = {
        "hip_center_offset": [(with_moved_joint, "hip_", axis, sign) for axis, sign in hip],
        "joint_axis_rotation": [
            (with_rotated_joint_axes, stem, axis, turn_sign(axis, walk.outward)) for stem, axis in TURNS
        ],
    }
    names = subject.trials.moment_coordinates

    def elsewhere(misplace: _Misplace, stem: str, axis: int, sign: float) -> _ModelAt:
        coordinate = next((name for name in names if name.startswith(stem)), None)
        if coordinate is None:
            return lambda step: engine.model
        return lambda step: misplace(engine.model, coordinate, axis, -sign * step)

    through = _laid_through(engine, subject)
    return {
        id: derivatives_by_model_changes(engine, [elsewhere(*way) for way in own], *through)
        for id, own in ways.items()
        if any(known_shape(one, id) is not None for one in wanted)
    }


def deformed_foot(
    by_angle: PathState, subject: Subject, paths: PathState, walk: Walk
) -> dict[str, PathState]:
    """Say by how much paths differ where the ankle was recorded off by the foot's load, for 1 rad at most.

    Parameters
    ----------
    by_angle, subject, paths, walk
        How paths change with angles (`paths_by_angle`), and what was recorded.

    Returns
    -------
    dict
        As `Context.path_changes`, by shapes of ``foot_deformation``.
    """
    names = subject.trials.moment_coordinates
    ankle = [row for row, name in enumerate(names) if name.startswith("ankle_angle")][:1]
    step = (walk.time[:, 1] - walk.time[:, 0])[:, None]

    def changed(load: Float[np.ndarray, "trial frame"]) -> PathState:
        # The bones lag behind what was recorded.
        arm, bend = paths.moment_arm[:, :, ankle[0]], -load
        rate = np.gradient(bend, axis=-1) / step
        of_unit = jax.tree.map(lambda leaf: leaf[:, ankle], by_angle)
        return PathState(
            length=bend * of_unit.length,
            velocity=bend * of_unit.velocity - (rate * arm)[:, None],
            moment_arm=bend[:, None] * of_unit.moment_arm,
        )

    return {change_id("foot_deformation", where): changed(load) for where, load in foot_loads(walk).items()}


def _laid_through(
    engine: ExactPaths, subject: Subject
) -> tuple[Float[np.ndarray, "trial _ frame"], Float[np.ndarray, "trial _ frame"], tuple[str, ...]]:
    """Angles and rates of the engine's coordinates, and what moment arms are wanted about."""
    trials = subject.trials
    columns = [trials.coordinates.index(name) for name in engine.coordinates]
    return trials.angles[:, columns], trials.angular_velocities[:, columns], trials.moment_coordinates


def _along(slopes: PathState, changes: Float[Array, "muscle mode"]) -> PathState:
    return jax.tree.map(lambda leaf: jnp.einsum("mk,mk...->m...", changes, leaf), slopes)


def diagnosis_context(calibration: Calibration) -> tuple[Recording, Context]:
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
    others, no_others = build_undriven_muscles(subject, result.curves)
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
        return build_engine(subject)
    except InputError:
        return None
