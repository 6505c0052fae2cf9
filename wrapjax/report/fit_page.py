"""How well a fit's polynomials follow muscle paths: words, figure and table.

The report of a fit: one page that opens anywhere, offline.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from wrapjax.report import markup
from wrapjax.report.fit_wraps import SampledPath, cylinder_findings, cylinders_section, pictures_section
from wrapjax.report.provenance import made_with
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    counted,
    in_style,
    new_figure,
)
from wrapjax.subject.subject import Subject

#: Root mean square errors of length and moment arm (mm) that polynomials of a leg's paths hardly exceed,
#: moved cylinders included.
USUAL_MM = {"length": 0.4, "moment_arm": 0.8}

_QUANTITIES = {"length": "length", "moment_arm": "moment arm"}
# Whole where they stand on an axis.
_DOT: dict[str, Any] = {"markersize": 4.2, "zorder": 3, "clip_on": False}
# Smaller errors (mm) are called just that.
_LEAST_MM = 1e-3


def unusual(content: dict[str, Any]) -> list[str]:
    """Name the muscles whose error exceeds the usual, in length or moment arm."""
    return [
        name
        for name, error in content["muscles"].items()
        if any(not error[f"{quantity}_rmse_mm"] <= limit for quantity, limit in USUAL_MM.items())
    ]


def error_findings(content: dict[str, Any]) -> list[str]:
    """Say in plain sentences how well polynomials follow the paths."""
    muscles = content["muscles"]
    above = unusual(content)
    first = f"Polynomials follow the paths of {counted(len(muscles), 'muscle')} as closely as usual."
    if above:
        first = (
            f"Polynomials follow the paths of {len(muscles) - len(above)} of "
            f"{counted(len(muscles), 'muscle')} as closely as usual, but not of {', '.join(above)}."
        )
    wrapped = [name for name, error in muscles.items() if error["wrapped"]]
    straight = [name for name in muscles if name not in wrapped]
    parts = [f"Root mean square errors {_unseen(content)}."]
    for names, words in ((wrapped, "Muscles that may wrap"), (straight, "Muscles that never wrap")):
        if names:
            parts.append(f"{words} ({len(names)}): {_median_and_worst(muscles, names)}.")
    parts.append(
        f"Usual are up to {USUAL_MM['length']:g} mm in length and {USUAL_MM['moment_arm']:g} mm in moment "
        "arm; moment arms of a leg are some centimeters."
    )
    return [first, " ".join(parts)]


def _median_and_worst(muscles: dict[str, Any], names: list[str]) -> str:
    """Give median and worst errors of some muscles, in short if all are small."""
    parts = []
    for quantity, words in _QUANTITIES.items():
        errors = {name: muscles[name][f"{quantity}_rmse_mm"] for name in names}
        worst = max(errors, key=errors.__getitem__)
        highest = _number(errors[worst])
        if errors[worst] < 0.1 * USUAL_MM[quantity]:
            parts.append(f"{words} {'' if highest.startswith('<') else 'at most '}{highest} mm")
        else:
            median = _number(float(np.median(list(errors.values()))))
            parts.append(f"{words} {median} mm in the median and {highest} mm at worst ({worst})")
    return ", ".join(parts)


def _unseen(content: dict[str, Any]) -> str:
    """Say what errors are measured on."""
    if content["wraps"]:
        return "in poses and at placements of cylinders that fitting has not seen"
    return "in poses that fitting has not seen"


def errors_section(content: dict[str, Any]) -> str:
    """Write the part of the report on errors."""
    wraps_of = content["wraps_of"] or {}
    order = _worst_first(content)
    caption = (
        f"Root mean square errors {_unseen(content)}, in mm; moment arms pooled over the coordinates that "
        "the muscle spans. Dashed: usual up to there. Largest error of a moment arm first."
    )
    rows = []
    for name in order:
        error = content["muscles"][name]
        rows.append(
            (
                name,
                ", ".join(wraps_of.get(name, ())) or ("a surface" if error["wrapped"] else "\N{EN DASH}"),
                str(error["terms"]),
                *(
                    _number(error[f"{quantity}_{kind}_mm"])
                    for quantity in _QUANTITIES
                    for kind in ("rmse", "max")
                ),
            )
        )
    return markup.section(
        "Errors by muscle",
        markup.picture(
            error_figure(content),
            alternative=f"Errors of length and moment arm of {counted(len(order), 'muscle')}; that of the "
            f"moment arms of {order[0]} is largest.",
            caption=caption,
        ),
        markup.table(
            ("muscle", "wraps round", "terms", "length: RMSE", "largest", "moment arm: RMSE", "largest"),
            rows,
            caption="Errors in mm, root mean square and largest, and the number of terms of each polynomial. "
            + (
                "Those of muscles with cylinders are over placements that leave their paths physiological."
                if content["wraps"]
                else "Cylinders are where the model has them."
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
        panel.axvline(usual, color=VERMILION, linewidth=0.9, linestyle="--", zorder=1, label="usual, up to")
        panel.hlines(rows, 0.0, errors, color=LIGHT_GRAY, linewidth=1.4, zorder=0)
        for kind, color, label in ((wrapped, BLUE, "may wrap"), (~wrapped, GRAY, "never wraps")):
            if kind.any():
                panel.plot(errors[kind], rows[kind], "o", color=color, label=label, **_DOT)
        panel.set_xlim(0.0, 1.06 * max(usual, float(np.nanmax(errors, initial=0.0))))
        panel.set_xlabel(f"error of {words} (mm)")
        panel.tick_params(axis="y", length=0, pad=6)
    panels[0].set_yticks(rows, order, parse_math=False)
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


def _worst_first(content: dict[str, Any]) -> list[str]:
    muscles = content["muscles"]
    return sorted(muscles, key=lambda name: -muscles[name]["moment_arm_rmse_mm"])


def _number(millimeters: float) -> str:
    return f"< {_LEAST_MM:g}" if millimeters < _LEAST_MM else f"{millimeters:.3f}"


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
