"""The page of a cohort: everything on it is in ``cohort.json``."""

from __future__ import annotations

from typing import Any

from wrapjax.report import markup
from wrapjax.report.cohort.figure import outcomes_figure, population_figure
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.summary import USES
from wrapjax.report.wording import counted, decimals, plain

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
        parts.append(_errors(content, done))
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


def _errors(content: dict[str, Any], done: list[dict[str, Any]]) -> str:
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
