"""Figures of a calibration: parameters within their bounds, and how the solver got there.

Muscle parameters in the report: where they lie between their bounds, and which ended there.

The solver in the report: how it got there, what limits held it, what the cost is made of.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.result import CalibrationResult
from wrapjax.model.freedom import FreedParameter
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report import markup
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


def parameters_section(result: CalibrationResult) -> str:
    """Write the part of the report on muscle parameters."""
    if not result.freedom.parameters:
        return markup.section("Muscle parameters", markup.paragraph("No parameter was free."))
    meanings = [
        f"{parameter.name}: {QUANTITIES[parameter.name].meaning}" for parameter in result.freedom.parameters
    ]
    rows = list(_stuck_rows(result))
    stuck = (
        markup.table(
            ("parameter", "bound", "number", "muscles"),
            rows,
            caption="Parameters that ended on a bound. Where many do, look at the data (EMG scale, "
            "electrode, model) before trusting the values.",
        )
        if rows
        else markup.paragraph("No parameter ended on a bound.")
    )
    return markup.section(
        "Muscle parameters",
        markup.picture(
            bounds_figure(result),
            alternative=f"Position of {len(result.freedom.parameters)} parameters of {len(result.muscles)} "
            f"muscles between their bounds; {len(result.at_bounds)} lie at a bound (see the table).",
            caption="Each free parameter between its lower bound (left) and upper bound (right): calibrated "
            "(dot), before calibration (gray stroke), at a bound (diamond). Bounds in % are shares of the "
            "model's own value.",
        ),
        markup.bullets(meanings),
        stuck,
    )


def _stuck_rows(result: CalibrationResult) -> Iterable[tuple[str, str, str, str]]:
    """One row a parameter and bound, with the muscles that ended there."""
    for parameter in result.freedom.parameters:
        values = np.asarray(getattr(result.parameters, parameter.name))
        nearer_lower = values - parameter.lower <= parameter.upper - values
        for bound, side in (("lower", nearer_lower), ("upper", ~nearer_lower)):
            names = [
                muscle
                for muscle, here in zip(result.muscles, side, strict=True)
                if here and f"{muscle}.{parameter.name}" in result.at_bounds
            ]
            if names:
                yield parameter.name, bound, str(len(names)), ", ".join(names)


def solver_section(result: CalibrationResult, summary: dict[str, Any]) -> str:
    """Write the part of the report on the solver."""
    largest = max(result.cost_by_term, key=lambda name: result.cost_by_term[name])
    history = result.solution.history
    seconds = summary["seconds"]
    paths = (
        " Where paths may change, the first iterations still hold them; the cost jumps where the hard limits "
        "come in, and where they are enforced more strictly."
        if result.freedom.moving_paths is not None
        else ""
    )
    return markup.section(
        "Solver",
        markup.paragraph(
            f"{counted(summary['starts'], 'start')} in {seconds['solve']:.1f} s, after "
            f"{seconds['compile']:.1f} s of compiling. The one taken needed "
            f"{counted(summary['iterations'], 'iteration')} for {summary['n_variables']} variables and "
            f"{summary['n_residuals']} moment residuals. {summary['message']}"
        ),
        *_limits(result, summary),
        markup.picture(
            history_figure(result),
            alternative=f"Cost and optimality by iteration. The cost falls from {decimals(history[0].cost)} "
            f"to {decimals(history[-1].cost)}; optimality ends at {history[-1].optimality:.2g}.",
            caption="Of the start that was taken: the cost that is minimised, and optimality (the largest "
            "move that steepest descent within the bounds would still make, in solver units), by iteration. "
            f"Both scales are logarithmic.{paths}",
        ),
        markup.picture(
            cost_figure(result),
            alternative=f"Parts of the cost at the solution; the largest is {plain(largest)}, "
            f"{result.cost_by_term[largest]:.3g} of {summary['cost']:.4g}.",
            caption="Parts of the cost at the solution. Each is a mean square in allowable errors: 1 means "
            "an error as large as allowed.",
        ),
    )


def _limits(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    limits = summary["limits"]
    if not limits:
        return []
    kept = summary["max_constraint_violation"] <= result.solver.ctol
    return [
        markup.paragraph(
            "Hard limits hold fiber lengths and the signs of moment arms on the calibration cycles. "
            + ("They are kept" if kept else "They are not kept")
            + f": the largest excess is {summary['max_constraint_violation']:.1g}, where "
            f"{result.solver.ctol:.0e} is allowed (normalised fiber length, or cm of moment arm)."
        ),
        markup.table(
            ("limit", "values that push", "largest multiplier", "largest excess", "muscles"),
            [
                (
                    plain(name),
                    str(own["pushing"]),
                    f"{own['largest_multiplier']:.2g}",
                    f"{own['largest_excess']:.1g}",
                    ", ".join(own["muscles"]) or "none",
                )
                for name, own in limits.items()
            ],
            caption="Hard limits that push against the solution. The multiplier is how much the cost would "
            "fall for one unit of room.",
        ),
    ]
