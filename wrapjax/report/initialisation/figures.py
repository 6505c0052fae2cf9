"""Figures of lengths to start from: passive moments, and where fibers work in walking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.report.style import (
    BLACK,
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Figure,
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
