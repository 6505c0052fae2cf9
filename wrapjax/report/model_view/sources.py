"""What the page shows of a model, a subject, a fit, a calibration or a diagnosis, read from its folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.evaluation.stored_run import Run, load_run, read_curves
from wrapjax.geometry.model_description import ModelDescription
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.io.files import content_hash
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.storage import read_storage
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.polynomial_fit import load_fit
from wrapjax.report.formatting import counted
from wrapjax.report.model_view.quantities import COORDINATE, MUSCLE, Quantity, Series, aligned, gap_errors
from wrapjax.report.model_view.scene import Motion, Placement
from wrapjax.report.overview import KINDS, kind_of
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.subject import Subject, load_subject

# Most frames shown, which keeps the page of a leg below 15 MB and its computation below a minute.
_MOST_FRAMES = 2020
_SWEEP_FRAMES = 51
_CYCLE = "% of the gait cycle"
_HINT = "name a model (.osim), a subject folder, or a folder of 'wrapjax fit', 'calibrate' or 'diagnose'"


@dataclass(frozen=True)
class Shown:
    """Content of the page before positions are computed.

    Parameters
    ----------
    title, under
        Title of the page and the line under it.
    model_file, model
        Model file, and its description.
    muscles, coordinates
        Names of the muscles, and of the coordinates of poses.
    motions
        Motions.
    cycles
        Place of each motion among the subject's gait cycles; none if they are not recorded.
    placements
        States of the wraps.
    polynomials
        Polynomial paths by their name in the legend.
    quantities
        Further quantities: forces, moments, errors.
    coloring
        Key of the quantity that colors the muscles at first; empty for none.
    notes
        Sentences below the page's title.
    """

    title: str
    under: str
    model_file: Path
    model: ModelDescription
    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    motions: tuple[Motion, ...]
    cycles: tuple[int, ...] = ()
    placements: tuple[Placement, ...] = (Placement("model"),)
    polynomials: dict[str, PathSurrogate] = field(default_factory=dict)
    quantities: tuple[Quantity, ...] = ()
    coloring: str = ""
    notes: tuple[str, ...] = ()


def read_shown(place: Path, subject: Subject | Path | None = None) -> Shown:
    """Read what the page shows.

    Parameters
    ----------
    place
        Model file, subject folder, or folder of a fit, a calibration or a diagnosis.
    subject
        Subject with the motion, or its folder. By default that of ``place``; a model file without a subject
        moves each joint through its range.

    Raises
    ------
    InputError
        If there is nothing to show there, or the subject is not found or does not fit.
    """
    if isinstance(subject, Path):
        subject = load_subject(subject)
    if place.is_file() and place.suffix == ".osim":
        return _swept_model(place) if subject is None else _recorded_model(place, subject)
    if place.name == SETTINGS_FILE or (place / SETTINGS_FILE).is_file():
        return _recorded_model(None, load_subject(place) if subject is None else subject)
    if not place.is_dir():
        found = "is no OpenSim model (.osim)" if place.exists() else "does not exist"
        raise InputError(Problem(str(place), found, hint=_HINT))
    readers: dict[str | None, Callable[[Path, Subject | None], Shown]] = {
        "fit": _fit,
        "calibration": _calibration,
        "diagnosis": _diagnosis,
    }
    kind = kind_of(place)
    if kind not in readers:
        found = "no result of wrapjax" if kind is None else f"a {kind}, which has no view in motion"
        raise InputError(Problem(str(place), f"holds {found}", hint=_HINT))
    return readers[kind](place, subject)


def _swept_model(file: Path) -> Shown:
    """Show a model without a recording: each joint moves through its range, the others stay."""
    model = describe_model(file)
    muscles = tuple(muscle.name for muscle in model.muscles)
    if not muscles:
        raise InputError(Problem(str(file), "has no muscles, of which the page shows the paths"))
    spanned = {name for muscle in muscles for name in model.spanned_by(muscle)}
    moving = [
        entry for entry in model.coordinates if entry.name in spanned and entry.motion != "translational"
    ]
    default = np.array([entry.default_value for entry in moving])
    motions = []
    for column, entry in enumerate(moving):
        low, high = np.clip(entry.range, -np.pi, np.pi)
        poses = np.tile(default, (_SWEEP_FRAMES, 1))
        poses[:, column] = np.linspace(low, high, _SWEEP_FRAMES)
        degrees = np.degrees(poses[:, column])
        motions.append(Motion(entry.name, poses, degrees, f"degrees of {entry.name}", degrees))
    if not motions:
        raise InputError(Problem(str(file), "has no joint that changes the length of a muscle"))
    return Shown(
        title=f"{model.name}: joints through their ranges",
        under=f"{counted(len(muscles), 'muscle')} of {file.name}. Each coordinate moves through its range; "
        "the others stay at their defaults.",
        model_file=file,
        model=model,
        muscles=muscles,
        coordinates=tuple(entry.name for entry in moving),
        motions=tuple(motions),
    )


def _recorded_model(file: Path | None, subject: Subject) -> Shown:
    """Show a subject's recorded motion, with the subject's own model or another one."""
    own = file is None or file.resolve() == subject.model_file.resolve()
    shown = _recorded(subject, subject.model_file if file is None else file)
    title = f"{subject.name}: recorded motion"
    return shown if own or file is None else replace(shown, title=f"{title} with {file.name}")


def _recorded(
    subject: Subject,
    model_file: Path,
    muscles: Sequence[str] = (),
    names: Collection[str] | None = None,
) -> Shown:
    """Show gait cycles of a subject, all or those named; ``muscles`` come first, the leg's others after."""
    model = describe_model(model_file)
    wanted = tuple(dict.fromkeys([*muscles, *subject.muscles.names, *subject.undriven_muscles]))
    _require(model_file, subject, wanted, [muscle.name for muscle in model.muscles])
    _require(model_file, subject, subject.trials.coordinates, [one.name for one in model.coordinates])
    trials, notes = subject.trials, []
    cycles = [place for place, name in enumerate(trials.names) if names is None or name in names]
    most = max(1, _MOST_FRAMES // trials.time.shape[1])
    if len(cycles) > most:
        notes.append(f"Shown are {most} of {len(cycles)} gait cycles, evenly chosen, to keep the page small.")
        cycles = [cycles[place] for place in np.linspace(0, len(cycles) - 1, most).astype(int).tolist()]
    chosen = trials.select(cycles)
    percent = np.linspace(0.0, 100.0, trials.time.shape[1])
    motions = tuple(
        Motion(_cycle_name(name, use, speed), angles.T, percent, _CYCLE, time)
        for name, use, speed, angles, time in zip(
            chosen.names, chosen.uses, chosen.speeds.tolist(), chosen.angles, chosen.time, strict=True
        )
    )
    counts = f"{counted(len(wanted), 'muscle')} of {model_file.name}, {counted(len(motions), 'gait cycle')}."
    return Shown(
        title=f"{subject.name}: recorded motion",
        under=counts,
        model_file=model_file,
        model=model,
        muscles=wanted,
        coordinates=trials.coordinates,
        motions=motions,
        cycles=tuple(cycles),
        notes=tuple(notes),
    )


def _require(model_file: Path, subject: Subject, wanted: Iterable[str], known: Sequence[str]) -> None:
    """Raise an error if a model lacks a muscle or coordinate of a subject."""
    missing = [name for name in wanted if name not in known]
    if missing:
        message = f"lacks '{missing[0]}' of subject {subject.folder}"
        raise InputError(Problem(str(model_file), message, hint=nearest_name(missing[0], known)))


def _cycle_name(name: str, use: str, speed: float) -> str:
    return f"{name} ({use}{'' if math.isnan(speed) else f', {speed:g} m/s'})"


def _fit(folder: Path, subject: Subject | None) -> Shown:
    fitted = load_fit(folder)
    subject = _subject_of(folder, subject, _stored_folder(folder, "fit.json"))
    fitted.require_subject(subject, str(folder))
    shown = _recorded(subject, subject.model_file, fitted.surrogate.muscles)
    return replace(
        shown,
        title=f"{subject.name}: muscle paths and their polynomials",
        polynomials={"polynomial": fitted.surrogate},
        coloring="moment_arm",
        notes=(
            *shown.notes,
            "Drawn are exact shortest paths; the curves show the fitted polynomials, too.",
        ),
    )


def _calibration(folder: Path, subject: Subject | None) -> Shown:
    run = load_run(folder)
    curves = read_curves(run, subject)
    subject = curves.subject
    if run.model_hash is not None and content_hash(subject.model_file) != run.model_hash:
        message = "has changed since the calibration, whose wraps would be placed in another model"
        raise InputError(Problem(str(subject.model_file), message, hint="calibrate again"))
    shown = _recorded(subject, subject.model_file, run.muscles)
    cycles = list(shown.cycles)
    force = np.concatenate(np.moveaxis(curves.force[:, cycles], 1, 0), axis=1)
    measured, modelled = (
        np.concatenate(moments[cycles], axis=1) for moments in (curves.measured, curves.modelled)
    )
    placements = (Placement("before"), Placement("after", run.wraps)) if run.wraps else (Placement("model"),)
    return replace(
        shown,
        title=f"{run.subject}: {run.method} calibration in motion",
        under=f"{shown.under} {_converged(run)}",
        placements=placements,
        polynomials={} if run.paths is None else {"polynomial of the calibration": run.paths},
        quantities=(
            Quantity(
                "tendon_force",
                "Tendon force",
                "N",
                (MUSCLE,),
                (Series("calibrated", aligned(force, run.muscles, shown.muscles), "main"),),
                "sequential",
            ),
            _moments(
                shown,
                run.coordinates,
                (("measured", "measured", measured), ("calibrated", "main", modelled)),
            ),
        ),
        coloring="tendon_force",
        notes=(*shown.notes, *_notes_on_paths(run)),
    )


def _converged(run: Run) -> str:
    return "The calibration converged." if run.converged else "The calibration did not converge."


def _notes_on_paths(run: Run) -> list[str]:
    if run.wraps:
        return [f"Before: wraps of the model. After: {counted(len(run.wraps), 'wrap')} as calibrated."]
    if run.method in ("SGA", "LSGA"):
        return [
            f"{run.method} changes polynomials and no wrap: drawn are the exact paths of the model, and the "
            "curves show the calibrated polynomials beside them."
        ]
    return []


def _diagnosis(folder: Path, subject: Subject | None) -> Shown:
    file = folder / "gap.json"
    try:
        content = load_json(file)
        where, trials = content["where"], content["trials"]
        subject = _subject_of(folder, subject, _stored_folder(folder, "gap.json"))
        missing = [name for name in trials if name not in subject.trials.names]
        if missing:
            message = f"was made from a cycle '{missing[0]}', which subject {subject.folder} lacks"
            raise InputError(Problem(str(folder), message, hint="name its subject with --subject"))
        shown = _recorded(subject, subject.model_file, names=trials)
        names = [subject.trials.names[place] for place in shown.cycles]
        speeds = [trials[name]["speed_m_s"] for name in names]
        coordinates = tuple(subject.trials.moment_coordinates)
        files = [folder / "moments" / f"{trials[name]['file']}.sto" for name in names]
        curves = [
            (label, style, _stored_moments(files, shown.motions, coordinates, suffix))
            for label, style, suffix in (
                ("measured", "measured", ""),
                ("plain model", "reference", "_before"),
                ("with the best explanation", "main", "_after"),
            )
        ]
        errors = {
            key: aligned(
                gap_errors(where, shown.motions, speeds, coordinates, key), coordinates, shown.coordinates
            )
            for key in ("explainable_rms_Nm", "rms_Nm")
        }
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        message = f"is damaged ({type(error).__name__}: {error})"
        raise InputError(Problem(str(file), message, hint="diagnose again")) from error
    return replace(
        shown,
        title=f"{subject.name}: diagnosed gap in motion",
        under=f"{shown.under} {_outcome(content)}",
        quantities=(
            _moments(shown, coordinates, curves),
            _errors("gap", "Explainable error", errors["explainable_rms_Nm"]),
            _errors("error", "Error of the plain model", errors["rms_Nm"]),
        ),
        coloring="gap",
        notes=(
            *shown.notes,
            "Errors are those of the moments about the chosen coordinate, root mean square by phase and "
            "speed; they color the joint's axis and all muscles that span it. They belong to the coordinate: "
            "moments do not tell which muscle causes them.",
        ),
    )


def _outcome(content: dict) -> str:
    named = [name.replace("_", " ") for name in content.get("named", [])]
    if named:
        return f"Named: {', '.join(named)}."
    return f"Outcome of the diagnosis: {str(content.get('outcome', '')).replace('_', ' ')}."


def _errors(key: str, title: str, values: Float[np.ndarray, "coordinate frame"]) -> Quantity:
    return Quantity(key, title, "N m", (COORDINATE,), (Series(title, values, "main"),), "sequential", False)


def _moments(
    shown: Shown,
    coordinates: Sequence[str],
    curves: Sequence[tuple[str, str, Float[np.ndarray, "coordinate frame"]]],
) -> Quantity:
    series = tuple(
        Series(label, aligned(values, coordinates, shown.coordinates), style)
        for label, style, values in curves
    )
    return Quantity("moment", "Joint moment", "N m", (COORDINATE,), series)


def _stored_moments(
    files: Sequence[Path], motions: Sequence[Motion], coordinates: Sequence[str], suffix: str
) -> Float[np.ndarray, "coordinate frame"]:
    """Read moments of all motions from the files of their recordings, N m; NaN for missing columns."""
    parts = []
    for file, motion in zip(files, motions, strict=True):
        table = read_storage(file)
        rows = np.abs(table.time[None] - motion.time[:, None]).argmin(axis=1)
        labels = [f"{name}_moment{suffix}" for name in coordinates]
        parts.append(aligned(table.values[rows].T, table.columns, labels))
    return np.concatenate(parts, axis=1)


def _stored_folder(folder: Path, file: str) -> Path | None:
    """Look up the subject's folder in a result; None if it is not stored, as in earlier versions."""
    try:
        stored = load_json(folder / file).get("subject_folder")
    except (ValueError, AttributeError) as error:
        raise InputError(Problem(str(folder / file), f"is damaged ({error})")) from error
    return None if stored is None else folder / str(stored)


def _subject_of(folder: Path, subject: Subject | None, stored: Path | None) -> Subject:
    if subject is not None:
        return subject
    kind = KINDS[str(kind_of(folder))].command
    if stored is None:
        message = f"does not say of which subject it is: it was written by 'wrapjax {kind}' without a subject"
        raise InputError(Problem(str(folder), message, hint="name the subject folder with --subject"))
    if not stored.is_dir():
        message = f"was made from the subject folder {stored}, which is not there"
        raise InputError(Problem(str(folder), message, hint="name it with --subject"))
    return load_subject(stored)
