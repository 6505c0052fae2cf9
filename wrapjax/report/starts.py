"""Where the starts of a calibration ended, and what that says about its parameters."""

from __future__ import annotations

import csv
import io
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.calibrate import CalibrationResult
from wrapjax.model import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.figures import PAGE_WIDTH
from wrapjax.report.parameter_figures import place_within_bounds
from wrapjax.report.style import BLUE, GRAY, LIGHT_GRAY, VERMILION, Figure, in_style, new_figure, to_svg

#: Costs this close, relatively, are taken for equally good.
EQUALLY_GOOD = 0.01
#: A parameter whose values at equally good ends lie further apart, in parts of its bounds, is not determined.
APART = 0.1

Values = dict[str, Float[np.ndarray, "start muscle"]]


def describe_starts(result: CalibrationResult) -> list[dict[str, Any]]:
    """Say of each start how it was made and where it ended."""
    return [
        {
            "seed": outcome.seed,
            "cost": outcome.solution.cost,
            "converged": outcome.solution.status.converged,
            "message": outcome.solution.status.value,
            "iterations": outcome.solution.iterations,
            "seconds": outcome.seconds,
            "max_constraint_violation": outcome.solution.max_violation,
            "taken": number == result.chosen,
        }
        for number, outcome in enumerate(result.outcomes)
    ]


def end_values(result: CalibrationResult) -> Values:
    """Read every freed parameter where each start ended, in its own unit."""
    trees = [
        outcome.solution.problem.parameters(jnp.asarray(outcome.solution.variables))
        for outcome in result.outcomes
    ]
    names = [parameter.name for parameter in result.freedom.parameters]
    return {name: np.stack([np.asarray(getattr(tree, name)) for tree in trees]) for name in names}


def starts_csv(result: CalibrationResult) -> str:
    """Write one row a start, muscle and freed parameter, SI units and all digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("start", "seed", "owner", "parameter", "value", "unit"))
    for name, values in end_values(result).items():
        for start, row in enumerate(values):
            seed = result.outcomes[start].seed
            for muscle, value in zip(result.muscles, row.tolist(), strict=True):
                writer.writerow(
                    (start, "" if seed is None else seed, muscle, name, value, QUANTITIES[name].unit)
                )
    return text.getvalue()


def starts_section(result: CalibrationResult) -> str:
    """Write the part of the report on the starts."""
    count = len(result.outcomes)
    if count == 1:
        return markup.section(
            "Starts",
            markup.paragraph(
                "The calibration ran from one start, the model's own values. Problems of this kind have "
                "several "
                "minima: whether another start would end lower, or as low elsewhere, is not known."
            ),
        )
    rows = [
        (
            f"{number}{' (taken)' if entry['taken'] else ''}",
            "model's values" if entry["seed"] is None else f"seed {entry['seed']}",
            f"{entry['cost']:.5g}",
            "yes" if entry["converged"] else "no",
            str(entry["iterations"]),
            f"{entry['seconds']:.1f}",
        )
        for number, entry in enumerate(describe_starts(result))
    ]
    undetermined = undetermined_parameters(result)
    return markup.section(
        "Starts",
        *[markup.paragraph(sentence) for sentence in _findings(result, undetermined)],
        markup.table(
            ("start", "made from", "cost", "converged", "iterations", "seconds"),
            rows,
            caption="Where each start ended.",
            numeric=True,
        ),
        markup.picture(
            to_svg(spread_figure(result)),
            alternative=f"Parameters of {len(result.muscles)} muscles where {count} starts ended, "
            "within their "
            f"bounds; {len(undetermined)} differ although the costs agree.",
            caption="Each freed parameter between its lower bound (left) and upper bound (right) where "
            "the starts "
            "ended: the one taken (blue), others about as good (gray rings), others (faint dots). "
            "Red lines join values that lie more than a tenth of the range apart though their costs "
            "differ by "
            "less than 1 %: the data do not determine these.",
        ),
    )


def undetermined_parameters(result: CalibrationResult) -> list[str]:
    """Name the parameters that differ between ends that are about equally good."""
    good = _equally_good(result)
    if good.sum() < 2:
        return []
    places = _places(result)
    return [
        f"{muscle}.{name}"
        for name, values in places.items()
        for muscle, width in zip(result.muscles, np.ptp(values[good], axis=0), strict=True)
        if width > APART
    ]


@in_style
def spread_figure(result: CalibrationResult) -> Figure:
    """Draw where the starts ended, one column a parameter, one row a muscle."""
    places, good = _places(result), _equally_good(result)
    rows = np.arange(len(result.muscles))
    figure = new_figure(PAGE_WIDTH, 0.16 * len(rows) + 1.4)
    panels = figure.subplots(1, len(places), sharey=True, squeeze=False)[0]
    for panel, (name, values) in zip(panels, places.items(), strict=True):
        panel.hlines(rows, 0.0, 1.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        for number, own in enumerate(values):
            if number == result.chosen:
                continue
            style = {"markersize": 4.5, "markerfacecolor": "none", "color": GRAY} if good[number] else {}
            panel.plot(own, rows, "o", **({"markersize": 2.0, "color": "#BBBBBB"} | style))
        low, high = values[good].min(axis=0), values[good].max(axis=0)
        apart = high - low > APART
        panel.hlines(rows[apart], low[apart], high[apart], color=VERMILION, linewidth=1.2)
        panel.plot(values[result.chosen], rows, "o", color=BLUE, markersize=3.8)
        panel.set_title(name.replace("_", "\n", 1).replace("_", " "))
        panel.set_xlim(-0.06, 1.06)
        panel.set_xticks([0.0, 1.0], ["lower", "upper"])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
    panels[0].set_yticks(rows, result.muscles, parse_math=False)
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def _places(result: CalibrationResult) -> Values:
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    return {
        name: np.stack([place_within_bounds(freed[name], row) for row in values])
        for name, values in end_values(result).items()
    }


def _equally_good(result: CalibrationResult) -> np.ndarray:
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    return costs <= costs[result.chosen] * (1.0 + EQUALLY_GOOD)


def _findings(result: CalibrationResult, undetermined: list[str]) -> list[str]:
    costs = [outcome.solution.cost for outcome in result.outcomes]
    good, count = int(_equally_good(result).sum()), len(costs)
    if good == count:
        first = f"All {count} starts ended within 1 % of the lowest cost, {min(costs):.4g}."
    elif good == 1:
        first = (
            f"No other of the {count} starts came within 1 % of the lowest cost, {min(costs):.4g} (the "
            "highest is "
            f"{max(costs):.4g}): more starts may find a lower one."
        )
    else:
        first = (
            f"{good} of {count} starts ended within 1 % of the lowest cost, {min(costs):.4g}; the "
            "others in poorer "
            f"minima, up to {max(costs):.4g}."
        )
    if good < 2:
        return [first]
    total = len(result.freedom.parameters) * len(result.muscles)
    second = (
        f"{len(undetermined)} of {total} parameters differ among these by more than a tenth of their "
        "range: the "
        "data do not determine them."
        if undetermined
        else "They agree on every parameter to within a tenth of its range."
    )
    return [first, second]
