"""A finished calibration as its folder tells it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.subject import Storage, Subject, read_storage, read_subject

#: Times of frames may differ by so much (s).
_SAME_TIME = 1e-6


@dataclass(frozen=True)
class FinishedRun:
    """What `wrapjax calibrate` wrote of one leg.

    Parameters
    ----------
    folder
        The run's.
    method, curves, converged
        How it was made, and whether it ended well.
    subject
        Read again from its folder.
    muscles, force
        Driven ones, and their forces along the tendon, N.
    measured, modelled
        Joint moments, N m.
    """

    folder: Path
    method: str
    curves: str
    converged: bool
    subject: Subject
    muscles: tuple[str, ...]
    force: Float[np.ndarray, "muscle trial frame"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]


def read_run(folder: Path | str, subject: Subject | Path | str | None = None) -> FinishedRun:
    """Read a run's folder and the subject that it was made from.

    Parameters
    ----------
    folder
        As ``wrapjax calibrate`` wrote it.
    subject
        The subject, or its folder, where that is no longer where it was.

    Raises
    ------
    InputError
        If it is no run's folder, lacks a file, its subject is not found, or that has other cycles.
    """
    folder = Path(folder)
    if not folder.is_dir():
        found = "is a file" if folder.exists() else "does not exist"
        raise InputError(
            Problem(
                str(folder),
                f"{found}, where a run's folder was expected",
                hint="'wrapjax calibrate' writes it",
            )
        )
    settings, summary = (_read_json(folder / name) for name in ("settings.json", "summary.json"))
    try:
        remembered = folder / settings["subject"]["folder"]
        stems = {trial: entry["file"] for trial, entry in summary["trials"].items()}
        method, curves, converged = settings["method"], settings["curves"], bool(summary["converged"])
        muscles, coordinates = tuple(settings["muscles"]), tuple(settings["coordinates"])
    except (KeyError, TypeError) as error:
        message = f"expected what 'wrapjax calibrate' writes, and {error} is not there"
        raise InputError(Problem(str(folder / "settings.json"), message)) from error
    own = (
        subject if isinstance(subject, Subject) else _subject(folder, subject or remembered, subject is None)
    )
    _check_same(folder, own, tuple(stems), coordinates)
    force, measured, modelled = [], [], []
    for number, stem in enumerate(stems.values()):
        forces = _columns(folder / "muscle_forces" / f"{stem}.sto", muscles, own, number)
        labels = [f"{name}_moment" for name in coordinates]
        file = folder / "moments" / f"{stem}.sto"
        moments = _columns(file, (*labels, *(f"{label}_measured" for label in labels)), own, number)
        force.append(forces)
        modelled.append(moments[: len(labels)])
        measured.append(moments[len(labels) :])
    return FinishedRun(
        folder=folder,
        method=method,
        curves=curves,
        converged=converged,
        subject=own,
        muscles=muscles,
        force=np.stack(force, axis=1),
        measured=np.stack(measured),
        modelled=np.stack(modelled),
    )


def _read_json(file: Path) -> dict[str, Any]:
    if not file.is_file():
        message = "is not there; a folder that 'wrapjax calibrate' wrote was expected"
        raise InputError(Problem(str(file), message))
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(Problem(str(file), f"is not JSON ({error})")) from error
    if not isinstance(content, dict):
        raise InputError(Problem(str(file), f"expected a JSON object, found a {type(content).__name__}"))
    return content


def _subject(folder: Path, place: Path | str, remembered: bool) -> Subject:
    if remembered and not Path(place).is_dir():
        message = f"was made from the subject folder {place}, which is not there"
        raise InputError(Problem(str(folder), message, hint="name it with --subject"))
    return read_subject(place)


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
