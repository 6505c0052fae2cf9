"""Initial fiber and tendon slack lengths for a calibration (``initialise``)."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.calibration.initial_lengths import InitialLengthObjective, LengthErrors
from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.geometry.exact_paths.engine import ExactPaths
from wrapjax.geometry.exact_paths.path_derivatives import compute_nominal_paths
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.io.model_file import MuscleParameters, read_model_file
from wrapjax.jax_setup import require_float64
from wrapjax.model.parameters import initial_parameters
from wrapjax.muscle.curves import hill_curves
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import recorded_motion
from wrapjax.path_sources.undriven_muscles import acting_muscles
from wrapjax.subject.muscle_groups import fiber_length_groups
from wrapjax.subject.muscle_parameters import CSV_COLUMNS
from wrapjax.subject.passive_trials import PassiveTrial
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from xarray import Dataset

    from wrapjax.report.calibration.initialisation_page import PassiveCurves

#: Name of the table that ``subject.toml`` can refer to as ``[model] muscle_parameters``.
PARAMETERS_FILE = "muscle_parameters.csv"
#: Note in the results where there is no passive trial.
NO_PASSIVE_TRIALS = (
    "No [[passive]] trial: lengths follow from operating ranges of the fibers in walking alone."
)


@dataclass(frozen=True)
class Initialisation:
    """Fiber and slack lengths determined from passive moments and operating ranges.

    Parameters
    ----------
    subject
        Subject whose lengths were determined.
    before, after
        Parameters of all muscles before and after, including those without an electrode.
    at_bounds
        Names of the lengths whose ratio to the model's is at a bound, as ``soleus_l.optimal_fiber_length``.
    ranges
        Shortest and longest normalised fiber length in walking, before and after.
    passive
        Passive moments about the matched coordinates, N m: recorded (NaN where not), before and after; the
        samples of all passive trials one after the other.
    cost_by_term
        Cost of each term at the solution.
    status
        Reason why the solver stopped.
    """

    subject: Subject
    before: MuscleParameters
    after: MuscleParameters
    at_bounds: tuple[str, ...]
    ranges: Float[np.ndarray, "2 muscle 2"]
    passive: Float[np.ndarray, "3 coordinate sample"]
    cost_by_term: dict[str, float]
    status: Status

    @property
    def passive_mae(self) -> dict[str, tuple[float, float]]:
        """Mean absolute error of passive moments by coordinate, N m, before and after; empty without any."""
        measured, *modelled = self.passive
        known = np.isfinite(measured)
        missed = np.abs(np.array(modelled) - measured)
        return {
            name: (float(missed[0, row, own].mean()), float(missed[1, row, own].mean()))
            for row, (name, own) in enumerate(zip(self.subject.trials.moment_coordinates, known, strict=True))
            if own.any()
        }

    def to_dataset(self) -> Dataset:
        """Return lengths before and after, and passive moments, as an `xarray.Dataset` with units."""
        from wrapjax.report.labelled.arrays import initialisation_dataset

        return initialisation_dataset(self)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the result, as sentences."""
        notes = [] if self.subject.passive else [NO_PASSIVE_TRIALS]
        if self.at_bounds:
            notes.append(
                f"{len(self.at_bounds)} lengths ended at half or twice the model's, set by the bound rather "
                f"than by data: {', '.join(self.at_bounds)}."
            )
        return tuple(notes)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``initialisation.json``."""
        lengths = ("optimal_fiber_length", "tendon_slack_length")
        return {
            "schema": 1,
            "subject": self.subject.name,
            "converged": self.status.converged,
            "message": self.status.value,
            "passive_trials": [trial.name for trial in self.subject.passive],
            "passive_mae_Nm": {
                name: {"before": before, "after": after} for name, (before, after) in self.passive_mae.items()
            },
            "muscles": {
                muscle: {
                    **{
                        f"{name}_m": {
                            "before": float(getattr(self.before, name)[row]),
                            "after": float(getattr(self.after, name)[row]),
                        }
                        for name in lengths
                    },
                    "normalized_fiber_length": {
                        "before": self.ranges[0, row].tolist(),
                        "after": self.ranges[1, row].tolist(),
                    },
                }
                for row, muscle in enumerate(self.after.names)
            },
            "at_bounds": list(self.at_bounds),
            "cost_by_term": self.cost_by_term,
            "notes": list(self.notes),
        }

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``muscle_parameters.csv``, ``initialisation.json`` and ``report.html``.

        Parameters
        ----------
        folder
            Folder to create. ``subject.toml`` can refer to the table in it as ``[model] muscle_parameters``.
        force
            Replace an existing folder.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is not set, or it cannot be created.
        """
        from wrapjax.report.calibration.initialisation_page import render_initialisation

        content = self.summary()
        with new_folder(Path(folder), force=force) as place:
            write_text(place / PARAMETERS_FILE, _table(self.after))
            write_json(place / "initialisation.json", content)
            write_text(place / "report.html", render_initialisation(content, _passive_curves(self)))


def initialise(
    subject: Subject, *, curves: str = "paper", errors: LengthErrors | None = None
) -> Initialisation:
    """Determine fiber and slack lengths from passive joint moments and operating ranges in walking.

    All muscles that act on the matched coordinates are included, with or without an EMG channel, because all
    contribute to passive moments. Paths are those of the exact engine. Maximum isometric forces and pennation
    angles are unchanged. The walking cycles, and movements, are those of the trials marked ``calibration``
    except passive ones. The terms are described in `wrapjax.calibration.initial_lengths`.

    Parameters
    ----------
    subject
        Subject from `load_subject`. Without passive trials the lengths depend on operating ranges
        alone.
    curves
        Hill curves: ``paper`` or ``opensim``.
    errors
        Allowable error of each term; the defaults are those of the NMSM Pipeline.

    Returns
    -------
    Initialisation
        Lengths (m) before and after, operating ranges and passive moments (N m).

    Raises
    ------
    InputError
        If a muscle's path has an element that the exact engine does not support.

    Examples
    --------
    >>> initialised = initialise(load_subject("subject"))  # doctest: +SKIP
    >>> initialised.passive_mae["knee_angle_l"]  # doctest: +SKIP
    >>> initialised.save("initialisation")  # doctest: +SKIP
    """
    require_float64()
    before = subject.muscles
    if subject.undriven_parameters is not None and subject.undriven_muscles:
        acting, _ = acting_muscles(subject)
        before = before.extended_by(subject.undriven_parameters.select(acting))
    problem = _problem(subject, before, curves, errors or LengthErrors())
    solution = ProjectedLevenbergMarquardt(ftol=1e-10).solve(problem, problem.start())
    variables = jnp.asarray(solution.variables)
    found = problem.lengths(variables)
    after = replace(
        before,
        optimal_fiber_length=np.asarray(found.optimal_fiber_length),
        tendon_slack_length=np.asarray(found.tendon_slack_length),
    )
    ends = [problem.parameters, found]
    walking = [np.asarray(problem.normalized_lengths(one)) for one in ends]
    ratios = solution.variables[: 2 * problem.muscles].reshape(2, -1)
    on_bound = (ratios <= problem.lower[0]) | (ratios >= problem.upper[0])
    return Initialisation(
        subject=subject,
        before=before,
        after=after,
        at_bounds=tuple(
            f"{before.names[row]}.{('optimal_fiber_length', 'tendon_slack_length')[kind]}"
            for kind, row in np.argwhere(on_bound)
        ),
        ranges=np.array([[one.min(axis=1), one.max(axis=1)] for one in walking]).transpose(0, 2, 1),
        passive=np.array(
            [np.where(problem.recorded, problem.moment, np.nan), *map(problem.passive_moments, ends)]
        ),
        cost_by_term={name: float(jnp.sum(rows**2)) for name, rows in problem.terms(variables).items()},
        status=solution.status,
    )


def _problem(
    subject: Subject, muscles: MuscleParameters, curves: str, errors: LengthErrors
) -> InitialLengthObjective:
    model, trials = describe_model(subject.model_file), subject.trials.used_for("calibration")
    active = np.array([task != "passive" for task in trials.tasks])
    trials = trials.select(active) if active.any() else trials
    spanned = {name for muscle in muscles.names for name in model.spanned_by(muscle)}
    engine = ExactPaths(model, muscles.names, tuple(name for name in trials.coordinates if name in spanned))
    wanted = trials.moment_coordinates
    walking = compute_nominal_paths(engine, *recorded_motion(trials, engine.coordinates), wanted).length
    count = len(muscles.names)
    length, arm = jnp.zeros((count, 0)), jnp.zeros((count, len(wanted), 0))
    moment = np.zeros((len(wanted), 0))
    if subject.passive:
        file = read_model_file(subject.model_file)
        moment = np.concatenate([_moments(trial, wanted) for trial in subject.passive], axis=1)
        defaults = {info.name: info.default_value for info in file.coordinates}
        poses = np.concatenate([_poses(trial, engine, defaults) for trial in subject.passive], axis=1)[None]
        path = compute_nominal_paths(engine, poses, np.zeros_like(poses), wanted)
        length, arm = path.length[:, 0], path.moment_arm[:, 0]
    groups = fiber_length_groups(read_model_file(subject.model_file).groups, muscles.names, subject.side)
    grouped = tuple(tuple(muscles.names.index(name) for name in group) for group in groups)
    alone = tuple((row,) for row in range(count) if not any(row in group for group in grouped))
    return InitialLengthObjective(
        curves=hill_curves(curves),
        parameters=initial_parameters(
            muscles.max_isometric_force,
            muscles.optimal_fiber_length,
            muscles.tendon_slack_length,
            muscles.pennation_angle,
        ),
        walking=walking.reshape(count, -1),
        length=length,
        moment_arm=arm,
        moment=jnp.asarray(np.nan_to_num(moment)),
        recorded=np.isfinite(moment),
        groups=(*grouped, *alone),
        errors=errors,
    )


def _poses(
    trial: PassiveTrial, engine: ExactPaths, defaults: dict[str, float]
) -> Float[np.ndarray, "coordinate sample"]:
    samples = trial.angles.shape[1]
    given = dict(zip(trial.coordinates, trial.angles, strict=True))
    return np.array(
        [given[name] if name in given else np.full(samples, defaults[name]) for name in engine.coordinates]
    )


def _moments(trial: PassiveTrial, wanted: tuple[str, ...]) -> Float[np.ndarray, "coordinate sample"]:
    """Return the moments about the wanted coordinates, N m; NaN where none was recorded."""
    given = dict(zip(trial.moment_coordinates, trial.moments, strict=True))
    missing = np.full(trial.moments.shape[1], np.nan)
    return np.array([given.get(name, missing) for name in wanted])


def _passive_curves(done: Initialisation) -> list[PassiveCurves]:
    """Split the passive moments by trial and coordinate."""
    from wrapjax.report.calibration.initialisation_page import PassiveCurves

    found, first = [], 0
    for trial in done.subject.passive:
        own = slice(first, first := first + trial.moments.shape[1])
        for row, name in enumerate(done.subject.trials.moment_coordinates):
            measured, before, after = done.passive[:, row, own]
            angle = dict(zip(trial.coordinates, trial.angles, strict=True)).get(name)
            if name in trial.moment_coordinates:
                place = None if angle is None or np.ptp(angle) == 0.0 else np.rad2deg(angle)
                found.append(PassiveCurves(trial.name, name, place, measured, before, after))
    return found


def _table(muscles: MuscleParameters) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("muscle", *CSV_COLUMNS))
    columns = list(vars(muscles).values())
    for muscle, *values in zip(*columns, strict=True):
        writer.writerow((muscle, *(float(value) for value in values)))
    return text.getvalue()
