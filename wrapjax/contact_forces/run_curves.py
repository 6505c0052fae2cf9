"""What muscles did in a finished calibration, over the cycles that it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.stored_run import Run, as_run
from wrapjax.io.storage import Storage, read_storage
from wrapjax.subject.subject import Subject, load_subject

#: Times of frames may differ by so much (s).
_SAME_TIME = 1e-6


@dataclass(frozen=True)
class RunCurves:
    """Forces and moments that a run's folder holds, beside the subject that they are of.

    Parameters
    ----------
    run
        From `load_run`.
    subject
        Read again from its folder.
    force
        Of driven muscles along the tendon, N.
    measured, modelled
        Joint moments, N m.
    """

    run: Run
    subject: Subject
    force: Float[np.ndarray, "muscle trial frame"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]


def read_curves(run: Run | Path | str, subject: Subject | Path | str | None = None) -> RunCurves:
    """Read a run's folder and the subject that it was made from.

    Parameters
    ----------
    run
        From `load_run`, or its folder.
    subject
        The subject, or its folder, where that is no longer where it was.

    Raises
    ------
    InputError
        If it is no run's folder, lacks a file, its subject is not found, or that has other cycles.
    """
    run = as_run(run)
    folder, muscles = run.folder, run.muscles
    remembered = folder / run.subject_folder
    own = (
        subject if isinstance(subject, Subject) else _subject(folder, subject or remembered, subject is None)
    )
    stems = {trial: entry["file"] for trial, entry in run.summary["trials"].items()}
    _check_same(folder, own, tuple(stems), run.coordinates)
    labels = [f"{name}_moment" for name in run.coordinates]
    force, measured, modelled = [], [], []
    for number, stem in enumerate(stems.values()):
        force.append(_columns(folder / "muscle_forces" / f"{stem}.sto", muscles, own, number))
        file = folder / "moments" / f"{stem}.sto"
        moments = _columns(file, (*labels, *(f"{label}_measured" for label in labels)), own, number)
        modelled.append(moments[: len(labels)])
        measured.append(moments[len(labels) :])
    return RunCurves(run, own, np.stack(force, axis=1), np.stack(measured), np.stack(modelled))


def _subject(folder: Path, place: Path | str, remembered: bool) -> Subject:
    if remembered and not Path(place).is_dir():
        message = f"was made from the subject folder {place}, which is not there"
        raise InputError(Problem(str(folder), message, hint="name it with --subject"))
    return load_subject(place)


def _check_same(
    folder: Path, subject: Subject, trials: tuple[str, ...], coordinates: tuple[str, ...]
) -> None:
    """Refuse a subject that this run was not made from."""
    pairs = (
        ("cycles", trials, subject.trials.names),
        ("coordinates", coordinates, subject.trials.moment_coordinates),
    )
    problems = [
        Problem(
            str(folder),
            f"expected the subject {subject.folder} to have the {what} {', '.join(own)}, found "
            f"{', '.join(found)}",
        )
        for what, own, found in pairs
        if own != found
    ]
    if problems:
        raise InputError(problems)


def _columns(
    file: Path, names: tuple[str, ...], subject: Subject, trial: int
) -> Float[np.ndarray, "column frame"]:
    """Read columns of one cycle's curves, which have its frames."""
    table: Storage = read_storage(file)
    missing = [name for name in names if name not in table.columns]
    if missing:
        raise InputError(Problem(str(file), f"expected a column {missing[0]}, found none"))
    time = subject.trials.time[trial]
    if table.time.shape != time.shape or np.abs(table.time - time).max() > _SAME_TIME:
        message = (
            f"expected the frames of cycle '{subject.trials.names[trial]}', {time[0]:g} to {time[-1]:g} s, "
            f"found {table.time.size} from {table.time[0]:g} to {table.time[-1]:g} s"
        )
        raise InputError(Problem(str(file), message, hint="was the subject changed since?"))
    return table.values.T[[table.columns.index(name) for name in names]]
