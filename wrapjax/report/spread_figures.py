"""Figures of uncertainty: intervals of parameters, bands of moments."""

from __future__ import annotations

import numpy as np

from wrapjax.calibrate import CalibrationResult, LegSpread
from wrapjax.geometry.surfaces import NOMINAL
from wrapjax.report.cycles import groups_by_speed_and_use, mark_gait_cycle
from wrapjax.report.style import (
    BLACK,
    BLUE,
    LIGHT_GRAY,
    PAGE_WIDTH,
    Figure,
    in_style,
    new_figure,
    panel_grid,
)

_PALE = "#9CC7E4"


def kinds_of(result: CalibrationResult, spread: LegSpread) -> dict[str, list[str]]:
    """Give the owners of parameters with bounds, by kind: muscles, cylinders."""
    wraps = () if result.freedom.wraps is None else result.freedom.wraps.names
    kinds = {"muscle": list(result.muscles), "cylinder": list(wraps)}
    owners = {label.rsplit(".", 1)[0] for label in spread.parameters.labels}
    named = {kind: [name for name in names if name in owners] for kind, names in kinds.items()}
    return {kind: names for kind, names in named.items() if names}


@in_style
def interval_figure(result: CalibrationResult, spread: LegSpread, owners: list[str]) -> Figure:
    """Draw each parameter's 90 % interval between its bounds: one column a parameter, one row an owner."""
    own = spread.parameters
    bounds = _bounds(result)
    places = {label: place for place, label in enumerate(own.labels)}
    names = list(
        dict.fromkeys(label.rsplit(".", 1)[1] for label in bounds if label.rsplit(".", 1)[0] in owners)
    )
    rows = np.arange(len(owners))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(owners) + 1.9)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(panels, names, strict=True):
        panel.set_title(name.replace("_", "\n", 1).replace("_", " "))
        panel.set_xlim(-0.06, 1.06)
        panel.set_xticks([0.0, 1.0], ["lower", "upper"])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
        here = np.array([row for row in rows if f"{owners[row]}.{name}" in places])
        at = [places[f"{owners[row]}.{name}"] for row in here]
        lower, upper = np.array([bounds[own.labels[place]] for place in at]).T
        width = np.where(upper > lower, upper - lower, 1.0)
        value, low, high = ((part[at] - lower) / width for part in (own.value, own.low, own.high))
        half = 1.645 * own.prior_deviation[at] / width  # as wide as 90 % of a normal distribution
        told = own.identified[at]
        panel.hlines(
            here,
            (value - half).clip(0.0),
            (value + half).clip(None, 1.0),
            color=LIGHT_GRAY,
            linewidth=6.0,
            zorder=0,
            label="without moments",
        )
        for chosen, color, face, text in (
            (told, BLUE, BLUE, "moments narrow it"),
            (~told, _PALE, "white", "they hardly do"),
        ):
            panel.hlines(here[chosen], low[chosen], high[chosen], color=color, linewidth=1.6, zorder=1)
            panel.plot(
                value[chosen],
                here[chosen],
                "o",
                markerfacecolor=face,
                markeredgecolor=BLUE,
                markersize=3.6,
                label=text,
                zorder=2,
            )
    panels[0].set_yticks(rows, owners, parse_math=False)
    panels[0].set_ylim(len(owners) - 0.4, -0.6)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@in_style
def band_figure(result: CalibrationResult, spread: LegSpread) -> Figure:
    """Draw measured and modelled moments with the band of the draws, means over cycles of a kind."""
    groups = groups_by_speed_and_use(result, most_speeds=2)
    count = len(result.coordinates) * len(groups)
    figure, panels = panel_grid(
        count,
        len(groups),
        width=PAGE_WIDTH if len(groups) > 1 else PAGE_WIDTH / 2,
        panel_height=1.6,
        sharex=True,
        sharey="row",
    )
    percent = np.linspace(0.0, 100.0, result.measured.shape[-1])
    for number, panel in enumerate(panels):
        row, column = divmod(number, len(groups))
        keep = groups[column].keep
        measured, modelled, low, high = (
            part[keep, row].mean(axis=0)
            for part in (result.measured, result.modelled, spread.low, spread.high)
        )
        panel.axhline(0.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.fill_between(percent, low, high, color=BLUE, alpha=0.3, linewidth=0, label="90 % of draws")
        panel.plot(percent, measured, color=BLACK, label="measured")
        panel.plot(percent, modelled, color=BLUE, label="modelled")
        panel.set_title(result.coordinates[row], loc="left", parse_math=False)
        if groups[column].label and row == 0:
            panel.annotate(
                f"{groups[column].label} ({groups[column].count})",
                (0.0, 1.0),
                xytext=(0, 18),
                xycoords="axes fraction",
                textcoords="offset points",
                fontweight="bold",
            )
        if column == 0:
            panel.set_ylabel("moment (N m)")
        if number >= count - len(groups):
            panel.set_xlabel("gait cycle (%)")
        mark_gait_cycle(panel, step=20)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def _bounds(result: CalibrationResult) -> dict[str, tuple[float, float]]:
    """Give the bounds of muscles' and cylinders' parameters, SI units; modes of paths have none."""
    found = {
        f"{muscle}.{parameter.name}": (float(parameter.lower[row]), float(parameter.upper[row]))
        for row, muscle in enumerate(result.muscles)
        for parameter in result.freedom.parameters
    }
    wraps = result.freedom.wraps
    if wraps is not None:
        found |= {
            f"{owner}.{quantity}": (
                float(NOMINAL[place] + wraps.lower[row, place]),
                float(NOMINAL[place] + wraps.upper[row, place]),
            )
            for row, owner in enumerate(wraps.names)
            for place, quantity in enumerate(wraps.quantities)
        }
    return found
