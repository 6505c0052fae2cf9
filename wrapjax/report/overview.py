"""Results that lie below one folder: one line and a link each, with their key figures."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.io.json_and_arrays import load_json
from wrapjax.report import markup
from wrapjax.report.style import counted, decimals, plain

Content = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """A finished result.

    Parameters
    ----------
    folder
        Where it lies.
    kind
        Of `KINDS`.
    about
        Whose it is.
    figures
        Key figures, in a phrase.
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
        By which a folder of this kind is told.
    about, figures
        Read whose it is, and key figures, out of that file.
    command
        What writes it.
    """

    file: str
    about: Callable[[Content], str]
    figures: Callable[[Content], str]
    command: str


def _errors(content: Content) -> str:
    parts = [
        f"{use} {decimals(own['mean'])} N m" for use, own in content["mae_Nm"].items() if own is not None
    ]
    return f"mean absolute error: {', '.join(parts)}"


def _run(content: Content) -> str:
    end = "" if content["converged"] else "; did not converge"
    return f"{_errors(content)}{end}"


def _evaluated(content: Content) -> str:
    run = content["run"]
    return f"{content['subject']} by the {run['method']} of {run['subject']}"


def _fit(content: Content) -> str:
    muscles = content["muscles"]
    worst = max(muscles, key=lambda name: muscles[name]["length_rmse_mm"])
    return (
        f"{counted(len(muscles), 'muscle')}; largest length error {muscles[worst]['length_rmse_mm']:.2f} mm "
        f"RMSE ({worst})"
    )


def _gap(content: Content) -> str:
    names = content["named"] or [name for tie in content["ties"] for name in tie]
    said = plain(content["outcome"]) + (f": {', '.join(names)}" if names else "")
    share = (content.get("explainable_share") or {}).get("estimate")
    return said if share is None else f"{said}; {100.0 * share:.0f} % of the error explainable"


def _comparison(content: Content) -> str:
    rows = [
        row
        for row in content["quantities"].get("moment_error", [])
        if row["item"] == "mean" and row["use"] == "calibration"
    ]
    means = rows[-1]["methods"] if rows else {}
    parts = [f"{method} {decimals(own['mean'])}" for method, own in means.items()]
    return f"mean absolute error (N m): {', '.join(parts)}" if parts else ", ".join(content["methods"])


def _contact(content: Content) -> str:
    joint = next(iter(content["joints"]))
    parts = []
    for run in content["runs"]:
        measure, peak = list(run["joints"][joint].items())[-1]
        parts.append(f"{run['run']} {decimals(peak['mean_bodyweights'])}")
    return f"{plain(measure)} at the {joint} (bodyweights): {', '.join(parts)}"


def _lengths(content: Content) -> str:
    errors = content["passive_mae_Nm"]
    parts = [f"{name} {decimals(own['before'])} to {decimals(own['after'])}" for name, own in errors.items()]
    if not parts:
        return "no passive moments"
    return f"passive moments, mean absolute error (N m): {', '.join(parts)}"


def _cohort(content: Content) -> str:
    states = [own["state"] for own in content["subjects"].values()]
    return f"{counted(len(states), 'subject')}, {states.count('failed')} failed"


#: By name. A folder is of the first kind whose file it holds.
KINDS: dict[str, Kind] = {
    "cohort": Kind(
        "cohort.json",
        lambda content: f"{content['method']} of {counted(len(content['subjects']), 'subject')}",
        _cohort,
        "cohort",
    ),
    "comparison": Kind(
        "comparison.json",
        lambda content: f"{counted(len(content['legs']), 'leg')} by {', '.join(content['methods'])}",
        _comparison,
        "compare",
    ),
    "diagnosis": Kind("gap.json", lambda content: content["subject"], _gap, "diagnose"),
    "evaluation": Kind(
        "evaluation.json",
        _evaluated,
        _errors,
        "evaluate",
    ),
    "fit": Kind("fit.json", lambda content: "", _fit, "fit"),
    "contact force": Kind("contact.json", lambda content: content["subject"], _contact, "contact"),
    "initialisation": Kind("initialisation.json", lambda content: content["subject"], _lengths, "initialise"),
    "calibration": Kind(
        "summary.json", lambda content: f"{content['method']} of {content['subject']}", _run, "calibrate"
    ),
}


def kind_of(folder: Path) -> str | None:
    """Say what kind of result a folder is; None if it is none."""
    return next((name for name, kind in KINDS.items() if (folder / kind.file).is_file()), None)


def find_results(folder: Path) -> list[Result]:
    """Find all results below a folder, in the order of their paths; hidden folders are left out."""
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
    """Write a page that links to the reports below a folder, with nothing outside it."""
    title = f"Results in {folder.resolve().name}"
    rows = [(_linked(result.folder, folder), result.kind, result.about, result.figures) for result in results]
    return markup.page(
        title,
        [
            markup.header(title),
            markup.table(
                ("folder", "result", "of", "key figures"),
                rows,
                caption="One line a result. Moment errors are means over coordinates.",
            ),
        ],
    )


def _linked(place: Path, folder: Path) -> str:
    name = place.relative_to(folder).as_posix()
    return markup.Link(name, f"{name}/report.html") if (place / "report.html").is_file() else name


def refuse_redrawing(folder: Path, kind: str) -> None:
    """Raise an error that says why the report of this kind of result cannot be drawn again.

    Raises
    ------
    InputError
        Always.
    """
    message = (
        f"holds a {kind}, whose report shows more than its files keep: it cannot be drawn again without "
        "calculating"
    )
    hint = f"make it anew with 'wrapjax {KINDS[kind].command}', or ask for an index of the folder above it"
    raise InputError(Problem(str(folder), message, hint=hint))
