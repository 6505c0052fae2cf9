"""Context of a calibrated subject: everything that effects are built from.

The context holds the changes of the measured moments and of the recorded paths by errors in the inputs of
inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, Int

from wrapjax.calibration.calibration import Calibration
from wrapjax.calibration.objective import Objective
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.effect import EffectSizes
from wrapjax.diagnosis.inputs.context import AtBound, ChangesOfCycles, Context, MeasuredChange, PathChanges
from wrapjax.diagnosis.inputs.read_movement import read_recorded_movement
from wrapjax.diagnosis.inputs.recorded_movement import RecordedMovement
from wrapjax.diagnosis.inputs.recorded_paths import RecordedPaths, engine_motion
from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.path_derivatives import (
    derivatives_by_angles,
    derivatives_by_ends,
    derivatives_by_wrap_parameters,
)
from wrapjax.geometry.paths import PathState, fixed_path
from wrapjax.geometry.surrogates.wrap_bounds import USUAL_TRANSLATION
from wrapjax.model.forward import Recording
from wrapjax.model.parameters import QUANTITIES
from wrapjax.path_sources.exact import ExactGeometry, build_engine, freed_wraps, touched_wraps
from wrapjax.path_sources.model_inputs import recording
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.path_sources.undriven_muscles import build_undriven_muscles
from wrapjax.subject.subject import Subject


def compute_measured_changes(movement: RecordedMovement) -> dict[str, dict[str, MeasuredChange]]:
    """Compute what each effect adds to the measured moments.

    An effect size is an error in the laboratory's inputs of inverse dynamics, and the change is what this
    error added to the moments. It is linear in the effect sizes.

    Parameters
    ----------
    movement
        Recorded movement.

    Returns
    -------
    changes
        By identifier of the effect and label of the variant: functions from effect sizes to N m (trial x
        coordinate x frame). Effects and variants that change nothing are left out.
    """
    return {
        definition.id: changes
        for definition in CATALOGUE.values()
        if definition.moment_derivatives is not None
        and (
            changes := {
                label: _linear_change(movement, derivatives)
                for label, derivatives in definition.moment_derivatives(movement).items()
                if derivatives.any()
            }
        )
    }


def compute_path_changes(
    recorded: RecordedPaths, measured: Collection[str]
) -> dict[str, Mapping[str, PathState]]:
    """Compute what a unit of each effect size adds to the recorded paths (`Context.path_changes`).

    Parameters
    ----------
    recorded
        Recorded paths.
    measured
        Identifiers of the effects that change the measured moments; paths of other effects are not needed.
    """
    return {
        definition.id: changes
        for definition in CATALOGUE.values()
        if definition.id in measured
        and definition.path_derivatives is not None
        and (changes := definition.path_derivatives(recorded))
    }


def _linear_change(
    movement: RecordedMovement, derivatives: Float[np.ndarray, "parameter coordinate pose"]
) -> MeasuredChange:
    by_trial = derivatives.reshape(*derivatives.shape[:2], *movement.time.shape)
    return Partial(_sum_changes, jnp.asarray(np.moveaxis(by_trial, 1, 2)))


def _sum_changes(
    derivatives: Float[Array, "parameter trial coordinate frame"], effect_sizes: EffectSizes
) -> Float[Array, "trial coordinate frame"]:
    return jnp.tensordot(effect_sizes, derivatives, axes=1)


#: Prior standard deviation of the place of a muscle's end (m): personalised paths have moment arms that
#: differ from the model's by 4 to 12 mm.
_ATTACHMENT_SD = 0.005
#: Reason why an effect changes no moments although everything that inverse dynamics need was recorded.
_INDEPENDENT = "inverse dynamics about these coordinates do not depend on it"


def build_context(
    calibration: Calibration, recorded: tuple[RecordedMovement | None, str] | None = None
) -> tuple[Recording, Context]:
    """Build the context of a calibrated subject, over all its cycles, those for validation included.

    Paths are fixed at their calibrated values. What cannot be computed (wraps that the exact engine does not
    support, muscles without EMG whose paths it cannot compute) is left out, and effects give the reason.

    Parameters
    ----------
    calibration
        Calibration of one leg.
    recorded
        Recorded movement from which inverse dynamics are computed, or None and the reason why there is none;
        read from the subject's files if not given.

    Returns
    -------
    recording
        Inputs of the forward model, with fixed paths.
    context
        Context of all cycles.
    """
    subject, fit, result = calibration.subject, calibration.fit, calibration.result
    trials = subject.trials
    inputs = recording(subject, trials, fit.paths(subject, trials, result.freedom))
    paths = inputs.path.at(result.parameters.path_changes)
    inputs = replace(inputs, path=fixed_path(paths))
    columns = [trials.coordinates.index(name) for name in trials.moment_coordinates]
    engine = _build_engine(subject)
    by_angle = paths_by_angle(fit, subject)
    undriven_muscles, no_undriven_muscles = build_undriven_muscles(subject, result.curves)
    movement, no_measured_changes = recorded or read_recorded_movement(subject)
    measured_changes = {} if movement is None else compute_measured_changes(movement)
    path_changes = (
        {}
        if movement is None
        else compute_path_changes(RecordedPaths(subject, movement, engine, paths, by_angle), measured_changes)
    )
    context = Context(
        muscles=subject.muscles.names,
        channels=trials.channels,
        muscle_channels=subject.muscle_channels,
        coordinates=trials.moment_coordinates,
        trials=trials.names,
        recordings=trials.recordings,
        uses=trials.uses,
        angles=trials.angles[:, columns],
        velocities=trials.angular_velocities[:, columns],
        step=np.diff(trials.time[:, [0, -1]])[:, 0] / (trials.time.shape[1] - 1),
        speeds=trials.speeds,
        order=np.linspace(0.0, 1.0, len(trials)),
        padding=trials.padding,
        parameters=result.parameters,
        paths=paths,
        envelopes=inputs.emg.coefficients,
        paretic=subject.paretic,
        undriven_muscles=undriven_muscles,
        no_undriven_muscles=no_undriven_muscles,
        paths_by_angle=by_angle,
        wraps=None if engine is None else wrap_changes(engine, subject),
        attachments=None if engine is None else attachment_changes(engine, subject),
        at_bounds=_parameters_at_bounds(calibration),
        path_changes=path_changes,
        measured_changes=measured_changes,
        no_measured_changes=no_measured_changes or _INDEPENDENT,
        joint_spread=subject.joint_spread,
    )
    return inputs, context


def changes_by_inverse_dynamics(
    calibration: Calibration,
    movement: RecordedMovement,
    context: Context,
    cycles: Int[np.ndarray, " chosen"],
) -> ChangesOfCycles:
    """Compute what errors in the inputs of inverse dynamics change in some cycles of a context.

    Parameters
    ----------
    calibration
        Calibration whose subject has these cycles alone.
    movement
        Their recorded movement.
    context, cycles
        Context with the paths of these cycles, and their numbers in it.
    """
    measured, own = compute_measured_changes(movement), context.select(cycles.tolist())
    subject = calibration.subject
    recorded = RecordedPaths(subject, movement, _build_engine(subject), own.paths, own.paths_by_angle)
    return ChangesOfCycles(cycles, measured, compute_path_changes(recorded, measured))


def paths_by_angle(fit: Fit | ExactGeometry, subject: Subject) -> PathState | None:
    """Differentiate polynomial paths by the angles of the moment coordinates; None for other paths."""
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
    """Compute how paths change with the parameters of their wraps; None where no wrap is touched."""
    _, touched = touched_wraps(engine, subject.trials)
    if not touched:
        return None
    motion = engine_motion(engine, subject)
    return changes_of_wraps(
        engine, touched, lambda moving: derivatives_by_wrap_parameters(engine, *motion, moving)
    )


def changes_of_wraps(
    engine: ExactPaths,
    touched: tuple[str, ...],
    derivatives: Callable[[Bool[np.ndarray, " muscle"]], PathState],
) -> PathChanges:
    """Compute the changes of paths by the parameters of some wraps.

    Parameters
    ----------
    engine
        Exact engine of the muscles.
    touched
        Names of the wraps.
    derivatives
        Function from the muscles that these wraps move to the derivatives of the paths; see
        `derivatives_by_wrap_parameters`.
    """
    # The feasible range of each wrap takes long to find, and effects need usual sizes only.
    usual = dict.fromkeys(touched, USUAL_TRANSLATION)
    wraps_of = [engine.wraps_of(name) for name in engine.muscles]
    freed = freed_wraps(wraps_of, usual, engine.wrap_classes, engine.parameters)
    moving = np.asarray((freed.places >= 0).any(axis=1))
    number = np.where(freed.free, np.cumsum(freed.free.ravel()).reshape(freed.free.shape) - 1, -1)
    entries = np.argwhere(freed.free)
    return PathChanges(
        derivatives=derivatives(moving),
        places=np.where(freed.places[:, :, None] < 0, -1, number[freed.places]).reshape(len(wraps_of), -1),
        names=tuple(f"{freed.names[wrap]}.{freed.quantities[place]}" for wrap, place in entries),
        units=tuple(freed.units[place] for _, place in entries),
        prior_sd=tuple(freed.prior_sd[freed.free].tolist()),
    )


def attachment_changes(engine: ExactPaths, subject: Subject) -> PathChanges:
    """Compute how paths change with the places of the muscles' ends."""
    return changes_of_ends(engine.muscles, derivatives_by_ends(engine, *engine_motion(engine, subject)))


def changes_of_ends(muscles: tuple[str, ...], derivatives: PathState) -> PathChanges:
    """Compute the changes of paths by the places of the muscles' ends; see `derivatives_by_ends`."""
    count = len(muscles)
    ends = [f"{end}_{axis}_m" for end in ("origin", "insertion") for axis in "xyz"]
    return PathChanges(
        derivatives=derivatives,
        places=np.arange(6 * count).reshape(count, 6),
        names=tuple(f"{muscle}.{end}" for muscle in muscles for end in ends),
        units=("m",) * (6 * count),
        prior_sd=(_ATTACHMENT_SD,) * (6 * count),
    )


def _parameters_at_bounds(calibration: Calibration) -> tuple[AtBound, ...]:
    """Find the calibrated parameters of muscles that are at a bound."""
    result = calibration.result
    solution = result.outcomes[result.chosen].solution
    problem = solution.problem
    assert isinstance(problem, Objective)
    variables = problem.variables
    at_bounds = []
    for label in result.at_bounds:
        place = variables.labels.index(label)
        muscle, name = label.rsplit(".", 1)
        if name not in QUANTITIES or muscle not in result.muscles:
            continue
        scale = variables.scale[result.muscles.index(muscle), variables.names.index(name)]
        lower, upper = scale * variables.lower[place], scale * variables.upper[place]
        outward = 1 if solution.variables[place] >= variables.upper[place] else -1
        # A parameter with a positive lower bound must stay positive.
        limit = upper - lower if outward > 0 or lower <= 0.0 else min(upper - lower, 0.9 * lower)
        precision = variables.prior_precision[place]
        sd = min(scale / precision if precision > 0.0 else np.inf, 0.25 * (upper - lower), 0.5 * limit)
        at_bounds.append(AtBound(muscle, name, outward, float(sd), QUANTITIES[name].unit, float(limit)))
    return tuple(at_bounds)


def _build_engine(subject: Subject) -> ExactPaths | None:
    """Build the exact engine of a subject's muscles; None where it does not support an element of a path."""
    try:
        return build_engine(subject)
    except InputError:
        return None
