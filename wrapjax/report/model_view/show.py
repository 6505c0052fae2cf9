"""The page of a model, a subject, a fit, a calibration or a diagnosis as a file of the user's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_text
from wrapjax.path_sources.polynomial_fit import load_fit
from wrapjax.report.model_view.page import render_page
from wrapjax.report.model_view.results import (
    shown_calibration,
    shown_diagnosis,
    shown_joints,
    subject_of,
)
from wrapjax.report.model_view.shown import Shown, recorded, shown_fit, swept_model
from wrapjax.report.overview import kind_of
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.subject import Subject, load_subject

_HINT = (
    "name a model (.osim), a subject folder, or a folder of 'wrapjax joints', 'fit', 'calibrate' or "
    "'diagnose'"
)


def show(
    place: str | Path,
    out: str | Path,
    *,
    subject: Subject | str | Path | None = None,
    bones: str | Path | None = None,
    force: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Write a page that shows a model in motion, in three dimensions, with curves beside it.

    Shown are bones, joint axes, muscle paths with their contacts on wrapping surfaces, and these surfaces;
    of a calibration with changed wraps, before and after it; of personalised joints, their axes before and
    after. Muscles are colored by tendon force, moment arm
    or the error of a diagnosis.

    Parameters
    ----------
    place
        Model (``.osim``), subject folder, or folder of joints, a fit, a calibration or a diagnosis. A model
        alone
        moves each joint through its range.
    out
        HTML file to write.
    subject
        Subject with the recorded motion, or its folder; by default that of ``place``.
    bones
        Folder of the bones' surfaces (``.vtp``), before those in which OpenSim's users keep them.
    force
        Whether to replace an existing file.
    log
        Function called with a line before a step that takes seconds.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        If there is nothing to show in ``place``, its subject is not found or does not fit, a file is damaged,
        or the output exists and ``force`` is not set.

    Examples
    --------
    >>> wrapjax.show("PGA", "PGA.html")  # doctest: +SKIP
    """
    target = Path(out)
    if target.is_dir():
        raise InputError(Problem(str(target), "is a folder, where an HTML file was expected"))
    if target.exists() and not force:
        raise InputError(Problem(str(target), "exists already", hint="replace it with --force"))
    if bones is not None and not Path(bones).is_dir():
        raise InputError(Problem(str(bones), "is no folder", hint="name a folder with .vtp files"))
    shown = read_shown(Path(place), Path(subject) if isinstance(subject, str) else subject)
    log("computing the muscle paths")
    write_text(target, render_page(shown, () if bones is None else (Path(bones),)))
    return target


def read_shown(place: Path, subject: Subject | Path | None = None) -> Shown:
    """Read what the page shows.

    Parameters
    ----------
    place
        Model file, subject folder, or folder of joints, a fit, a calibration or a diagnosis.
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
        return swept_model(place) if subject is None else _recorded_model(place, subject)
    if place.name == SETTINGS_FILE or (place / SETTINGS_FILE).is_file():
        return _recorded_model(None, load_subject(place) if subject is None else subject)
    if not place.is_dir():
        found = "is no OpenSim model (.osim)" if place.exists() else "does not exist"
        raise InputError(Problem(str(place), found, hint=_HINT))
    readers: dict[str | None, Callable[[Path, Subject | None], Shown]] = {
        "joint personalisation": _shown_joints,
        "fit": _shown_fit,
        "calibration": shown_calibration,
        "diagnosis": shown_diagnosis,
    }
    kind = kind_of(place)
    if kind not in readers:
        found = "no result of wrapjax"
        if kind is not None:
            found = f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}, which has no view in motion"
        raise InputError(Problem(str(place), f"holds {found}", hint=_HINT))
    return readers[kind](place, subject)


def _recorded_model(file: Path | None, subject: Subject) -> Shown:
    """Show a subject's recorded motion, with the subject's own model or another one."""
    own = file is None or file.resolve() == subject.model_file.resolve()
    shown = recorded(subject, subject.model_file if file is None else file)
    title = f"{subject.name}: recorded motion"
    return shown if own or file is None else replace(shown, title=f"{title} with {file.name}")


def _shown_joints(folder: Path, subject: Subject | None) -> Shown:
    if subject is not None:
        message = "has markers and no subject, whose motion could be shown"
        hint = "leave out --subject, or show model_joints.osim with it"
        raise InputError(Problem(str(folder), message, hint=hint))
    return shown_joints(folder)


def _shown_fit(folder: Path, subject: Subject | None) -> Shown:
    fitted = load_fit(folder)
    subject = subject_of(folder, "fit.json", subject)
    fitted.require_subject(subject, str(folder))
    return shown_fit(fitted.surrogate, subject)
