"""What the page shows of a calibration and of a diagnosis, read from their folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.stored_run import Run, load_run, read_curves
from wrapjax.geometry.skeleton.model_description import Pose
from wrapjax.io.files import content_hash
from wrapjax.io.json_and_arrays import load_json
from wrapjax.io.storage import read_storage
from wrapjax.report.formatting import counted
from wrapjax.report.model_view.quantities import COORDINATE, MUSCLE, Quantity, Series, aligned, gap_errors
from wrapjax.report.model_view.scene import Motion, Placement
from wrapjax.report.model_view.shown import Shown, recorded, swept_model
from wrapjax.report.overview import KINDS, kind_of
from wrapjax.subject.joint_spread import JOINTS_FILE
from wrapjax.subject.subject import Subject, load_subject


def shown_joints(folder: Path) -> Shown:
    """Show a model with personalised joints, read from their folder; see `personalised_joints`.

    Raises
    ------
    InputError
        If a file of the folder is missing or damaged.
    """
    file = folder / JOINTS_FILE
    try:
        content = load_json(file)
        # Folders of earlier versions do not have the places before.
        before = {
            name: _pose(joint["before"]) for name, joint in content["joints"].items() if "before" in joint
        }
        name = content["subject"]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        message = f"is damaged ({type(error).__name__}: {error})"
        raise InputError(Problem(str(file), message, hint="run 'wrapjax joints' again")) from error
    return personalised_joints(folder / "model_joints.osim", name, before)


def personalised_joints(model_file: Path, name: str, before: dict[str, Pose]) -> Shown:
    """Show a model with personalised joints: its axes, and in orange those before.

    Parameters
    ----------
    model_file
        Personalised model.
    name
        Name of the subject.
    before
        Poses of the personalised joints in their parent bodies before, by name.
    """
    shown = swept_model(model_file)
    note = (
        "Orange: axes where the starting model has them in the parent body. The motion is not that of the "
        "markers: each joint moves through its range."
    )
    title = f"{name}: joints from markers"
    return replace(shown, title=title, joints_before=before, notes=(*shown.notes, note))


def _pose(stored: dict[str, list[float]]) -> Pose:
    rows = Rotation.from_euler("XYZ", stored["orientation_rad"]).as_matrix().tolist()
    first, second, third, origin = ((x, y, z) for x, y, z in [*rows, stored["translation_m"]])
    return Pose((first, second, third), origin)


def shown_calibration(folder: Path, subject: Subject | None) -> Shown:
    """Show a calibration: wraps before and after it, tendon forces and joint moments.

    Parameters
    ----------
    folder
        Folder of the run.
    subject
        Subject of the run; by default the one that the run names.

    Raises
    ------
    InputError
        If a file of the run is missing or damaged, or the subject is not found or is another one.
    """
    run = load_run(folder)
    curves = read_curves(run, subject)
    subject = curves.subject
    if run.model_hash is not None and content_hash(subject.model_file) != run.model_hash:
        message = "has changed since the calibration, whose wraps would be placed in another model"
        raise InputError(Problem(str(subject.model_file), message, hint="calibrate again"))
    shown = recorded(subject, subject.model_file, run.muscles)
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


def shown_diagnosis(folder: Path, subject: Subject | None) -> Shown:
    """Show a diagnosis: errors by coordinate, phase and speed, and joint moments before and after.

    Parameters
    ----------
    folder
        Folder of the diagnosis.
    subject
        Subject of the diagnosis; by default the one that the diagnosis names.

    Raises
    ------
    InputError
        If a file of the diagnosis is missing or damaged, or the subject is not found or is another one.
    """
    file = folder / "gap.json"
    try:
        content = load_json(file)
        where = [entry for entry in content["where"] if "phase_percent" in entry]
        trials, outcome = content["trials"], _outcome(content)
        subject = subject_of(folder, "gap.json", subject)
        missing = [name for name in trials if name not in subject.trials.names]
        if missing:
            message = f"was made from a cycle '{missing[0]}', which subject {subject.folder} lacks"
            raise InputError(Problem(str(folder), message, hint="name its subject with --subject"))
        shown = recorded(subject, subject.model_file, names=trials)
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
        under=f"{shown.under} {outcome}",
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


def _outcome(content: dict[str, Any]) -> str:
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


def subject_of(folder: Path, file: str, subject: Subject | None) -> Subject:
    """Return the given subject, or load that of a result.

    Parameters
    ----------
    folder, file
        Folder of the result, and the JSON file in it that names the subject's folder.
    subject
        Subject, if it is known.

    Raises
    ------
    InputError
        If the result does not name its subject, as those of earlier versions, or the subject is not there.
    """
    if subject is not None:
        return subject
    try:
        stored = load_json(folder / file).get("subject_folder")
    except (ValueError, AttributeError) as error:
        raise InputError(Problem(str(folder / file), f"is damaged ({error})")) from error
    if stored is None:
        kind = KINDS[str(kind_of(folder))].command
        message = f"does not say of which subject it is: it was written by 'wrapjax {kind}' without a subject"
        raise InputError(Problem(str(folder), message, hint="name the subject folder with --subject"))
    place = folder / str(stored)
    if not place.is_dir():
        message = f"was made from the subject folder {place}, which is not there"
        raise InputError(Problem(str(folder), message, hint="name it with --subject"))
    return load_subject(place)
