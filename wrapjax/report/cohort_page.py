"""Summary of a cohort of subjects: the content of ``cohort.json`` and the page that shows it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.io.files import write_json, write_text
from wrapjax.report import markup
from wrapjax.report.calibration.run_summary import USES
from wrapjax.report.formatting import DASH, counted, decimals, readable
from wrapjax.report.provenance import package_versions, versions_in_words
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    in_style,
    legend_above,
    new_figure,
)
from wrapjax.subject.subject import name_without_side

#: Version of the layout of ``cohort.json``.
SCHEMA = 1


def describe_cohort(
    method: str, diagnosed: bool, subjects: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Describe a cohort as plain numbers and strings.

    Parameters
    ----------
    method
        Calibration method of all subjects.
    diagnosed
        Whether subjects were diagnosed as well.
    subjects
        Results by subject. The ``state`` of each is ``waiting``, ``failed`` (with a ``message``) or ``done``
        (with ``mae_Nm`` and ``rmse_Nm`` as in ``summary.json``, and a ``diagnosis``).

    Returns
    -------
    dict
        All arguments and, under ``population``, statistics of the completed subjects: ``mae_Nm`` and
        ``rmse_Nm`` by use and coordinate (names without side) as ``n``, ``mean``, ``sd`` (None below two),
        ``min``, ``median`` and ``max`` in N m; number of diagnoses by outcome, and number of subjects in
        which each effect was named or tied.
    """
    done = [subject for subject in subjects.values() if subject["state"] == "done"]
    diagnoses = [subject["diagnosis"] for subject in done if subject["diagnosis"] is not None]
    named = Counter(name for diagnosis in diagnoses for name in diagnosis["named"])
    tied = Counter(
        name for diagnosis in diagnoses for name in {effect for tie in diagnosis["ties"] for effect in tie}
    )
    return {
        "schema": SCHEMA,
        "method": method,
        "diagnosed": diagnosed,
        "subjects": {name: dict(subject) for name, subject in subjects.items()},
        "population": {
            "n": len(done),
            "converged": sum(subject["converged"] for subject in done),
            "failed": sum(subject["state"] == "failed" for subject in subjects.values()),
            "waiting": sum(subject["state"] == "waiting" for subject in subjects.values()),
            **{
                kind: {use: _error_statistics(done, kind, use) for use in USES}
                for kind in ("mae_Nm", "rmse_Nm")
            },
            "outcomes": dict(Counter(diagnosis["outcome"] for diagnosis in diagnoses).most_common()),
            "named": dict(named.most_common()),
            "tied": dict(tied.most_common()),
        },
        "versions": package_versions(),
    }


def errors_by_coordinate(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, list[float]]:
    """Collect the subjects' errors (N m) by coordinate, left and right legs together; ``mean`` comes last."""
    errors: dict[str, list[float]] = {}
    for subject in subjects:
        for name, value in (subject[kind][use] or {}).items():
            errors.setdefault(name_without_side(name), []).append(value)
    return {name: errors[name] for name in sorted(errors, key=lambda name: name == "mean")}


def _error_statistics(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, dict[str, Any]]:
    return {
        name: {
            "n": len(values),
            "mean": float(np.mean(values)),
            "sd": float(np.std(values, ddof=1)) if len(values) > 1 else None,
            "min": min(values),
            "median": float(np.median(values)),
            "max": max(values),
        }
        for name, values in errors_by_coordinate(subjects, kind, use).items()
    }


_COLORS = dict(zip(USES, (BLUE, VERMILION), strict=True))
# Width over which the subjects of one coordinate are spread, where coordinates have a distance of 1.
_WIDTH = 0.28


@in_style
def population_figure(subjects: list[Mapping[str, Any]]) -> Figure:
    """Draw the mean absolute error (N m) of every subject by coordinate, and the median over subjects.

    Parameters
    ----------
    subjects
        Completed subjects, at least one.
    """
    errors = {use: errors_by_coordinate(subjects, "mae_Nm", use) for use in USES}
    names = list(errors["calibration"] or errors["validation"])
    uses = [use for use in USES if errors[use]]
    figure = new_figure(PAGE_WIDTH, 3.2)
    panel = figure.subplots()
    for place in range(1, len(names)):
        panel.axvline(place - 0.5, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
    for number, use in enumerate(uses):
        center = 0.4 * (number - 0.5 * (len(uses) - 1))
        for place, name in enumerate(names):
            values = np.array(errors[use].get(name, []))
            spread = np.linspace(-0.5, 0.5, len(values)) if len(values) > 1 else np.zeros(len(values))
            panel.plot(
                place + center + _WIDTH * spread,
                values,
                "o",
                color=_COLORS[use],
                markersize=3.6,
                alpha=0.6,
                markeredgewidth=0,
                label=f"{use}, one subject" if place == 0 else None,
            )
            if values.size:
                ends = place + center + np.array([-0.6, 0.6]) * _WIDTH
                panel.hlines(
                    np.median(values),
                    *ends,
                    color=_COLORS[use],
                    linewidth=2.0,
                    label=f"{use}, median" if place == 0 else None,
                )
    panel.set_xticks(range(len(names)), names, parse_math=False)
    panel.tick_params(axis="x", length=0)
    panel.set_xlim(-0.5, len(names) - 0.5)
    panel.set_ylim(bottom=0.0)
    panel.set_ylabel("mean absolute error (N m)")
    legend_above(figure, panel)
    return figure


@in_style
def outcomes_figure(population: Mapping[str, Any]) -> Figure:
    """Draw the outcomes of diagnoses, and the number of subjects in which each effect was named or tied.

    Parameters
    ----------
    population
        ``population`` of ``cohort.json`` with at least one diagnosis.
    """
    outcomes, effects = population["outcomes"], {**population["tied"], **population["named"]}
    named = [population["named"].get(name, 0) for name in effects]
    tied = [population["tied"].get(name, 0) for name in effects]
    rows = max(len(outcomes), len(effects))
    figure = new_figure(PAGE_WIDTH, 0.24 * rows + 1.1)
    left, right = figure.subplots(1, 2)
    left.barh(range(len(outcomes)), list(outcomes.values()), color=GRAY, height=0.6)
    left.set_yticks(range(len(outcomes)), [readable(name) for name in outcomes], parse_math=False)
    left.set_title("outcome", loc="left")
    right.barh(range(len(effects)), named, color=BLUE, height=0.6, label="named")
    right.barh(range(len(effects)), tied, left=named, color=BLUE, alpha=0.35, height=0.6, label="tied")
    right.set_yticks(range(len(effects)), [readable(name) for name in effects], parse_math=False)
    right.set_title("effect", loc="left")
    for panel in (left, right):
        panel.set_ylim(rows - 0.4, -0.6)
        panel.xaxis.get_major_locator().set_params(integer=True)
        panel.set_xlabel("subjects")
        panel.tick_params(axis="y", length=0)
    if effects:
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    else:
        right.remove()
    return figure


def render_cohort(content: dict[str, Any]) -> str:
    """Write the page of a cohort as self-contained HTML with links to its subjects' reports.

    Parameters
    ----------
    content
        Content of ``cohort.json``, from `describe_cohort`.
    """
    title = f"{counted(len(content['subjects']), 'subject')}: {content['method']} calibration"
    if content["diagnosed"]:
        title += " and diagnosis"
    done = [subject for subject in content["subjects"].values() if subject["state"] == "done"]
    parts = [markup.header(title), _verdict_section(content)]
    if done:
        parts.append(_errors_section(content, done))
        if content["diagnosed"]:
            parts.append(_outcomes_section(content["population"]))
    parts.append(_subjects_section(content))
    notes = [
        "All numbers are in cohort.json; the results of each subject are in its folder.",
        f"{versions_in_words(content['versions'])}.",
    ]
    return markup.page(title, [*parts, markup.section("Notes", markup.bullets(notes))])


def _verdict_section(content: dict[str, Any]) -> str:
    population, subjects = content["population"], content["subjects"]
    lines = [
        f"{population['n']} of {counted(len(subjects), 'subject')} completed, of which "
        f"{population['converged']} converged."
    ]
    if population["waiting"]:
        lines.append(f"Not yet processed when this page was written: {population['waiting']}.")
    means = {use: population["mae_Nm"][use].get("mean") for use in USES}
    medians = [
        f"{decimals(mean['median'])} N m on {use} cycles ({decimals(mean['min'])} to {decimals(mean['max'])})"
        for use, mean in means.items()
        if mean is not None
    ]
    if medians:
        lines.append(
            "Median over subjects (range) of the mean absolute difference between modelled and measured "
            f"joint moments: {' and '.join(medians)}."
        )
    failed = [
        f"{name}: {subject['message']}" for name, subject in subjects.items() if subject["state"] == "failed"
    ]
    more = []
    if failed:
        more = [markup.paragraph(f"{counted(len(failed), 'subject')} failed:"), markup.bullets(failed)]
    kind = "verdict failed" if failed or population["converged"] < population["n"] else "verdict"
    return markup.box(*map(markup.paragraph, lines), *more, kind=kind)


def _errors_section(content: dict[str, Any], done: list[dict[str, Any]]) -> str:
    rows = []
    for use in USES:
        for name, errors in content["population"]["mae_Nm"][use].items():
            numbers = (errors[kind] for kind in ("mean", "sd", "min", "median", "max"))
            rows.append((f"{use}: {name}", str(errors["n"]), *map(decimals, numbers)))
    return markup.section(
        "Moment errors over subjects",
        markup.picture(
            population_figure(done),
            alternative=f"Mean absolute moment errors of {counted(len(done), 'subject')} by coordinate.",
            caption="Mean absolute error of the joint moments in N m, one dot per subject, by coordinate "
            "(left and right legs together) and averaged over coordinates; bars: median over subjects.",
        ),
        markup.table(
            ("cycles and coordinate", "subjects", "mean", "SD", "smallest", "median", "largest"),
            rows,
            caption="Mean absolute errors in N m over subjects; SD: standard deviation between subjects.",
        ),
    )


def _outcomes_section(population: dict[str, Any]) -> str:
    tables = [
        markup.table(
            ("outcome", "subjects"),
            [(readable(name), str(count)) for name, count in population["outcomes"].items()],
            caption="Outcomes of the diagnoses.",
        )
    ]
    effects = dict.fromkeys([*population["named"], *population["tied"]])
    if effects:
        rows = [
            (readable(name), str(population["named"].get(name, 0)), str(population["tied"].get(name, 0)))
            for name in effects
        ]
        tables.append(
            markup.table(
                ("effect", "named in", "tied in"),
                rows,
                caption="Number of subjects in which an effect explains the error best (named), or as well "
                "as other effects (tied).",
            )
        )
    counts = ", ".join(f"{readable(name)} {count}" for name, count in population["outcomes"].items())
    drawn = markup.picture(
        outcomes_figure(population),
        alternative=f"Number of subjects by outcome of the diagnosis: {counts}.",
        caption="Outcomes of the diagnoses, and number of subjects in which an effect explains the error "
        "best (named) or as well as other effects (tied). These are candidates to examine and do not prove "
        "a cause.",
    )
    return markup.section("Diagnoses", drawn, *tables)


def _subjects_section(content: dict[str, Any]) -> str:
    header = ["subject", "calibration", "validation", "result"]
    if content["diagnosed"]:
        header.append("diagnosis")
    rows = [_subject_row(name, entry, content["diagnosed"]) for name, entry in content["subjects"].items()]
    return markup.section(
        "Results by subject",
        markup.table(
            header,
            rows,
            caption="Mean absolute errors of joint moments in N m, averaged over coordinates. Names are "
            "links to the reports.",
        ),
    )


def _subject_row(name: str, subject: dict[str, Any], diagnosed: bool) -> tuple[str, ...]:
    if subject["state"] != "done":
        return (name, DASH, DASH, subject["state"], *([DASH] if diagnosed else []))
    errors = [subject["mae_Nm"][use] for use in USES]
    means = (decimals(None if error is None else error["mean"]) for error in errors)
    result = "converged" if subject["converged"] else "did not converge"
    row = (markup.Link(name, subject["report"]), *means, result)
    diagnosis = subject["diagnosis"]
    if not diagnosed:
        return row
    if diagnosis is None:
        return (*row, DASH)
    effects = diagnosis["named"] or [effect for tie in diagnosis["ties"] for effect in tie]
    if diagnosis["outcome"] == "family" and (family := diagnosis.get("family")):
        effects = [family["id"]]
    outcome = readable(diagnosis["outcome"]) + (f": {', '.join(map(readable, effects))}" if effects else "")
    return (*row, markup.Link(outcome, subject["diagnosis_report"]))


def write_content(content: dict[str, Any], folder: Path) -> None:
    """Write ``cohort.json``."""
    write_json(folder / "cohort.json", content)


def write_page(content: dict[str, Any], folder: Path) -> None:
    """Write ``report.html``, which shows the content of ``cohort.json``."""
    write_text(folder / "report.html", render_cohort(content))
