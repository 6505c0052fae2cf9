"""Report sections on muscle parameters within their bounds, and on the solver, its limits and the cost."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.model.freedom import FreedParameter
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.formatting import counted, decimals, readable
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    VERMILION,
    Figure,
    in_style,
    label_bounds,
    label_rows,
    legend_above,
    new_figure,
)


@in_style
def bounds_figure(result: CalibrationResult) -> Figure:
    """Draw each freed parameter between its bounds, one column a parameter, one row a muscle."""
    freed = result.freedom.parameters
    muscles = result.muscles
    rows = np.arange(len(muscles))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(muscles) + 1.9)
    panels = figure.subplots(1, len(freed), sharey=True, squeeze=False)[0]
    for panel, parameter in zip(panels, freed, strict=True):
        at_bound = np.array(
            [f"{muscle}.{parameter.name}" in result.at_bounds for muscle in muscles], dtype=bool
        )
        initial = np.asarray(getattr(result.initial, parameter.name))
        before = place_within_bounds(parameter, initial)
        after = place_within_bounds(parameter, np.asarray(getattr(result.parameters, parameter.name)))
        panel.hlines(rows, 0.0, 1.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        panel.plot(before, rows, "|", color=GRAY, markersize=7, label="before calibration")
        panel.plot(after[~at_bound], rows[~at_bound], "o", color=BLUE, markersize=4, label="after")
        panel.plot(after[at_bound], rows[at_bound], "D", color=VERMILION, markersize=4.5, label="at a bound")
        label_bounds(panel, parameter.name, _bound_labels(parameter, initial))
    label_rows(panels, muscles)
    legend_above(figure, panels[0])
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
        # An exact zero cannot be shown on a logarithmic scale.
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
    """Draw the terms of the cost as bars, largest first."""
    terms = sorted(result.cost_by_term.items(), key=lambda item: -item[1])
    total = sum(value for _, value in terms)
    figure = new_figure(PAGE_WIDTH, 0.22 * len(terms) + 0.7)
    panel = figure.subplots()
    bars = panel.barh([readable(name) for name, _ in terms], [value for _, value in terms], color=BLUE)
    shares = [f"{value:.3g} ({100.0 * value / total:.1f} %)" if total else "0" for _, value in terms]
    panel.bar_label(bars, shares, padding=4, fontsize=7)
    panel.invert_yaxis()
    panel.margins(x=0.12)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("term of the cost (no unit)")
    return figure


def place_within_bounds(
    parameter: FreedParameter, values: Float[np.ndarray, " muscle"]
) -> Float[np.ndarray, " muscle"]:
    """Scale values to 0 at the lower and 1 at the upper bound; one half where the bounds coincide."""
    width = parameter.upper - parameter.lower
    return np.where(width > 0.0, (values - parameter.lower) / np.where(width > 0.0, width, 1.0), 0.5)


def _bound_labels(parameter: FreedParameter, reference: Float[np.ndarray, " muscle"]) -> list[str]:
    """Label the bounds: in their unit if all muscles share them, else as a share of the initial values."""
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
    """Write the report section on muscle parameters."""
    if not result.freedom.parameters:
        return markup.section("Muscle parameters", markup.paragraph("No parameter was free."))
    meanings = [
        f"{parameter.name}: {QUANTITIES[parameter.name].meaning}" for parameter in result.freedom.parameters
    ]
    rows = list(_rows_at_bounds(result))
    at_bounds = (
        markup.table(
            ("parameter", "bound", "number", "muscles"),
            rows,
            caption="Parameters that ended on a bound. If many do, check the data (EMG scale, electrode, "
            "model) before using the values.",
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
        at_bounds,
    )


def _rows_at_bounds(result: CalibrationResult) -> Iterable[tuple[str, str, str, str]]:
    """Write one row for each parameter and bound, with the muscles that ended there."""
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
    """Write the report section on the solver."""
    largest = max(result.cost_by_term, key=lambda name: result.cost_by_term[name])
    history = result.solution.history
    seconds = summary["seconds"]
    paths = (
        " Paths are held fixed in the first iterations and may change afterwards; the cost increases "
        "abruptly where the hard limits are introduced and where they are enforced more strictly."
        if result.freedom.moving_paths is not None
        else ""
    )
    return markup.section(
        "Solver",
        markup.paragraph(
            f"{counted(summary['starts'], 'start')} in {seconds['solve']:.1f} s, after "
            f"{seconds['compile']:.1f} s of compilation. The selected start needed "
            f"{counted(summary['iterations'], 'iteration')} for {summary['n_variables']} variables and "
            f"{summary['n_residuals']} moment residuals. {summary['message']}"
        ),
        *_hard_limits(result, summary),
        markup.picture(
            history_figure(result),
            alternative=f"Cost and optimality by iteration. The cost falls from {decimals(history[0].cost)} "
            f"to {decimals(history[-1].cost)}; optimality ends at {history[-1].optimality:.2g}.",
            caption="Selected start: the minimised cost and the optimality (largest step that steepest "
            "descent within the bounds would still take, in solver units) at each iteration. Both scales "
            f"are logarithmic.{paths}",
        ),
        markup.picture(
            cost_figure(result),
            alternative=f"Terms of the cost at the solution; the largest is {readable(largest)}, "
            f"{result.cost_by_term[largest]:.3g} of {summary['cost']:.4g}.",
            caption="Terms of the cost at the solution. Each is a mean square in units of the allowable "
            "error: 1 means an error as large as the allowable error.",
        ),
    )


def _hard_limits(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    limits = summary["limits"]
    if not limits:
        return []
    satisfied = summary["max_constraint_violation"] <= result.solver.ctol
    return [
        markup.paragraph(
            "Hard limits restrict fiber lengths and the signs of moment arms on the calibration cycles. "
            + ("They are satisfied" if satisfied else "They are violated")
            + f": the largest violation is {summary['max_constraint_violation']:.1g}, where "
            f"{result.solver.ctol:.0e} is allowed (normalised fiber length, or cm of moment arm)."
        ),
        markup.table(
            ("limit", "active values", "largest multiplier", "largest violation", "muscles"),
            [
                (
                    readable(name),
                    str(limit["pushing"]),
                    f"{limit['largest_multiplier']:.2g}",
                    f"{limit['largest_excess']:.1g}",
                    ", ".join(limit["muscles"]) or "none",
                )
                for name, limit in limits.items()
            ],
            caption="Hard limits that are active at the solution. The multiplier is the decrease of the "
            "cost if the limit were relaxed by one unit.",
        ),
    ]
