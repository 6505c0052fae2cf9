"""Report of initial fiber and tendon lengths as a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.initial_lengths import LONGEST_FIBER_BOUNDS, SHORTEST_FIBER
from wrapjax.report import markup
from wrapjax.report.formatting import counted, decimals
from wrapjax.report.provenance import versions_in_words
from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    PAGE_WIDTH,
    PALE_BLUE,
    Figure,
    draw_zero_line,
    in_style,
    label_rows,
    legend_above,
    new_figure,
    panel_grid,
)


@dataclass(frozen=True)
class PassiveCurves:
    """Passive moment about one coordinate while an examiner moved the leg.

    Parameters
    ----------
    trial, coordinate
        Names of the passive trial and the coordinate.
    angle
        Angle of the coordinate, degrees; None if it was not moved.
    measured, before, after
        Moments in N m: measured, and modelled with the model's and with the estimated lengths.
    """

    trial: str
    coordinate: str
    angle: Float[np.ndarray, " sample"] | None
    measured: Float[np.ndarray, " sample"]
    before: Float[np.ndarray, " sample"]
    after: Float[np.ndarray, " sample"]


@in_style
def passive_figure(curves: Sequence[PassiveCurves]) -> Figure:
    """Draw measured and modelled passive moments over the joint angle, one panel a moment."""
    columns = min(3, len(curves))
    figure, panels = panel_grid(len(curves), columns, width=PAGE_WIDTH, panel_height=2.1)
    for number, (panel, curve) in enumerate(zip(panels, curves, strict=True)):
        moved = curve.angle is not None
        place = curve.angle if moved else np.arange(curve.measured.size)
        draw_zero_line(panel)
        panel.plot(place, curve.measured, ".", color=BLACK, markersize=3.5, label="measured")
        panel.plot(place, curve.before, color=GRAY, label="before")
        panel.plot(place, curve.after, color=BLUE, label="after")
        panel.set_title(f"{curve.trial}: {curve.coordinate}", loc="left", parse_math=False)
        panel.set_xlabel(f"{curve.coordinate} (deg)" if moved else "sample", parse_math=False)
        if number % columns == 0:
            panel.set_ylabel("moment (N m)")
    legend_above(figure, panels[0])
    return figure


@in_style
def range_figure(muscles: Mapping[str, Any], shortest: float, longest: tuple[float, float]) -> Figure:
    """Draw ranges of normalised fiber length in walking, before and after, one row a muscle.

    Parameters
    ----------
    muscles
        ``muscles`` of ``initialisation.json``.
    shortest, longest
        Lower limit of normalised fiber lengths, and expected range of each muscle's greatest one.
    """
    figure = new_figure(PAGE_WIDTH, 0.2 * len(muscles) + 1.2)
    panel = figure.subplots()
    panel.axvspan(*longest, color=PALE_BLUE, zorder=0, label="expected range of the greatest length")
    panel.axvline(shortest, color=GRAY, linewidth=0.8, linestyle="--", zorder=1, label="lower limit")
    rows = np.arange(len(muscles))
    for when, shift, color in (("before", -0.17, GRAY), ("after", 0.17, BLUE)):
        ends = np.array([muscle["normalized_fiber_length"][when] for muscle in muscles.values()])
        panel.hlines(rows + shift, *ends.T, color=color, linewidth=2.2, label=when)
    label_rows([panel], list(muscles))
    panel.set_xlabel("fiber length / optimal fiber length")
    legend_above(figure, panel)
    return figure


def render_initialisation(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    """Write the report of initial lengths as a self-contained HTML page.

    Parameters
    ----------
    content
        Content of ``initialisation.json``.
    passive
        Measured and modelled passive moments; empty if none were recorded.
    """
    title = f"{content['subject']}: initial fiber and tendon lengths"
    parts = [
        markup.header(title, f"{counted(len(content['muscles']), 'muscle')}."),
        _verdict_section(content),
    ]
    if passive:
        parts.append(_passive_section(content, passive))
    parts += [_lengths_section(content), _notes_section()]
    return markup.page(title, parts)


def _verdict_section(content: dict[str, Any]) -> str:
    fine = content["converged"]
    first = (
        "The estimation of lengths converged."
        if fine
        else f"The estimation of lengths did not converge, so they are not final. {content['message']}"
    )
    errors = [
        f"Modelled and measured passive moments about {name} differ by {decimals(error['after'])} N m on "
        f"average, with the model's own lengths by {decimals(error['before'])} N m."
        for name, error in content["passive_mae_Nm"].items()
    ]
    return markup.verdict([first, *errors, *content["notes"]], fine=fine)


def _passive_section(content: dict[str, Any], passive: Sequence[PassiveCurves]) -> str:
    return markup.section(
        "Passive moments",
        markup.picture(
            passive_figure(passive),
            alternative="Measured passive moments over the joint angle, and modelled moments of relaxed "
            "muscles.",
            caption="Moments while an examiner moved the leg: measured (dots), and modelled for relaxed "
            "muscles with the model's lengths (gray) and with the estimated lengths (blue).",
        ),
        markup.table(
            ("coordinate", "before", "after"),
            [
                (name, decimals(error["before"]), decimals(error["after"]))
                for name, error in content["passive_mae_Nm"].items()
            ],
            caption="Mean absolute error in N m.",
        ),
    )


def _lengths_section(content: dict[str, Any]) -> str:
    rows = []
    for muscle, lengths in content["muscles"].items():
        cells = [muscle]
        for name in ("optimal_fiber_length_m", "tendon_slack_length_m"):
            pair = lengths[name]
            cells += [f"{1e3 * pair['before']:.1f}", f"{1e3 * pair['after']:.1f}"]
            cells.append(f"{100.0 * (pair['after'] / pair['before'] - 1.0):.0f}")
        rows.append(cells)
    header = [
        f"{kind}, {stage}" for kind in ("fiber", "slack") for stage in ("before", "after", "change (%)")
    ]
    return markup.section(
        "Lengths",
        markup.picture(
            range_figure(content["muscles"], SHORTEST_FIBER, LONGEST_FIBER_BOUNDS),
            alternative="Range of normalised fiber lengths in walking, before and after, by muscle.",
            caption="Range of normalised fiber length in walking, with the model's lengths (gray) and with "
            "the estimated lengths (blue).",
        ),
        markup.table(("muscle", *header), rows, caption="Optimal fiber and tendon slack lengths in mm."),
    )


def _notes_section() -> str:
    return markup.section(
        "Notes",
        markup.bullets(
            [
                "To calibrate with these lengths as initial values, enter muscle_parameters.csv in "
                "subject.toml under [model].",
                "Maximal isometric forces and pennation angles are those of the model.",
                f"{versions_in_words()}.",
            ]
        ),
    )
