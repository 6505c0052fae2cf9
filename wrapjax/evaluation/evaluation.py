"""Prediction of joint moments of other recordings with a calibrated model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.evaluation.stored_run import Run, as_run
from wrapjax.geometry.exact_paths.engine import nominal_parameters
from wrapjax.geometry.exact_paths.wrapped_paths import wrapped_paths
from wrapjax.geometry.paths import AbstractPath
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.io.files import content_hash, new_folder
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import tendon_alterations
from wrapjax.model.forward import muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import hill_curves
from wrapjax.path_sources.exact import WRAPPINGS, build_engine, recorded_motion
from wrapjax.path_sources.model_inputs import recording, surrogate_paths
from wrapjax.path_sources.undriven_muscles import drive_by_synergies
from wrapjax.subject.subject import Subject, load_subject
from wrapjax.subject.trials import Trials

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

#: Distance beyond the fitted range of a coordinate, in half ranges, from which a note is made.
_RANGE_TOLERANCE = 0.1


@dataclass(frozen=True)
class Evaluation:
    """Joint moments of a subject's cycles, predicted by a calibrated model.

    Parameters
    ----------
    run
        Calibration.
    subject
        Subject whose cycles are predicted.
    modelled
        Predicted joint moments, N m.
    notes
        Restrictions on the comparison with measured moments, as sentences.
    """

    run: Run
    subject: Subject
    modelled: Float[np.ndarray, "trial coordinate frame"]
    notes: tuple[str, ...]

    @property
    def trials(self) -> Trials:
        """Trials of the subject."""
        return self.subject.trials

    def to_dataset(self) -> Dataset:
        """Return measured and predicted moments and their errors, as an `xarray.Dataset` with units."""
        attributes = {
            "subject": self.subject.name,
            "run_subject": self.run.subject,
            "method": self.run.method,
            "curves": self.run.curves,
            "tendon": self.run.tendon,
            "muscle_law": self.run.muscle_law,
            "notes": "\n".join(self.notes),
        }
        from wrapjax.report.labelled.arrays import evaluation_dataset

        return evaluation_dataset(self.trials, self.modelled, attributes)

    def summary(self) -> dict[str, Any]:
        """Return the content of ``evaluation.json``; errors are structured as in ``summary.json``."""
        from wrapjax.report.calibration.evaluation_page import describe_evaluation

        return describe_evaluation(self.run.summary, self.subject, self.modelled, self.notes)

    def plot_moments(self) -> Figure:
        """Draw measured and predicted moments (N m) over the gait cycle."""
        from wrapjax.report.calibration.calibration_curves import moment_figure
        from wrapjax.report.calibration.evaluation_page import predicted_cycles

        return moment_figure(predicted_cycles(self.trials, self.modelled))

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``evaluation.json``, ``moments/`` and ``report.html`` into a new folder."""
        from wrapjax.report.calibration.evaluation_page import write_evaluation

        with new_folder(Path(folder), force=force) as place:
            write_evaluation(self.summary(), self.trials, self.modelled, place)


def evaluate(run: Run | str | Path, subject: Subject | str | Path) -> Evaluation:
    """Predict a subject's joint moments with a calibrated model, without fitting.

    Parameters
    ----------
    run
        Run from `load_run`, or its folder. Muscle parameters and paths are those of the run. Polynomial paths
        do not depend on the subject's model file; exact paths use its wrapping cylinders, changed as in the
        run.
    subject
        Subject from `load_subject`, or its folder; usually the same person on another day. EMG must be
        normalised as for the run; ``raw`` EMG is normalised by the maximum of each channel in this folder.

    Returns
    -------
    Evaluation
        Predicted moments of all trials.

    Raises
    ------
    InputError
        If a folder cannot be read, or the subject has other muscles, coordinates or EMG channels than the
        run.
    RuntimeError
        If JAX is not in 64-bit mode.
    """
    require_float64()
    run = as_run(run)
    subject = _drive_by_synergies(run, subject if isinstance(subject, Subject) else load_subject(subject))
    _check_same_model(run, subject)
    trials, notes = subject.trials, []
    if run.model_hash != content_hash(subject.model_file):
        paths_of = "this subject's model" if run.paths is None else "the run"
        notes.append(
            f"The model file is not the one that the run was calibrated with; muscle paths are those of "
            f"{paths_of}."
        )
    if run.paths is None:
        paths, parameters = _exact_paths(run, subject)
    else:
        notes += _range_notes(run.paths, trials)
        paths = surrogate_paths(run.paths, subject, trials)
        parameters = run.parameters(subject.muscles.names, paths.modes_count)
    states = eqx.filter_jit(muscle_states)(
        hill_curves(run.curves),
        parameters,
        recording(subject, trials, paths),
        tendon_alterations(run.tendon, len(subject.muscles.names)),
    )
    return Evaluation(run, subject, np.asarray(states.moment.sum(axis=0)), tuple(notes))


def _drive_by_synergies(run: Run, subject: Subject) -> Subject:
    """Drive muscles without a channel by the synergies of the run, to which its weights belong."""
    if run.synergies is None:
        return subject
    problems = [
        Problem(
            str(subject.folder),
            f"lacks EMG channel '{name}', which the synergies of run {run.folder} use",
            hint=nearest_name(name, subject.trials.channels),
        )
        for name in run.synergies.basis.channels
        if name not in subject.trials.channels
    ]
    for muscle in run.synergies.muscles:
        if muscle not in subject.undriven_muscles:
            found = "a channel that drives it" if muscle in subject.channel_of else "no such muscle"
            message = f"expected muscle '{muscle}' without a channel, as in run {run.folder}, found {found}"
            problems.append(Problem(str(subject.folder), message))
    if problems:
        raise InputError(problems)
    return drive_by_synergies(subject, run.synergies.basis, run.synergies.groups)


def _exact_paths(run: Run, subject: Subject) -> tuple[AbstractPath, ModelParameters]:
    """Compute exact paths round the subject's wrapping cylinders, changed as in the run."""
    engine = build_engine(subject)
    missing = set(run.wraps) - {wrap for name in engine.muscles for wrap in engine.wraps_of(name)}
    if missing:
        name = sorted(missing)[0]
        message = f"has no cylinder '{name}' that its driven muscles wrap round, which the run changed"
        raise InputError(Problem(str(subject.model_file), message))
    angles, velocities = recorded_motion(subject.trials, engine.coordinates)
    paths, _ = wrapped_paths(
        engine,
        angles,
        velocities,
        subject.trials.moment_coordinates,
        tuple(run.wraps),
        WRAPPINGS[run.geometry],
    )
    changes = np.zeros((len(engine.muscles), paths.wraps, paths.per_wrap))
    nominal = nominal_parameters(1, paths.per_wrap)[0]
    for row, muscle in enumerate(engine.muscles):
        for place, wrap in enumerate(engine.wraps_of(muscle)):
            if wrap in run.wraps:
                changes[row, place] = run.wraps[wrap][: paths.per_wrap] - nominal
    flat = jnp.asarray(changes.reshape(len(engine.muscles), -1))
    parameters = run.parameters(engine.muscles, paths.modes_count)
    return paths, eqx.tree_at(lambda tree: tree.path_changes, parameters, flat)


def _check_same_model(run: Run, subject: Subject) -> None:
    """Raise an error if the subject has other muscles or coordinates than the run."""
    problems = []
    for kind, subject_names, run_names in (
        ("muscle", subject.muscles.names, run.muscles),
        ("coordinate", subject.trials.moment_coordinates, run.coordinates),
    ):
        for name in (name for name in run_names if name not in subject_names):
            message = f"lacks {kind} '{name}', which run {run.folder} was calibrated with"
            problems.append(Problem(str(subject.folder), message, hint=nearest_name(name, subject_names)))
        for name in (name for name in subject_names if name not in run_names):
            message = f"has {kind} '{name}', which run {run.folder} does not have"
            problems.append(Problem(str(subject.folder), message, hint=nearest_name(name, run_names)))
    missing = () if run.paths is None else set(run.paths.coordinates) - set(subject.trials.coordinates)
    for name in sorted(missing):
        message = f"has no angles of '{name}', which the muscle paths of run {run.folder} depend on"
        problems.append(
            Problem(str(subject.folder), message, hint=nearest_name(name, subject.trials.coordinates))
        )
    if problems:
        raise InputError(problems)


def _range_notes(paths: PathSurrogate, trials: Trials) -> list[str]:
    """Note the coordinates whose recorded angles leave the range that the polynomials were fitted on."""
    columns = [trials.coordinates.index(name) for name in paths.coordinates]
    center, half = np.asarray(paths.center)[:, None], np.asarray(paths.half_range)[:, None]
    outside = np.abs(trials.angles[:, columns] - center) > (1.0 + _RANGE_TOLERANCE) * half
    return [
        f"In {100.0 * share:.2g} % of all frames {name} is outside the range that the run's paths were "
        "fitted on, where polynomials are unreliable."
        for name, share in zip(paths.coordinates, outside.mean(axis=(0, 2)).tolist(), strict=True)
        if share > 0.0
    ]
