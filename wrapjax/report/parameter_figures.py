"""Figures of a calibration: parameters within their bounds, and how the solver got there."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from wrapjax.calibrate import CalibrationResult
from wrapjax.model import QUANTITIES, FreedParameter
from wrapjax.report.style import BLUE, GRAY, LIGHT_GRAY, PAGE_WIDTH, VERMILION, Figure, in_style, new_figure


@in_style
def bounds_figure(result: CalibrationResult) -> Figure:
    """Draw where each freed parameter lies between its bounds, one column a parameter, one row a muscle."""
    freed = result.freedom.parameters
    muscles = result.muscles
    rows = np.arange(len(muscles))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(muscles) + 1.9)
    panels = figure.subplots(1, len(freed), sharey=True, squeeze=False)[0]
    for panel, parameter in zip(panels, freed, strict=True):
        stuck = np.array([f"{muscle}.{parameter.name}" in result.at_bounds for muscle in muscles], dtype=bool)
        before = place_within_bounds(parameter, np.asarray(getattr(result.initial, parameter.name)))
        after = place_within_bounds(parameter, np.asarray(getattr(result.parameters, parameter.name)))
        panel.hlines(rows, 0.0, 1.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.plot(before, rows, "|", color=GRAY, markersize=7, label="before calibration")
        panel.plot(after[~stuck], rows[~stuck], "o", color=BLUE, markersize=4, label="after")
        panel.plot(after[stuck], rows[stuck], "D", color=VERMILION, markersize=4.5, label="at a bound")
        panel.set_title(parameter.name.replace("_", "\n", 1).replace("_", " "))
        panel.set_xlim(-0.06, 1.06)
        panel.set_xticks(
            [0.0, 1.0], _bound_labels(parameter, np.asarray(getattr(result.initial, parameter.name)))
        )
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        # Inwards, or the labels of neighbors meet.
        for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
    panels[0].set_yticks(rows, muscles, parse_math=False)
    panels[0].set_ylim(len(muscles) - 0.4, -0.6)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@in_style
def history_figure(result: CalibrationResult) -> Figure:
    """Draw cost and optimality over the solver's iterations, on logarithmic scales."""
    from matplotlib.ticker import LogLocator, NullFormatter

    history = result.solution.history
    numbers = [iteration.number for iteration in history]
    figure = new_figure(PAGE_WIDTH, 2.6)
    panels = figure.subplots(1, 2)
    titles = {"cost": "cost (no unit)", "optimality": "optimality (solver units)"}
    for panel, (name, title) in zip(panels, titles.items(), strict=True):
        values = np.array([getattr(iteration, name) for iteration in history])
        # A logarithm has no place for an exact zero.
        panel.plot(numbers, np.where(values > 0.0, values, np.nan), "o-", color=BLUE, markersize=2.5)
        if (values > 0.0).any():
            panel.set_yscale("log")
        panel.set_title(title, loc="left")
        panel.set_xlabel("iteration")
        panel.grid(axis="y", color=LIGHT_GRAY, linewidth=0.6)
        panel.xaxis.get_major_locator().set_params(integer=True)
    if panels[0].get_yscale() == "log":
        panels[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panels[0].yaxis.set_major_formatter("{x:g}")
        panels[0].yaxis.set_minor_formatter(NullFormatter())
    return figure


@in_style
def cost_figure(result: CalibrationResult) -> Figure:
    """Draw the parts of the cost as bars, largest first."""
    terms = sorted(result.cost_by_term.items(), key=lambda item: -item[1])
    total = sum(value for _, value in terms)
    figure = new_figure(PAGE_WIDTH, 0.22 * len(terms) + 0.7)
    panel = figure.subplots()
    bars = panel.barh(
        [name.replace("_", " ") for name, _ in terms], [value for _, value in terms], color=BLUE
    )
    shares = [f"{value:.3g} ({100.0 * value / total:.1f} %)" if total else "0" for _, value in terms]
    panel.bar_label(bars, shares, padding=4, fontsize=7)
    panel.invert_yaxis()
    panel.margins(x=0.12)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("part of the cost (no unit)")
    return figure


def place_within_bounds(
    parameter: FreedParameter, values: Float[np.ndarray, " muscle"]
) -> Float[np.ndarray, " muscle"]:
    """Give 0 at the lower bound, 1 at the upper, one half where the bounds coincide."""
    width = parameter.upper - parameter.lower
    return np.where(width > 0.0, (values - parameter.lower) / np.where(width > 0.0, width, 1.0), 0.5)


def _bound_labels(parameter: FreedParameter, reference: Float[np.ndarray, " muscle"]) -> list[str]:
    """Say what the bounds are: in the unit where all muscles share them, else as a share of the start."""
    bounds = (parameter.lower, parameter.upper)
    if all(np.ptp(bound) == 0.0 for bound in bounds):
        unit = QUANTITIES[parameter.name].unit
        texts = [f"{bound[0]:g}" for bound in bounds]
        return texts if unit == "1" else [f"{text} {unit}" for text in texts]
    if np.all(reference != 0.0):
        shares = [bound / reference for bound in bounds]
        if all(np.ptp(share) < 1e-9 for share in shares):
            return [f"{100.0 * share[0]:.0f} %" for share in shares]
    return ["lower", "upper"]
