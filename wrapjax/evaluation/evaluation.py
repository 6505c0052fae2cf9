"""``evaluate``: a calibrated model on other cycles."""

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
from wrapjax.geometry.paths import AbstractPath
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.geometry.wrapped_paths import wrapped_paths
from wrapjax.geometry.wrapping import NOMINAL
from wrapjax.io.files import content_hash, new_folder
from wrapjax.jax_setup import require_float64
from wrapjax.model.alteration import tendon_alterations
from wrapjax.model.forward import muscle_states
from wrapjax.model.parameters import ModelParameters
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.path_sources.exact import WRAPPINGS, build_engine, recorded_motion
from wrapjax.path_sources.model_inputs import recording, surrogate_paths
from wrapjax.path_sources.undriven_muscles import drive_by_synergies
from wrapjax.subject.subject import Subject, load_subject
from wrapjax.subject.trials import Trials

if TYPE_CHECKING:
    from xarray import Dataset

#: Angles so far beyond those that polynomials were fitted on, in half ranges, are told of.
_BEYOND = 0.1


@dataclass(frozen=True)
class Evaluation:
    """What a calibrated model predicts on a subject's cycles.

    Parameters
    ----------
    run, subject
        The model, and whose cycles.
    modelled
        Joint moments in N m.
    notes
        What is to be known of the comparison, in sentences.
    """

    run: Run
    subject: Subject
    modelled: Float[np.ndarray, "trial coordinate frame"]
    notes: tuple[str, ...]

    @property
    def trials(self) -> Trials:
        """The cycles."""
        return self.subject.trials

    @property
    def dataset(self) -> Dataset:
        """Moments measured and predicted, and their errors, as an `xarray.Dataset` with units."""
        attributes = {
            "subject": self.subject.name,
            "run_subject": self.run.subject,
            "method": self.run.method,
            "curves": self.run.curves,
            "tendon": self.run.tendon,
            "notes": "\n".join(self.notes),
        }
        from wrapjax.report.labelled_arrays import evaluation_dataset

        return evaluation_dataset(self.trials, self.modelled, attributes)

    def content(self) -> dict[str, Any]:
        """Describe it in plain values: what ``evaluation.json`` holds, errors as in ``summary.json``."""
        from wrapjax.report.evaluation_page import describe_evaluation

        return describe_evaluation(self.run.summary, self.subject, self.modelled, self.notes)

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write ``evaluation.json``, ``moments/`` and ``report.html`` into a new folder."""
        from wrapjax.report.evaluation_page import write_evaluation

        with new_folder(Path(folder), force=force) as place:
            write_evaluation(self.content(), self.trials, self.modelled, place)


def evaluate(run: Run | str | Path, subject: Subject | str | Path) -> Evaluation:
    """Predict a subject's joint moments by a finished calibration; nothing is fitted.

    Parameters
    ----------
    run
        From `load_run`, or its folder. Its parameters and its paths are taken as they are: polynomials, which
        know nothing of the subject's model file, or the cylinders of that file, moved as the run moved its
        own.
    subject
        From `load_subject`, or its folder: the same person on other days as a rule. EMG has to be normalised
        as it was for the run; ``raw`` EMG is by the largest of each channel in this folder.

    Raises
    ------
    InputError
        If the subject has other muscles or coordinates than the run.
    """
    require_float64()
    run = as_run(run)
    subject = _driven_alike(run, subject if isinstance(subject, Subject) else load_subject(subject))
    _refuse_others(run, subject)
    trials, notes = subject.trials, []
    if run.model_hash != content_hash(subject.model_file):
        paths_of = "this subject's model" if run.paths is None else "the run"
        notes.append(
            f"The model file is not the one that the run was calibrated with; muscle paths are those of "
            f"{paths_of}."
        )
    if run.paths is None:
        paths, parameters = _exact(run, subject)
    else:
        notes += _beyond(run.paths, trials)
        paths = surrogate_paths(run.paths, subject, trials)
        parameters = run.parameters(subject.muscles.names, paths.modes_count)
    states = eqx.filter_jit(muscle_states)(
        HILL_CURVES[run.curves],
        parameters,
        recording(subject, trials, paths),
        tendon_alterations(run.tendon, len(subject.muscles.names)),
    )
    return Evaluation(run, subject, np.asarray(states.moment.sum(axis=0)), tuple(notes))


def _driven_alike(run: Run, subject: Subject) -> Subject:
    """Drive the muscles that have no channel by the run's synergies, whose weights are of its commands."""
    if run.synergies is None:
        return subject
    problems = [
        Problem(
            str(subject.folder),
            f"lacks EMG channel '{name}', which synergies of run {run.folder} are of",
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


def _exact(run: Run, subject: Subject) -> tuple[AbstractPath, ModelParameters]:
    """Lay exact paths round the cylinders where the run put them."""
    engine = build_engine(subject)
    unknown = set(run.wraps) - {wrap for name in engine.muscles for wrap in engine.wraps_of(name)}
    if unknown:
        name = sorted(unknown)[0]
        message = f"has no cylinder '{name}' that its driven muscles wrap round, which the run moved"
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
    changes = np.zeros((len(engine.muscles), paths.modes_count // len(NOMINAL), len(NOMINAL)))
    for row, muscle in enumerate(engine.muscles):
        for place, wrap in enumerate(engine.wraps_of(muscle)):
            if wrap in run.wraps:
                changes[row, place] = run.wraps[wrap] - NOMINAL
    flat = jnp.asarray(changes.reshape(len(engine.muscles), -1))
    parameters = run.parameters(engine.muscles, paths.modes_count)
    return paths, eqx.tree_at(lambda tree: tree.path_changes, parameters, flat)


def _refuse_others(run: Run, subject: Subject) -> None:
    """Raise an error if the subject has other muscles or coordinates than the run."""
    problems = []
    for kind, own, theirs in (
        ("muscle", subject.muscles.names, run.muscles),
        ("coordinate", subject.trials.moment_coordinates, run.coordinates),
    ):
        for name in (one for one in theirs if one not in own):
            message = f"lacks {kind} '{name}', which run {run.folder} was calibrated with"
            problems.append(Problem(str(subject.folder), message, hint=nearest_name(name, own)))
        for name in (one for one in own if one not in theirs):
            message = f"has {kind} '{name}', of which run {run.folder} knows nothing"
            problems.append(Problem(str(subject.folder), message, hint=nearest_name(name, theirs)))
    missing = () if run.paths is None else set(run.paths.coordinates) - set(subject.trials.coordinates)
    for name in sorted(missing):
        message = f"has no angles of '{name}', which the muscle paths of run {run.folder} depend on"
        problems.append(
            Problem(str(subject.folder), message, hint=nearest_name(name, subject.trials.coordinates))
        )
    if problems:
        raise InputError(problems)


def _beyond(paths: PathSurrogate, trials: Trials) -> list[str]:
    """Say about which coordinates the cycles leave the range that the polynomials were fitted on."""
    columns = [trials.coordinates.index(name) for name in paths.coordinates]
    center, half = np.asarray(paths.center)[:, None], np.asarray(paths.half_range)[:, None]
    outside = np.abs(trials.angles[:, columns] - center) > (1.0 + _BEYOND) * half
    return [
        f"In {100.0 * share:.0f} % of all frames {name} is beyond what the run's paths were fitted on, where "
        "polynomials cannot be trusted."
        for name, share in zip(paths.coordinates, outside.mean(axis=(0, 2)).tolist(), strict=True)
        if share > 0.0
    ]
