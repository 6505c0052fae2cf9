"""``load_run``: a finished calibration, read back from its folder."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.surrogate import PathSurrogate, surrogate_from_arrays
from wrapjax.geometry.wrapping import WRAP_PARAMETERS
from wrapjax.io.json_and_arrays import load_arrays, load_json
from wrapjax.io.storage import Storage, read_storage
from wrapjax.model.freedom import synergy_labels
from wrapjax.model.parameters import QUANTITIES, ModelParameters
from wrapjax.subject.subject import Subject, load_subject
from wrapjax.subject.synergies import Synergies, SynergyBasis

_ANEW = "calibrate again with 'wrapjax calibrate'"
#: Largest difference between the times of a stored curve and of the subject's frames, s.
_TIME_TOLERANCE = 1e-6
_FILES = ("summary.json", "settings.json", "parameters.csv")


@dataclass(frozen=True)
class Run:
    """What a calibration found, as its folder says.

    Parameters
    ----------
    folder
        Where it was read from.
    subject, method, curves, tendon
        Whom it was calibrated to, what was adjusted, the Hill curves and the kind of tendon.
    subject_folder
        Where the subject was, from the run's folder.
    converged
        Whether it ended well.
    muscles, coordinates
        Names, in the run's order.
    values
        Of every muscle, by quantity (`QUANTITIES`), SI units.
    wraps
        The six parameters (`WRAP_PARAMETERS`) of each cylinder that was moved.
    paths
        Calibrated paths as polynomials; None where they are exact.
    geometry
        Where paths came from: ``opensim``, ``engine`` or ``engine-parity``.
    model_hash
        Of the model's file; None where that is not known.
    summary
        The content of ``summary.json``.
    synergies
        What drove muscles without an electrode; None where nothing did.
    weights
        By excitation, its weights of the synergies' commands.
    """

    folder: Path
    subject: str
    method: str
    curves: str
    tendon: str
    subject_folder: Path
    converged: bool
    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    values: dict[str, Float[np.ndarray, " muscle"]]
    wraps: dict[str, Float[np.ndarray, " wrap_parameter"]]
    paths: PathSurrogate | None
    geometry: str
    model_hash: str | None
    summary: dict[str, Any]
    synergies: Synergies | None = None
    weights: dict[str, Float[np.ndarray, " command"]] = field(default_factory=dict)

    def parameters(self, muscles: tuple[str, ...], path_modes: int = 0) -> ModelParameters:
        """Arrange the parameters as the model takes them.

        Parameters
        ----------
        muscles
            The run's, in the order wanted.
        path_modes
            Width of ``path_changes``, which are zero.
        """
        rows = np.array([self.muscles.index(name) for name in muscles])
        leaves = {name: jnp.asarray(values[rows]) for name, values in self.values.items()}
        return ModelParameters(
            **leaves,
            path_changes=jnp.zeros((len(muscles), path_modes)),
            synergy_weights=self._synergy_weights(muscles),
        )

    def _synergy_weights(self, muscles: tuple[str, ...]) -> Float[Array, "muscle command"] | None:
        if self.synergies is None:
            return None
        weights = np.zeros((len(muscles), self.synergies.basis.count))
        for name, members in self.synergies.groups.items():
            weights[[muscles.index(muscle) for muscle in members]] = self.weights[name]
        return jnp.asarray(weights)


def as_run(run: Run | str | Path) -> Run:
    """Take a run as it is, or read it from its folder: see `load_run`."""
    return run if isinstance(run, Run) else load_run(run)


def load_run(folder: str | Path) -> Run:
    """Read what `Calibration.save` (``wrapjax calibrate``) wrote.

    Raises
    ------
    InputError
        If it is no such folder, or a file in it is damaged or cut off.
    """
    folder = Path(folder)
    if not folder.is_dir():
        found = "is a file, where a RUN folder was expected" if folder.exists() else "does not exist"
        raise InputError(Problem(str(folder), found, hint="a RUN is what 'wrapjax calibrate' writes"))
    missing = [name for name in _FILES if not (folder / name).is_file()]
    if missing:
        message = f"is no RUN folder: {missing[0]} is missing"
        raise InputError(Problem(str(folder), message, hint="a RUN is what 'wrapjax calibrate' writes"))
    summary, settings = (_read_json(folder / name) for name in _FILES[:2])
    try:
        muscles, source = tuple(settings["muscles"]), settings.get("paths")
        if source is None:
            message = "does not say where the run's paths came from: it is from an earlier version"
            raise InputError(Problem(str(folder / "settings.json"), message, hint=_ANEW))
        synergies = _synergies(settings.get("synergies"))
        values, wraps, weights = _read_parameters(folder / "parameters.csv", muscles, synergies)
        return Run(
            folder=folder,
            subject=str(summary["subject"]),
            method=str(summary["method"]),
            curves=str(settings["curves"]),
            tendon=str(settings.get("tendon", "rigid")),
            subject_folder=Path(settings["subject"]["folder"]),
            converged=bool(summary["converged"]),
            muscles=muscles,
            coordinates=tuple(settings["coordinates"]),
            values=values,
            wraps=wraps,
            paths=_read_paths(folder / "paths.npz", muscles) if source["source"] == "polynomials" else None,
            geometry=str(source["geometry"]),
            model_hash=settings["subject"].get("model_hash"),
            summary=summary,
            synergies=synergies,
            weights=weights,
        )
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(Problem(str(folder), f"is damaged (no {error})", hint=_ANEW)) from error


def _synergies(found: dict[str, Any] | None) -> Synergies | None:
    """Take what drove muscles without an electrode; runs of earlier versions say nothing of it."""
    if found is None:
        return None
    basis = SynergyBasis(
        channels=tuple(found["channels"]),
        largest=np.array(found["largest"], dtype=float),
        mean=np.array(found["mean"], dtype=float),
        components=np.array(found["components"], dtype=float),
        explained=np.array(found["explained"], dtype=float),
    )
    groups = {name: tuple(members) for name, members in found["groups"].items()}
    return Synergies(basis, groups)


def _read_json(file: Path) -> dict[str, Any]:
    try:
        content = load_json(file)
    except ValueError as error:
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=_ANEW)) from error
    if not isinstance(content, dict):
        raise InputError(Problem(str(file), "expected an object in JSON, found something else", hint=_ANEW))
    return content


def _read_parameters(
    file: Path, muscles: tuple[str, ...], synergies: Synergies | None
) -> tuple[
    dict[str, Float[np.ndarray, " muscle"]],
    dict[str, Float[np.ndarray, " wrap_parameter"]],
    dict[str, Float[np.ndarray, " command"]],
]:
    """Read values of muscles, cylinders and synergies; those of path terms are in ``paths.npz`` as well."""
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(Problem(str(file), "is not text in UTF-8", hint=_ANEW)) from None
    if not text.endswith("\n"):
        raise InputError(Problem(str(file), "seems cut off: its last line has no end", hint=_ANEW))
    found: dict[tuple[str, str, str], float] = {}
    for number, row in enumerate(csv.DictReader(io.StringIO(text)), start=2):
        try:
            key = (row["owner"], row["kind"], row["parameter"])
            value = float(row["value"])
        except (KeyError, TypeError, ValueError):
            message = "expected owner, kind, parameter and a value"
            raise InputError(Problem(str(file), message, f"line {number}", _ANEW)) from None
        if not math.isfinite(value):
            message = f"expected a finite number, found {value}"
            raise InputError(Problem(str(file), message, f"line {number}", _ANEW))
        found[key] = value

    def value_of(owner: str, kind: str, name: str) -> float:
        if (owner, kind, name) not in found:
            message = f"{name} of {owner} is missing: the file seems cut off or changed"
            raise InputError(Problem(str(file), message, hint=_ANEW))
        return found[owner, kind, name]

    values = {name: np.array([value_of(muscle, "muscle", name) for muscle in muscles]) for name in QUANTITIES}
    cylinders = dict.fromkeys(owner for owner, kind, _ in found if kind == "wrap")
    wraps = {
        owner: np.array([value_of(owner, "wrap", name) for name in WRAP_PARAMETERS]) for owner in cylinders
    }
    excitations = {} if synergies is None else synergies.groups
    count = 0 if synergies is None else synergies.basis.count
    weights = {
        owner: np.array([value_of(owner, "synergy", name) for name in synergy_labels(count)])
        for owner in excitations
    }
    return values, wraps, weights


def _read_paths(file: Path, muscles: tuple[str, ...]) -> PathSurrogate:
    if not file.is_file():
        raise InputError(Problem(str(file), "is missing: the run's muscle paths are in it", hint=_ANEW))
    try:
        return surrogate_from_arrays(load_arrays(file)).select_muscles(muscles)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=_ANEW)) from error


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
    if table.time.shape != time.shape or np.abs(table.time - time).max() > _TIME_TOLERANCE:
        message = (
            f"expected the frames of cycle '{subject.trials.names[trial]}', {time[0]:g} to {time[-1]:g} s, "
            f"found {table.time.size} from {table.time[0]:g} to {table.time[-1]:g} s"
        )
        raise InputError(Problem(str(file), message, hint="was the subject changed since?"))
    return table.values.T[[table.columns.index(name) for name in names]]
