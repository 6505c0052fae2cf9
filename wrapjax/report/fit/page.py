"""The report of a fit: one page that opens anywhere, offline."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

from wrapjax.report import markup
from wrapjax.report.fit.cylinders import cylinder_findings, cylinders_section, pictures_section
from wrapjax.report.fit.errors import error_findings, errors_section, unusual
from wrapjax.report.physiological_figure import SampledPath
from wrapjax.report.provenance import made_with
from wrapjax.report.wording import counted
from wrapjax.subject import Subject

_SOURCES = {
    "opensim": "OpenSim's muscle analysis",
    "engine": "the exact engine, wrapping the shortest way",
    "engine-parity": "the exact engine, wrapping as OpenSim does",
}
_STAGES = {
    "analysis": "analysing muscle paths in all poses",
    "fit": "fitting polynomials",
    "contact": "finding which muscles touch a surface",
    "boxes": "finding boxes for cylinders",
    "sampling": "sampling cylinders",
    "feasibility": "learning their limits",
}


def render_fit(content: dict[str, Any], subject: Subject | None, paths: Iterable[SampledPath] = ()) -> str:
    """Write the report of a fit as one HTML page with nothing outside it.

    Parameters
    ----------
    content
        Of ``fit.json``.
    subject
        Whose fit it is, if that is known.
    paths
        What is drawn of sampled paths, one muscle at a time.
    """
    title = "Muscle paths as polynomials"
    if subject is not None:
        title = f"{subject.name}: muscle paths as polynomials"
    under = (
        f"{counted(len(content['muscles']), 'muscle')}, {len(content['touching'])} of them on a wrapping "
        f"surface in some recorded frame. Paths from {_source(content)}. "
        f"{datetime.now(UTC).date().isoformat()}."
    )
    return markup.page(
        title,
        [
            markup.header(title, under),
            _verdict(content),
            errors_section(content),
            cylinders_section(content),
            pictures_section(content, paths),
            _notes(content, subject),
        ],
    )


def _verdict(content: dict[str, Any]) -> str:
    said = [*error_findings(content), *cylinder_findings(content)]
    return markup.verdict(said, fine=not unusual(content))


def _notes(content: dict[str, Any], subject: Subject | None) -> str:
    seconds = content["seconds"]
    lines = [
        f"Lengths and moment arms, which errors are held against too, from {_source(content)}; random "
        f"poses and placements by seed {content['seed']}.",
        f"Touching a surface in the recorded cycles: {', '.join(content['touching']) or 'none'}.",
        f"This page: {made_with()}.",
        "Numbers for programs are in fit.json, coefficients and limits in fit.npz.",
    ]
    if subject is not None:
        lines.insert(0, f"Subject folder {subject.folder.name}, model {subject.model_file.name}.")
    return markup.section(
        "How it was made",
        markup.bullets(lines),
        markup.table(
            ("step", "seconds"),
            [
                *((_STAGES.get(stage, stage), f"{own:.1f}") for stage, own in seconds.items()),
                ("together", f"{sum(seconds.values()):.1f}"),
            ],
            caption="How long it took when it was made; the same question is answered from the cache.",
            total=True,
        ),
    )


def _source(content: dict[str, Any]) -> str:
    return _SOURCES.get(content["geometry"], content["geometry"])
