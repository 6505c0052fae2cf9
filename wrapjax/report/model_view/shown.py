"""What the page shows of a model or of a subject's recorded motion, before positions are computed."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.model_description import ModelDescription, Pose
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.osim.model import describe_model
from wrapjax.report.formatting import counted
from wrapjax.report.model_view.quantities import Quantity
from wrapjax.report.model_view.scene import Motion, Placement
from wrapjax.subject.subject import Subject

# Most frames shown, which keeps the page of a leg below 15 MB and its computation below a minute.
_MOST_FRAMES = 2020
_SWEEP_FRAMES = 51
_CYCLE = "% of the gait cycle"


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
    joints_before
        Pose of personalised joints in their parent bodies before, by name.
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
    joints_before: dict[str, Pose] = field(default_factory=dict)


def swept_model(file: Path) -> Shown:
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


def recorded(
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


def shown_fit(paths: PathSurrogate, subject: Subject) -> Shown:
    """Show fitted polynomials beside the exact paths of their subject's recorded motion."""
    shown = recorded(subject, subject.model_file, paths.muscles)
    return replace(
        shown,
        title=f"{subject.name}: muscle paths and their polynomials",
        polynomials={"polynomial": paths},
        coloring="moment_arm",
        notes=(*shown.notes, "Drawn are exact shortest paths; the curves show the fitted polynomials, too."),
    )
