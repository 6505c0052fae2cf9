"""A cohort in numbers: the content of ``cohort.json``.

Errors of all subjects in one figure.

The page of a cohort: everything on it is in ``cohort.json``.

The files of a cohort beside its subjects.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.io.files import write_json, write_text
from wrapjax.report import markup
from wrapjax.report.provenance import package_versions, versions_in_words
from wrapjax.report.run_summary import USES
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    plain,
)
from wrapjax.subject.subject import name_without_side

#: Version of the layout of ``cohort.json``.
SCHEMA = 1


def describe_cohort(
    method: str, diagnosed: bool, subjects: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Describe a cohort as plain numbers and words.

    Parameters
    ----------
    method
        Of every calibration.
    diagnosed
        Whether subjects were diagnosed, too.
    subjects
        By name: what is known of each. Its ``state`` is ``waiting``, ``failed`` (with a ``message``) or
        ``done`` (with ``mae_Nm`` and ``rmse_Nm`` as in ``summary.json``, and a ``diagnosis``).

    Returns
    -------
    dict
        All of it, and under ``population``, over the subjects that are done: ``mae_Nm`` and ``rmse_Nm`` by
        use and coordinate (names without side) as ``n``, ``mean``, ``sd`` (None below two), ``min``,
        ``median`` and ``max`` in N m; how many diagnoses had which outcome, and how many named or tied
        which effect.
    """
    done = [one for one in subjects.values() if one["state"] == "done"]
    gaps = [one["diagnosis"] for one in done if one["diagnosis"] is not None]
    named = Counter(name for gap in gaps for name in gap["named"])
    tied = Counter(name for gap in gaps for name in {one for tie in gap["ties"] for one in tie})
    return {
        "schema": SCHEMA,
        "method": method,
        "diagnosed": diagnosed,
        "subjects": {name: dict(one) for name, one in subjects.items()},
        "population": {
            "n": len(done),
            "converged": sum(one["converged"] for one in done),
            "failed": sum(one["state"] == "failed" for one in subjects.values()),
            "waiting": sum(one["state"] == "waiting" for one in subjects.values()),
            **{kind: {use: _errors(done, kind, use) for use in USES} for kind in ("mae_Nm", "rmse_Nm")},
            "outcomes": dict(Counter(gap["outcome"] for gap in gaps).most_common()),
            "named": dict(named.most_common()),
            "tied": dict(tied.most_common()),
        },
        "versions": package_versions(),
    }


def errors_by_coordinate(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, list[float]]:
    """Gather one error (N m) a subject by coordinate, left and right alike; ``mean`` comes last."""
    found: dict[str, list[float]] = {}
    for one in subjects:
        for name, value in (one[kind][use] or {}).items():
            found.setdefault(name_without_side(name), []).append(value)
    return {name: found[name] for name in sorted(found, key=lambda name: name == "mean")}


def _errors(subjects: list[Mapping[str, Any]], kind: str, use: str) -> dict[str, dict[str, Any]]:
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
# Subjects of one coordinate side by side, over this part of its place.
_WIDTH = 0.28


@in_style
def population_figure(subjects: list[Mapping[str, Any]]) -> Figure:
    """Draw the mean absolute error (N m) of every subject by coordinate, and the median over subjects.

    Parameters
    ----------
    subjects
        Those that are done; at least one.
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
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return figure


@in_style
def outcomes_figure(population: Mapping[str, Any]) -> Figure:
    """Draw how diagnoses ended, and which effects they named or could not tell apart.

    Parameters
    ----------
    population
        Of ``cohort.json``; at least one diagnosis.
    """
    outcomes, effects = population["outcomes"], {**population["tied"], **population["named"]}
    named = [population["named"].get(name, 0) for name in effects]
    tied = [population["tied"].get(name, 0) for name in effects]
    rows = max(len(outcomes), len(effects))
    figure = new_figure(PAGE_WIDTH, 0.24 * rows + 1.1)
    left, right = figure.subplots(1, 2)
    left.barh(range(len(outcomes)), list(outcomes.values()), color=GRAY, height=0.6)
    left.set_yticks(range(len(outcomes)), [plain(name) for name in outcomes], parse_math=False)
    left.set_title("outcome", loc="left")
    right.barh(range(len(effects)), named, color=BLUE, height=0.6, label="named")
    right.barh(range(len(effects)), tied, left=named, color=BLUE, alpha=0.35, height=0.6, label="tied")
    right.set_yticks(range(len(effects)), [plain(name) for name in effects], parse_math=False)
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


_DASH = "\N{EN DASH}"


def render_cohort(content: dict[str, Any]) -> str:
    """Write the page of a cohort, with nothing outside it but links to its subjects' reports.

    Parameters
    ----------
    content
        From `describe_cohort`.
    """
    title = f"{counted(len(content['subjects']), 'subject')}: {content['method']} calibration"
    if content["diagnosed"]:
        title += " and diagnosis"
    done = [one for one in content["subjects"].values() if one["state"] == "done"]
    parts = [markup.header(title), _verdict(content)]
    if done:
        parts.append(_error_rows(content, done))
        if content["diagnosed"]:
            parts.append(_outcomes(content["population"]))
    parts.append(_subjects(content))
    notes = [
        "Every number is in cohort.json; each subject's own are in its folder.",
        f"{versions_in_words(content['versions'])}.",
    ]
    return markup.page(title, [*parts, markup.section("Notes", markup.bullets(notes))])


def _verdict(content: dict[str, Any]) -> str:
    population, subjects = content["population"], content["subjects"]
    lines = [
        f"{population['n']} of {counted(len(subjects), 'subject')} done, of which {population['converged']} "
        "converged."
    ]
    if population["waiting"]:
        lines.append(f"Still waiting when this was written: {population['waiting']}.")
    means = {use: population["mae_Nm"][use].get("mean") for use in USES}
    said = [
        f"{decimals(own['median'])} N m on {use} cycles ({decimals(own['min'])} to {decimals(own['max'])})"
        for use, own in means.items()
        if own is not None
    ]
    if said:
        lines.append(
            f"Modelled and measured joint moments of the median subject differ by {' and '.join(said)}."
        )
    failed = [f"{name}: {one['message']}" for name, one in subjects.items() if one["state"] == "failed"]
    more = []
    if failed:
        more = [markup.paragraph(f"{counted(len(failed), 'subject')} failed:"), markup.bullets(failed)]
    kind = "verdict failed" if failed or population["converged"] < population["n"] else "verdict"
    return markup.box("\n".join([*map(markup.paragraph, lines), *more]), kind)


def _error_rows(content: dict[str, Any], done: list[dict[str, Any]]) -> str:
    rows = []
    for use in USES:
        for name, own in content["population"]["mae_Nm"][use].items():
            numbers = (own[kind] for kind in ("mean", "sd", "min", "median", "max"))
            rows.append((f"{use}: {name}", str(own["n"]), *map(decimals, numbers)))
    return markup.section(
        "Moment errors over subjects",
        markup.picture(
            population_figure(done),
            alternative=f"Mean absolute moment errors of {counted(len(done), 'subject')} by coordinate.",
            caption="Mean absolute error of the joint moments in N m, one dot a subject, by coordinate (left "
            "and right legs alike) and their mean; bars: median over subjects.",
        ),
        markup.table(
            ("cycles and coordinate", "subjects", "mean", "sd", "least", "median", "largest"),
            rows,
            caption="Mean absolute errors in N m over subjects; sd is between subjects.",
        ),
    )


def _outcomes(population: dict[str, Any]) -> str:
    tables = [
        markup.table(
            ("outcome", "subjects"),
            [(plain(name), str(count)) for name, count in population["outcomes"].items()],
            caption="How diagnoses ended.",
        )
    ]
    effects = dict.fromkeys([*population["named"], *population["tied"]])
    if effects:
        rows = [
            (plain(name), str(population["named"].get(name, 0)), str(population["tied"].get(name, 0)))
            for name in effects
        ]
        tables.append(
            markup.table(
                ("effect", "named in", "tied in"),
                rows,
                caption="In how many subjects an effect explains the error best, or as well as others.",
            )
        )
    counts = ", ".join(f"{plain(name)} {count}" for name, count in population["outcomes"].items())
    drawn = markup.picture(
        outcomes_figure(population),
        alternative=f"Number of subjects by outcome of the diagnosis: {counts}.",
        caption="How diagnoses ended, and in how many subjects an effect explains the error best (named) or "
        "as well as others (tied): leads, never proofs of cause.",
    )
    return markup.section("Diagnoses", drawn, *tables)


def _subjects(content: dict[str, Any]) -> str:
    header = ["subject", "calibration", "validation", "result"]
    if content["diagnosed"]:
        header.append("diagnosis")
    rows = [_row(name, one, content["diagnosed"]) for name, one in content["subjects"].items()]
    return markup.section(
        "Subject by subject",
        markup.table(
            header,
            rows,
            caption="Mean absolute errors of joint moments in N m, averaged over coordinates. Names lead to "
            "reports.",
        ),
    )


def _row(name: str, one: dict[str, Any], diagnosed: bool) -> tuple[str, ...]:
    if one["state"] != "done":
        return (name, _DASH, _DASH, one["state"], *([_DASH] if diagnosed else []))
    means = (decimals(None if one["mae_Nm"][use] is None else one["mae_Nm"][use]["mean"]) for use in USES)
    result = "converged" if one["converged"] else "did not converge"
    row = (markup.Link(name, one["report"]), *means, result)
    gap = one["diagnosis"]
    if not diagnosed:
        return row
    if gap is None:
        return (*row, _DASH)
    effects = gap["named"] or [member for tie in gap["ties"] for member in tie]
    said = plain(gap["outcome"]) + (f": {', '.join(map(plain, effects))}" if effects else "")
    return (*row, markup.Link(said, one["diagnosis_report"]))


def write_content(content: dict[str, Any], folder: Path) -> None:
    """Write ``cohort.json``."""
    write_json(folder / "cohort.json", content)


def write_page(content: dict[str, Any], folder: Path) -> None:
    """Write ``report.html``, of which everything is in ``cohort.json``."""
    write_text(folder / "report.html", render_cohort(content))
