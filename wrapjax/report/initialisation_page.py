"""Figures of lengths to start from: passive moments, and where fibers work in walking.

The page of lengths to start from, as one HTML file that opens anywhere, offline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.initial_lengths import LONGEST, SHORTEST
from wrapjax.report import markup
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Figure,
    counted,
    decimals,
    in_style,
    new_figure,
    panel_grid,
)


@dataclass(frozen=True)
class PassiveCurves:
    """The moment about one coordinate while somebody else moved the leg.

    Parameters
    ----------
    trial, coordinate
        Names.
    angle
        Of that coordinate, degrees; None where it was not moved.
    measured, before, after
        Moments in N m: recorded, by the model's lengths, by those found.
    """

    trial: str
    coordinate: str
    angle: Float[np.ndarray, " sample"] | None
    measured: Float[np.ndarray, " sample"]
    before: Float[np.ndarray, " sample"]
    after: Float[np.ndarray, " sample"]


@in_style
def passive_figure(curves: Sequence[PassiveCurves]) -> Figure:
    """Draw recorded and modelled passive moments over the joint's angle, one panel a moment."""
    columns = min(3, len(curves))
    figure, panels = panel_grid(len(curves), columns, width=PAGE_WIDTH, panel_height=2.1)
    for number, (panel, own) in enumerate(zip(panels, curves, strict=True)):
        moved = own.angle is not None
        place = own.angle if moved else np.arange(own.measured.size)
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.plot(place, own.measured, ".", color=BLACK, markersize=3.5, label="recorded")
        panel.plot(place, own.before, color=GRAY, label="before")
        panel.plot(place, own.after, color=BLUE, label="after")
        panel.set_title(f"{own.trial}: {own.coordinate}", loc="left", parse_math=False)
        panel.set_xlabel(f"{own.coordinate} (deg)" if moved else "sample", parse_math=False)
        if number % columns == 0:
            panel.set_ylabel("moment (N m)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@in_style
def range_figure(muscles: Mapping[str, Any], shortest: float, longest: tuple[float, float]) -> Figure:
    """Draw where fibers work in walking, before and after, one row a muscle.

    Parameters
    ----------
    muscles
        Of ``initialisation.json``.
    shortest, longest
        Normalised length that fibers should stay above, and between which they should end.
    """
    figure = new_figure(PAGE_WIDTH, 0.2 * len(muscles) + 1.2)
    panel = figure.subplots()
    panel.axvspan(*longest, color="#F1F6FA", zorder=0, label="where the longest should be")
    panel.axvline(shortest, color=GRAY, linewidth=0.8, linestyle="--", zorder=1, label="should stay above")
    rows = np.arange(len(muscles))
    for when, shift, color in (("before", -0.17, GRAY), ("after", 0.17, BLUE)):
        ends = np.array([own["normalized_fiber_length"][when] for own in muscles.values()])
        panel.hlines(rows + shift, *ends.T, color=color, linewidth=2.2, label=when)
    panel.set_yticks(rows, list(muscles), parse_math=False)
    panel.set_ylim(len(muscles) - 0.4, -0.6)
    panel.set_xlabel("fiber length / optimal fiber length")
    panel.tick_params(axis="y", length=0)
    figure.legend(loc="outside upper left", ncols=4)
    return figure


def render_initialisation(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    """Write what lengths were found, and why, as a page with nothing outside it.

    Parameters
    ----------
    content
        Of ``initialisation.json``.
    passive
        Recorded and modelled passive moments; empty where none were recorded.
    """
    title = f"{content['subject']}: lengths to start from"
    parts = [
        markup.header(title, f"Of {counted(len(content['muscles']), 'muscle')}."),
        _verdict(content),
    ]
    if passive:
        parts.append(_passive_section(content, passive))
    parts += [_lengths_section(content), _notes()]
    return markup.page(title, parts)


def _verdict(content: dict[str, Any]) -> str:
    fine = content["converged"]
    first = "Lengths were found." if fine else f"Lengths are not final. {content['message']}"
    errors = [
        f"Passive moments about {name} are missed by {decimals(own['after'])} N m on average, by "
        f"{decimals(own['before'])} N m with the model's own lengths."
        for name, own in content["passive_mae_Nm"].items()
    ]
    said = [*errors, *content["notes"]]
    return markup.verdict([first, *said], fine=fine)


def _passive_section(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    return markup.section(
        "Passive moments",
        markup.picture(
            passive_figure(passive),
            alternative="Recorded passive moments over the joint's angle, and what muscles at rest make.",
            caption="Moments while somebody else moved the leg: recorded, and what muscles at rest make with "
            "the model's lengths (gray) and with those found (blue).",
        ),
        markup.table(
            ("coordinate", "before", "after"),
            [
                (name, decimals(own["before"]), decimals(own["after"]))
                for name, own in content["passive_mae_Nm"].items()
            ],
            caption="Mean absolute error in N m.",
        ),
    )


def _lengths_section(content: dict[str, Any]) -> str:
    rows = []
    for muscle, own in content["muscles"].items():
        cells = [muscle]
        for name in ("optimal_fiber_length_m", "tendon_slack_length_m"):
            pair = own[name]
            cells += [f"{1e3 * pair['before']:.1f}", f"{1e3 * pair['after']:.1f}"]
            cells.append(f"{100.0 * (pair['after'] / pair['before'] - 1.0):.0f}")
        rows.append(cells)
    header = [f"{kind}, {what}" for kind in ("fiber", "slack") for what in ("before", "after", "change (%)")]
    return markup.section(
        "Lengths",
        markup.picture(
            range_figure(content["muscles"], SHORTEST, LONGEST),
            alternative="Range of normalised fiber lengths in walking, before and after, by muscle.",
            caption="Shortest to longest normalised fiber length in walking, with the model's lengths (gray) "
            "and with those found (blue).",
        ),
        markup.table(("muscle", *header), rows, caption="Optimal fiber and tendon slack lengths in mm."),
    )


def _notes() -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                "Name muscle_parameters.csv in subject.toml, under [model], to calibrate from these.",
                "Strengths and pennation stay what the model says.",
                f"{versions_in_words()}.",
            ]
        ),
    )
