"""Stored calibrations, read from the folders that ``wrapjax calibrate`` writes."""

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
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, PARAMETERS, PARAMETERS_OF
from wrapjax.geometry.surrogates.surrogate import PathSurrogate, surrogate_from_arrays
from wrapjax.io.json_and_arrays import load_arrays, load_json
from wrapjax.io.storage import Storage, read_storage
from wrapjax.model.freedom import synergy_labels
from wrapjax.model.parameters import QUANTITIES, ModelParameters, with_muscle_law
from wrapjax.muscle.curves import HILL_CURVES
from wrapjax.muscle.published_laws import GIVEN_LAW
from wrapjax.subject.subject import Subject, load_subject
from wrapjax.subject.synergies import Synergies, SynergyBasis

_RECALIBRATE = "calibrate again with 'wrapjax calibrate'"
#: Largest difference between times of stored curves and of the subject's frames, s.
_TIME_TOLERANCE = 1e-6
_FILES = ("summary.json", "settings.json", "parameters.csv")


@dataclass(frozen=True)
class Run:
    """Calibration read from its folder.

    Parameters
    ----------
    folder
        Folder of the run.
    subject
        Name of the calibrated subject.
    method
        Method of calibration.
    curves
        Hill curves.
    tendon
        Kind of tendon, ``rigid`` or ``compliant``.
    muscle_law
        Name of the muscle law; see `wrapjax.muscle.published_laws`.
    subject_folder
        Subject folder at the time of the calibration, relative to the run's folder.
    converged
        Whether the calibration converged.
    muscles, coordinates
        Names, in the order of the run.
    values
        Values of all muscles by quantity (`QUANTITIES`), SI units.
    wraps
        Parameters (`PARAMETERS`) of the surfaces that were changed, by wrap.
    paths
        Calibrated polynomial paths; None for exact paths.
    geometry
        Source of the muscle paths: ``opensim``, ``engine`` or ``engine-parity``.
    model_hash
        Hash of the model file; None if it is not stored.
    summary
        Content of ``summary.json``.
    synergies
        Synergies that drove muscles without an electrode; None if there were none.
    weights
        Weights of the synergies by excitation.
    """

    folder: Path
    subject: str
    method: str
    curves: str
    tendon: str
    muscle_law: str
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
        """Build the parameter tree of the model.

        Parameters
        ----------
        muscles
            Muscles of the run, in the order of the result.
        path_modes
            Number of path modes of each muscle; their amplitudes ``path_changes`` are zero.

        Returns
        -------
        ModelParameters
            Parameters of all muscles.
        """
        rows = np.array([self.muscles.index(name) for name in muscles])
        leaves = {name: jnp.asarray(values[rows]) for name, values in self.values.items()}
        parameters = ModelParameters(
            **leaves,
            path_changes=jnp.zeros((len(muscles), path_modes)),
            synergy_weights=self._synergy_weights(muscles),
        )
        return with_muscle_law(parameters, self.muscle_law, self.curves)

    def _synergy_weights(self, muscles: tuple[str, ...]) -> Float[Array, "muscle command"] | None:
        if self.synergies is None:
            return None
        weights = np.zeros((len(muscles), self.synergies.basis.count))
        for name, members in self.synergies.groups.items():
            weights[[muscles.index(muscle) for muscle in members]] = self.weights[name]
        return jnp.asarray(weights)


def as_run(run: Run | str | Path) -> Run:
    """Return a run as it is, or read it from its folder with `load_run`."""
    return run if isinstance(run, Run) else load_run(run)


def load_run(folder: str | Path) -> Run:
    """Read a calibration from the folder that `Calibration.save` or ``wrapjax calibrate`` wrote.

    Parameters
    ----------
    folder
        Folder of the run.

    Returns
    -------
    Run
        Calibrated parameters, paths and settings.

    Raises
    ------
    InputError
        If it is not the folder of a run, or a file in it is damaged or truncated.
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
            raise InputError(Problem(str(folder / "settings.json"), message, hint=_RECALIBRATE))
        if settings["curves"] not in HILL_CURVES:
            message = f"the run uses muscle curves '{settings['curves']}', which are not defined here"
            hint = "add them to wrapjax.muscle.curves.HILL_CURVES in Python, and go on there"
            raise InputError(Problem(str(folder / "settings.json"), message, hint=hint))
        synergies = _read_synergies(settings.get("synergies"))
        values, wraps, weights = _read_parameters(folder / "parameters.csv", muscles, synergies)
        return Run(
            folder=folder,
            subject=str(summary["subject"]),
            method=str(summary["method"]),
            curves=str(settings["curves"]),
            tendon=str(settings.get("tendon", "rigid")),
            muscle_law=str(settings.get("muscle_law", GIVEN_LAW)),
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
        raise InputError(Problem(str(folder), f"is damaged (no {error})", hint=_RECALIBRATE)) from error


def _read_synergies(stored: dict[str, Any] | None) -> Synergies | None:
    """Read the synergies of a run; runs of earlier versions have no entry."""
    if stored is None:
        return None
    basis = SynergyBasis(
        channels=tuple(stored["channels"]),
        largest=np.array(stored["largest"], dtype=float),
        mean=np.array(stored["mean"], dtype=float),
        components=np.array(stored["components"], dtype=float),
        explained=np.array(stored["explained"], dtype=float),
    )
    groups = {name: tuple(members) for name, members in stored["groups"].items()}
    return Synergies(basis, groups)


def _read_json(file: Path) -> dict[str, Any]:
    try:
        content = load_json(file)
    except ValueError as error:
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=_RECALIBRATE)) from error
    if not isinstance(content, dict):
        raise InputError(
            Problem(str(file), "expected an object in JSON, found something else", hint=_RECALIBRATE)
        )
    return content


def _read_parameters(
    file: Path, muscles: tuple[str, ...], synergies: Synergies | None
) -> tuple[
    dict[str, Float[np.ndarray, " muscle"]],
    dict[str, Float[np.ndarray, " wrap_parameter"]],
    dict[str, Float[np.ndarray, " command"]],
]:
    """Read the values of muscles, wraps and synergies; path coefficients are also in ``paths.npz``."""
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(Problem(str(file), "is not text in UTF-8", hint=_RECALIBRATE)) from None
    if not text.endswith("\n"):
        raise InputError(Problem(str(file), "seems cut off: its last line has no end", hint=_RECALIBRATE))
    stored: dict[tuple[str, str, str], float] = {}
    for number, row in enumerate(csv.DictReader(io.StringIO(text)), start=2):
        try:
            key = (row["owner"], row["kind"], row["parameter"])
            value = float(row["value"])
        except (KeyError, TypeError, ValueError):
            message = "expected owner, kind, parameter and a value"
            raise InputError(Problem(str(file), message, f"line {number}", _RECALIBRATE)) from None
        if not math.isfinite(value):
            message = f"expected a finite number, found {value}"
            raise InputError(Problem(str(file), message, f"line {number}", _RECALIBRATE))
        stored[key] = value

    def value_of(owner: str, kind: str, name: str) -> float:
        if (owner, kind, name) not in stored:
            message = f"{name} of {owner} is missing: the file seems cut off or changed"
            raise InputError(Problem(str(file), message, hint=_RECALIBRATE))
        return stored[owner, kind, name]

    values = {name: np.array([value_of(muscle, "muscle", name) for muscle in muscles]) for name in QUANTITIES}
    wraps = {}
    for wrap in dict.fromkeys(owner for owner, kind, _ in stored if kind == "wrap"):
        own = {name for owner, kind, name in stored if (owner, kind) == (wrap, "wrap")}
        # The fewest parameters that a kind of surface has and that include these.
        expected = min(
            (set(names) for names in PARAMETERS_OF.values() if own <= set(names)), key=len, default=own
        )
        wraps[wrap] = np.array(
            [
                value_of(wrap, "wrap", name) if name in expected else nominal
                for name, nominal in zip(PARAMETERS, NOMINAL_PARAMETERS, strict=True)
            ]
        )
    excitations = {} if synergies is None else synergies.groups
    count = 0 if synergies is None else synergies.basis.count
    weights = {
        owner: np.array([value_of(owner, "synergy", name) for name in synergy_labels(count)])
        for owner in excitations
    }
    return values, wraps, weights


def _read_paths(file: Path, muscles: tuple[str, ...]) -> PathSurrogate:
    if not file.is_file():
        raise InputError(
            Problem(str(file), "is missing: the run's muscle paths are in it", hint=_RECALIBRATE)
        )
    try:
        return surrogate_from_arrays(load_arrays(file)).select_muscles(muscles)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise InputError(Problem(str(file), f"is damaged ({error})", hint=_RECALIBRATE)) from error


@dataclass(frozen=True)
class RunCurves:
    """Muscle forces and joint moments stored in a run's folder, with the subject.

    Parameters
    ----------
    run
        Calibration.
    subject
        Subject of the calibration, read from its folder.
    force
        Tendon forces of the driven muscles, N.
    measured, modelled
        Joint moments, N m.
    """

    run: Run
    subject: Subject
    force: Float[np.ndarray, "muscle trial frame"]
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]


def read_curves(run: Run | Path | str, subject: Subject | Path | str | None = None) -> RunCurves:
    """Read the stored curves of a run, and its subject.

    Parameters
    ----------
    run
        Run from `load_run`, or its folder.
    subject
        Subject or subject folder, if it has been moved since the calibration.

    Returns
    -------
    RunCurves
        Forces and moments of all trials.

    Raises
    ------
    InputError
        If the folder is not that of a run or lacks a file, or the subject is not found, has other cycles, or
        has trials of other tasks than gait.
    """
    run = as_run(run)
    folder, muscles = run.folder, run.muscles
    if not isinstance(subject, Subject):
        subject = _load_subject_of(folder, subject or folder / run.subject_folder, stored=subject is None)
    if not subject.trials.is_gait_only:
        message = "has trials of other tasks than gait, of which no curves over whole cycles are stored"
        raise InputError(Problem(str(folder), message, hint="calibrate the gait trials alone"))
    stems = {trial: entry["file"] for trial, entry in run.summary["trials"].items()}
    _check_same_cycles(folder, subject, tuple(stems), run.coordinates)
    labels = [f"{name}_moment" for name in run.coordinates]
    force, measured, modelled = [], [], []
    for number, stem in enumerate(stems.values()):
        force.append(_columns(folder / "muscle_forces" / f"{stem}.sto", muscles, subject, number))
        file = folder / "moments" / f"{stem}.sto"
        moments = _columns(file, (*labels, *(f"{label}_measured" for label in labels)), subject, number)
        modelled.append(moments[: len(labels)])
        measured.append(moments[len(labels) :])
    return RunCurves(run, subject, np.stack(force, axis=1), np.stack(measured), np.stack(modelled))


def _load_subject_of(folder: Path, place: Path | str, *, stored: bool) -> Subject:
    """Load the subject of a run; ``stored`` if its folder is the one stored in the run."""
    if stored and not Path(place).is_dir():
        message = f"was made from the subject folder {place}, which is not there"
        raise InputError(Problem(str(folder), message, hint="name it with --subject"))
    return load_subject(place)


def _check_same_cycles(
    folder: Path, subject: Subject, trials: tuple[str, ...], coordinates: tuple[str, ...]
) -> None:
    """Raise an error if the subject has other cycles or coordinates than the run."""
    pairs = (
        ("cycles", trials, subject.trials.names),
        ("coordinates", coordinates, subject.trials.moment_coordinates),
    )
    problems = [
        Problem(
            str(folder),
            f"expected the subject {subject.folder} to have the {what} {', '.join(expected)}, found "
            f"{', '.join(found)}",
        )
        for what, expected, found in pairs
        if expected != found
    ]
    if problems:
        raise InputError(problems)


def _columns(
    file: Path, names: tuple[str, ...], subject: Subject, trial: int
) -> Float[np.ndarray, "column frame"]:
    """Read columns of the stored curves of a cycle, and check that they have its frames."""
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
