"""Index page of all results below a folder, with their main numbers."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.json_and_arrays import load_json
from wrapjax.report import markup
from wrapjax.report.formatting import counted, decimals, readable

Content = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """A finished result.

    Parameters
    ----------
    folder
        Folder of the result.
    kind
        Key of `KINDS`.
    about
        Subject and method.
    figures
        Main numbers, in a phrase.
    """

    folder: Path
    kind: str
    about: str
    figures: str


@dataclass(frozen=True)
class Kind:
    """A kind of result.

    Parameters
    ----------
    file
        Name of the JSON file that identifies a folder of this kind.
    about, figures
        Functions that write subject and method, and the main numbers, from that file's content.
    command
        Subcommand of ``wrapjax`` that writes the folder.
    beside
        Another file that such a folder holds.
    """

    file: str
    about: Callable[[Content], str]
    figures: Callable[[Content], str]
    command: str
    beside: str = ""


def _error_figures(content: Content) -> str:
    parts = [
        f"{use} {decimals(errors['mean'])} N m"
        for use, errors in content["mae_Nm"].items()
        if errors is not None
    ]
    return f"mean absolute error: {', '.join(parts)}"


def _run_figures(content: Content) -> str:
    end = "" if content["converged"] else "; did not converge"
    return f"{_error_figures(content)}{end}"


def _about_subject(content: Content) -> str:
    return content["subject"]


def _about_evaluation(content: Content) -> str:
    run = content["run"]
    return f"{content['subject']} by the {run['method']} calibration of {run['subject']}"


def _fit_figures(content: Content) -> str:
    muscles = content["muscles"]
    worst = max(muscles, key=lambda name: muscles[name]["length_rmse_mm"])
    return (
        f"{counted(len(muscles), 'muscle')}; largest length error {muscles[worst]['length_rmse_mm']:.2f} mm "
        f"RMSE ({worst})"
    )


def _diagnosis_figures(content: Content) -> str:
    names = content["named"] or [name for tie in content["ties"] for name in tie]
    # Layouts of version 1 know no families.
    if content["outcome"] == "family" and (family := content.get("family")):
        names = [family["id"]]
    outcome = readable(content["outcome"]) + (f": {', '.join(names)}" if names else "")
    share = (content.get("explainable_share") or {}).get("estimate")
    return outcome if share is None else f"{outcome}; {100.0 * share:.0f} % of the error explainable"


def _comparison_figures(content: Content) -> str:
    rows = [
        row
        for row in content["quantities"].get("moment_error", [])
        if row["item"] == "mean" and row["use"] == "calibration"
    ]
    means = rows[-1]["methods"] if rows else {}
    parts = [f"{method} {decimals(errors['mean'])}" for method, errors in means.items()]
    return f"mean absolute error (N m): {', '.join(parts)}" if parts else ", ".join(content["methods"])


def _contact_figures(content: Content) -> str:
    joint = next(iter(content["joints"]))
    parts = []
    for run in content["runs"]:
        measure, peak = list(run["joints"][joint].items())[-1]
        parts.append(f"{run['run']} {decimals(peak['mean_bodyweights'])}")
    return f"{readable(measure)} at the {joint} (bodyweights): {', '.join(parts)}"


def _initialisation_figures(content: Content) -> str:
    parts = [
        f"{name} {decimals(errors['before'])} to {decimals(errors['after'])}"
        for name, errors in content["passive_mae_Nm"].items()
    ]
    if not parts:
        return "no passive moments"
    return f"passive moments, mean absolute error (N m): {', '.join(parts)}"


def _cohort_figures(content: Content) -> str:
    states = [subject["state"] for subject in content["subjects"].values()]
    return f"{counted(len(states), 'subject')}, {states.count('failed')} failed"


def _joint_figures(content: Content) -> str:
    rms = content["rms_mm"]
    parts = [f"markers {decimals(rms['before'])} to {decimals(rms['after'])} mm"]
    if rms.get("held_out_after") is not None:
        parts.append(f"held out {decimals(rms['held_out_before'])} to {decimals(rms['held_out_after'])} mm")
    return ", ".join(parts)


#: Kinds of results by name. A folder is of the first kind whose file it holds.
KINDS: dict[str, Kind] = {
    "cohort": Kind(
        "cohort.json",
        lambda content: f"{content['method']} of {counted(len(content['subjects']), 'subject')}",
        _cohort_figures,
        "cohort",
    ),
    "comparison": Kind(
        "comparison.json",
        lambda content: f"{counted(len(content['legs']), 'leg')} by {', '.join(content['methods'])}",
        _comparison_figures,
        "compare",
    ),
    "diagnosis": Kind("gap.json", _about_subject, _diagnosis_figures, "diagnose"),
    "evaluation": Kind("evaluation.json", _about_evaluation, _error_figures, "evaluate"),
    "fit": Kind("fit.json", lambda content: "", _fit_figures, "fit"),
    # A prepared subject folder has a copy of the first file.
    "joint personalisation": Kind(
        "joints.json", _about_subject, _joint_figures, "joints", "model_joints.osim"
    ),
    "contact force": Kind("contact.json", _about_subject, _contact_figures, "contact"),
    "initialisation": Kind("initialisation.json", _about_subject, _initialisation_figures, "initialise"),
    "calibration": Kind(
        "summary.json",
        lambda content: f"{content['method']} of {content['subject']}",
        _run_figures,
        "calibrate",
    ),
}


def kind_of(folder: Path) -> str | None:
    """Determine which of `KINDS` a folder holds; None if it holds no result."""
    return next(
        (
            name
            for name, kind in KINDS.items()
            if (folder / kind.file).is_file() and (folder / kind.beside).exists()
        ),
        None,
    )


def find_results(folder: Path) -> list[Result]:
    """Find all results below a folder, in the order of their paths; hidden folders are skipped."""
    found = []
    for place, below, _ in os.walk(folder):
        below[:] = sorted(name for name in below if not name.startswith("."))
        kind = kind_of(Path(place))
        if kind is not None and Path(place) != folder:
            found.append(_read(Path(place), kind))
    return found


def _read(folder: Path, kind: str) -> Result:
    file = folder / KINDS[kind].file
    try:
        content = load_json(file)
        return Result(folder, kind, KINDS[kind].about(content), KINDS[kind].figures(content))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return Result(folder, kind, "", f"{file.name} cannot be read")


def render_overview(folder: Path, results: list[Result]) -> str:
    """Write a self-contained HTML page with a link to each report below a folder."""
    title = f"Results in {folder.resolve().name}"
    rows = [(_linked(result.folder, folder), result.kind, result.about, result.figures) for result in results]
    return markup.page(
        title,
        [
            markup.header(title),
            markup.table(
                ("folder", "result", "subject and method", "main numbers"),
                rows,
                caption="One row per result. Moment errors are means over coordinates.",
            ),
        ],
    )


def _linked(place: Path, folder: Path) -> str:
    name = place.relative_to(folder).as_posix()
    return markup.Link(name, f"{name}/report.html") if (place / "report.html").is_file() else name


def refuse_redrawing(folder: Path, kind: str) -> None:
    """Raise an error for a kind of result whose report cannot be redrawn from its files.

    Raises
    ------
    InputError
        Always.
    """
    message = (
        f"holds a {kind}, whose report shows more than its files contain: it cannot be redrawn without "
        "computing the result again"
    )
    hint = f"run 'wrapjax {KINDS[kind].command}' again, or make an index of the folder above it"
    raise InputError(Problem(str(folder), message, hint=hint))
