"""Report of a surrogate fit as a self-contained HTML page: errors of the polynomials by muscle."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wrapjax.report import markup
from wrapjax.report.formatting import DASH, counted
from wrapjax.report.paths.fit_wraps import (
    SampledPath,
    sampled_paths_section,
    surface_findings,
    surfaces_section,
)
from wrapjax.report.provenance import versions_platform_and_time
from wrapjax.report.style import (
    BLUE,
    DOT,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    in_style,
    label_rows,
    legend_above,
    new_figure,
)
from wrapjax.subject.subject import Subject

#: Usual upper limits of the root mean square errors of length and moment arm (mm) of a leg's polynomials,
#: including displaced wrapping surfaces.
USUAL_MM = {"length": 0.4, "moment_arm": 0.8}

_QUANTITIES = {"length": "length", "moment_arm": "moment arm"}
# Smaller errors (mm) are shown as less than this value.
_LEAST_MM = 1e-3


def unusual_muscles(content: dict[str, Any]) -> list[str]:
    """List the muscles whose error of length or moment arm exceeds the usual limits."""
    return [
        name
        for name, error in content["muscles"].items()
        if any(not error[f"{quantity}_rmse_mm"] <= limit for quantity, limit in USUAL_MM.items())
    ]


def error_findings(content: dict[str, Any]) -> list[str]:
    """Write sentences on the errors of the polynomials."""
    muscles = content["muscles"]
    above = unusual_muscles(content)
    first = (
        f"The polynomials approximate the paths of {counted(len(muscles), 'muscle')} with the usual accuracy."
    )
    if above:
        first = (
            f"The polynomials approximate the paths of {len(muscles) - len(above)} of "
            f"{counted(len(muscles), 'muscle')} with the usual accuracy; errors are larger for "
            f"{', '.join(above)}."
        )
    wrapped = [name for name, error in muscles.items() if error["wrapped"]]
    straight = [name for name in muscles if name not in wrapped]
    parts = [f"Root mean square errors {_test_samples(content)}."]
    for names, words in ((wrapped, "Muscles that may wrap"), (straight, "Muscles that never wrap")):
        if names:
            parts.append(f"{words} ({len(names)}): {_median_and_worst(muscles, names)}.")
    parts.append(
        f"Usual errors are up to {USUAL_MM['length']:g} mm in length and {USUAL_MM['moment_arm']:g} mm in "
        "moment arm; the moment arms of a leg are a few centimeters."
    )
    return [first, " ".join(parts)]


def _median_and_worst(muscles: dict[str, Any], names: list[str]) -> str:
    """Write median and largest errors of some muscles; only the largest if all are small."""
    parts = []
    for quantity, words in _QUANTITIES.items():
        errors = {name: muscles[name][f"{quantity}_rmse_mm"] for name in names}
        worst = max(errors, key=errors.__getitem__)
        highest = _millimeters(errors[worst])
        if errors[worst] < 0.1 * USUAL_MM[quantity]:
            parts.append(f"{words} {'' if highest.startswith('<') else 'at most '}{highest} mm")
        else:
            median = _millimeters(float(np.median(list(errors.values()))))
            parts.append(f"{words} median {median} mm, largest {highest} mm ({worst})")
    return ", ".join(parts)


def _test_samples(content: dict[str, Any]) -> str:
    """Write on which samples errors were computed."""
    if content["wraps"]:
        return "in poses and at placements of wrapping surfaces that were held out from fitting"
    return "in poses that were held out from fitting"


def errors_section(content: dict[str, Any]) -> str:
    """Write the report section on errors by muscle."""
    wraps_of = content["wraps_of"] or {}
    order = _worst_first(content)
    caption = (
        f"Root mean square errors {_test_samples(content)}, in mm; moment arms pooled over the coordinates "
        "that the muscle spans. Dashed: usual upper limit. Muscles are ordered by their error of the moment "
        "arm."
    )
    rows = []
    for name in order:
        error = content["muscles"][name]
        rows.append(
            (
                name,
                ", ".join(wraps_of.get(name, ())) or ("a surface" if error["wrapped"] else DASH),
                str(error["terms"]),
                *(
                    _millimeters(error[f"{quantity}_{kind}_mm"])
                    for quantity in _QUANTITIES
                    for kind in ("rmse", "max")
                ),
            )
        )
    return markup.section(
        "Errors by muscle",
        markup.picture(
            error_figure(content),
            alternative=f"Errors of length and moment arm of {counted(len(order), 'muscle')}; the error of "
            f"the moment arms of {order[0]} is largest.",
            caption=caption,
        ),
        markup.table(
            ("muscle", "wraps round", "terms", "length: RMSE", "largest", "moment arm: RMSE", "largest"),
            rows,
            caption="Errors in mm, root mean square and largest, and the number of terms of each polynomial. "
            + (
                "Errors of muscles with wrapping surfaces are over placements at which their paths are "
                "physiological."
                if content["wraps"]
                else "Wrapping surfaces are at their nominal placement."
            ),
        ),
    )


@in_style
def error_figure(content: dict[str, Any]) -> Figure:
    """Draw errors of length and moment arm, one row a muscle."""
    muscles, order = content["muscles"], _worst_first(content)
    wrapped = np.array([muscles[name]["wrapped"] for name in order])
    rows = np.arange(len(order))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(rows) + 1.2)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (quantity, words) in zip(panels, _QUANTITIES.items(), strict=True):
        errors = np.array([muscles[name][f"{quantity}_rmse_mm"] for name in order])
        usual = USUAL_MM[quantity]
        panel.axvline(
            usual, color=VERMILION, linewidth=0.9, linestyle="--", zorder=1, label="usual upper limit"
        )
        panel.hlines(rows, 0.0, errors, color=LIGHT_GRAY, linewidth=1.4, zorder=0)
        for kind, color, label in ((wrapped, BLUE, "may wrap"), (~wrapped, GRAY, "never wraps")):
            if kind.any():
                panel.plot(errors[kind], rows[kind], "o", color=color, label=label, **DOT)
        panel.set_xlim(0.0, 1.06 * max(usual, float(np.nanmax(errors, initial=0.0))))
        panel.set_xlabel(f"error of {words} (mm)")
        panel.tick_params(axis="y", pad=6)
    label_rows(panels, order)
    legend_above(figure, panels[0])
    return figure


def _worst_first(content: dict[str, Any]) -> list[str]:
    muscles = content["muscles"]
    return sorted(muscles, key=lambda name: -muscles[name]["moment_arm_rmse_mm"])


def _millimeters(millimeters: float) -> str:
    return f"< {_LEAST_MM:g}" if millimeters < _LEAST_MM else f"{millimeters:.3f}"


_SOURCES = {
    "opensim": "OpenSim's muscle analysis",
    "engine": "the exact engine with shortest paths",
    "engine-parity": "the exact engine with OpenSim's wrapping",
}
_STAGES = {
    "analysis": "computing muscle paths in all poses",
    "fit": "fitting polynomials",
    "contact": "determining which muscles touch a surface",
    "boxes": "determining bounds of wrapping surfaces",
    "sampling": "sampling placements of wrapping surfaces",
    "feasibility": "fitting feasibility limits",
}


def render_fit(
    content: dict[str, Any],
    subject: Subject | None,
    paths: Iterable[SampledPath] = (),
    link: str = "",
) -> str:
    """Write the report of a fit as a self-contained HTML page.

    Parameters
    ----------
    content
        Content of ``fit.json``.
    subject
        Subject of the fit, if known.
    paths
        Sampled paths to draw, one muscle at a time.
    link
        HTML below the title, such as a link to another page.
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
            link,
            markup.verdict(
                [*error_findings(content), *surface_findings(content)], fine=not unusual_muscles(content)
            ),
            errors_section(content),
            surfaces_section(content),
            sampled_paths_section(content, paths),
            _methods_section(content, subject),
        ],
    )


def _methods_section(content: dict[str, Any], subject: Subject | None) -> str:
    seconds = content["seconds"]
    lines = [
        "Lengths and moment arms, for fitting and as the reference of the errors, are from "
        f"{_source(content)}; random poses and placements have seed {content['seed']}.",
        f"Muscles that touch a surface in the recorded cycles: {', '.join(content['touching']) or 'none'}.",
        f"This page: {versions_platform_and_time()}.",
        "All numbers are in fit.json in machine-readable form, coefficients and limits in fit.npz.",
    ]
    if subject is not None:
        lines.insert(0, f"Subject folder {subject.folder.name}, model {subject.model_file.name}.")
    return markup.section(
        "Methods",
        markup.bullets(lines),
        markup.table(
            ("step", "seconds"),
            [
                *((_STAGES.get(stage, stage), f"{time:.1f}") for stage, time in seconds.items()),
                ("total", f"{sum(seconds.values()):.1f}"),
            ],
            caption="Computing time of the fit; a repeated fit with the same inputs is read from the cache.",
            total=True,
        ),
    )


def _source(content: dict[str, Any]) -> str:
    return _SOURCES.get(content["geometry"], content["geometry"])
