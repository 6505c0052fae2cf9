"""Results of the starts of a calibration, whether they agree, and the report section on them."""

from __future__ import annotations

import csv
import io
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.calibration_result import CalibrationResult
from wrapjax.calibration.objective import Objective
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.calibration.parameters_and_solver import place_within_bounds
from wrapjax.report.formatting import counted
from wrapjax.report.style import (
    BLUE,
    GRAY,
    LIGHT_GRAY,
    PAGE_WIDTH,
    PALE_BLUE,
    VERMILION,
    Figure,
    in_style,
    label_bounds,
    label_rows,
    new_figure,
)

#: Relative difference below which two costs count as equally good.
EQUALLY_GOOD = 0.01
#: Range of a parameter over equally good starts, as a share of the range between its bounds, above which the
#: recordings do not determine it.
APART = 0.1

START_COLUMNS = ("start", "seed", "owner", "parameter", "value", "unit")

Values = dict[str, Float[np.ndarray, "start muscle"]]


def describe_starts(result: CalibrationResult) -> list[dict[str, Any]]:
    """Describe how each start was made and its result, for ``summary.json``."""
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


def starts_csv(result: CalibrationResult) -> str:
    """Write one row for each start, muscle and freed parameter, in SI units with all digits.

    An empty seed means the model's own values. Path coefficients are not listed, because there are many.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(START_COLUMNS)
    for name, values in end_values(result).items():
        for start, row in enumerate(values):
            seed = result.outcomes[start].seed
            for muscle, value in zip(result.muscles, row.tolist(), strict=True):
                writer.writerow(
                    (start, "" if seed is None else seed, muscle, name, value, QUANTITIES[name].unit)
                )
    return text.getvalue()


def end_values(result: CalibrationResult) -> Values:
    """Collect the values of all freed parameters at the end of each start, in SI units."""
    trees = [
        outcome.solution.problem.parameters(jnp.asarray(outcome.solution.variables))
        for outcome in result.outcomes
    ]
    names = [parameter.name for parameter in result.freedom.parameters]
    return {name: np.stack([np.asarray(getattr(tree, name)) for tree in trees]) for name in names}


def end_places(result: CalibrationResult) -> Values:
    """Scale the final values of all freed parameters to 0 at the lower and 1 at the upper bound."""
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    return {
        name: np.stack([place_within_bounds(freed[name], row) for row in values])
        for name, values in end_values(result).items()
    }


def equally_good(result: CalibrationResult) -> Bool[np.ndarray, " start"]:
    """Mark the selected start and those that converged to a cost at most 1 % higher."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    converged = np.array([outcome.solution.status.converged for outcome in result.outcomes])
    good = converged & (costs <= costs[result.chosen] * (1.0 + EQUALLY_GOOD))
    good[result.chosen] = True
    return good


def undetermined_parameters(result: CalibrationResult) -> dict[str, list[str]]:
    """List, by parameter, the muscles whose values differ widely between equally good starts."""
    good = equally_good(result)
    undetermined = {}
    for name, places in end_places(result).items():
        ranges = np.ptp(places[good], axis=0)
        muscles = [muscle for muscle, width in zip(result.muscles, ranges, strict=True) if width > APART]
        if muscles:
            undetermined[name] = muscles
    return undetermined


def moment_arm_spread(result: CalibrationResult) -> float:
    """Compute the largest difference of moment arms (m) between equally good starts on calibration cycles."""
    arms = []
    for place in np.flatnonzero(equally_good(result)):
        solution = result.outcomes[place].solution
        problem = solution.problem
        assert isinstance(problem, Objective)
        changes = problem.parameters(jnp.asarray(solution.variables)).path_changes
        path = problem.recording.path.at(changes)
        arms.append(np.asarray(path.moment_arm))
    return float(np.ptp(np.stack(arms), axis=0).max())


# Markers of starts. Rings are drawn over the dot of the selected start, around which they remain visible.
_SELECTED = {"color": BLUE, "markersize": 4.2, "zorder": 3, "label": "selected"}
_GOOD = {"color": GRAY, "markersize": 5.0, "markerfacecolor": "none", "zorder": 4, "label": "equally good"}
_POORER = {"color": "#C4C4C4", "markersize": 2.6, "zorder": 2, "label": "higher cost, or not converged"}


def starts_section(result: CalibrationResult) -> str:
    """Write the report section on the starts."""
    count = len(result.outcomes)
    if count == 1:
        return markup.section(
            "Starts",
            markup.paragraph(
                "The calibration ran from one start, the model's own values. Problems of this kind have "
                "several local minima: whether another start would reach a lower cost, or the same cost with "
                "other parameter values, is unknown."
            ),
        )
    costs = markup.picture(
        start_cost_figure(result),
        alternative=f"Final cost of each of {count} starts.",
        caption="Final cost of each start. The band extends to 1 % above the cost of the selected start "
        "(blue). Random starts (with a seed) lie up to 30 % of the way from the model's own values towards "
        "the bounds.",
    )
    table = markup.table(
        ("start", "initial values", "cost", "converged", "iterations", "seconds"),
        [
            (
                f"{number}{' (selected)' if entry['taken'] else ''}",
                _origin(entry["seed"]),
                f"{entry['cost']:#.5g}",
                "yes" if entry["converged"] else "no",
                str(entry["iterations"]),
                f"{entry['seconds']:.1f}",
            )
            for number, entry in enumerate(describe_starts(result))
        ],
        caption="Result of each start.",
    )
    return markup.section(
        "Starts", *map(markup.paragraph, start_findings(result)), table, costs, *_parameter_spread(result)
    )


def start_findings(result: CalibrationResult) -> list[str]:
    """Write sentences on whether the starts agree on the cost and on the parameters."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    good, count = int(equally_good(result).sum()), len(costs)
    selected = f"{costs[result.chosen]:.4g}"
    all_converged = all(outcome.solution.status.converged for outcome in result.outcomes)
    if good == count:
        starts = "Both starts" if count == 2 else f"All {count} starts"
        sentences = [f"{starts} ended within 1 % of the same cost, {selected}."]
    elif good == 1:
        sentences = [
            f"No other start ended within 1 % of the cost of the selected start, {selected}: more starts may "
            "find a lower cost."
        ]
    else:
        sentences = [
            f"{good} of {count} starts ended within 1 % of the same cost, {selected}; the others "
            f"{'converged to' if all_converged else 'ended at'} a higher cost"
            f"{'' if all_converged else ' or did not converge'}."
        ]
    if good == 1:
        return sentences
    number = sum(map(len, undetermined_parameters(result).values()))
    total = len(result.freedom.parameters) * len(result.muscles)
    sentences.append(
        f"{number} of {counted(total, 'muscle parameter')} {'differs' if number == 1 else 'differ'} among "
        "these starts by more than a tenth of the range between the bounds: the recordings do not determine "
        f"{'it' if number == 1 else 'them'}."
        if number
        else "These starts agree on every muscle parameter to within a tenth of the range between its bounds."
    )
    if result.freedom.moving_paths is not None:
        difference = max(0.1, 1e3 * moment_arm_spread(result))
        sentences.append(f"Their moment arms differ by at most {difference:.1f} mm.")
    return sentences


def _parameter_spread(result: CalibrationResult) -> list[str]:
    if not result.freedom.parameters:
        return []
    undetermined = undetermined_parameters(result)
    spread = markup.picture(
        spread_figure(result),
        alternative=f"Final parameters of {len(result.muscles)} muscles for {len(result.outcomes)} starts, "
        f"within their bounds; {sum(map(len, undetermined.values()))} differ although the costs agree.",
        caption="Final value of each freed parameter between its lower bound (left) and upper bound (right) "
        "for each start. Red lines join values of equally good starts that differ by more than a tenth of "
        "the range.",
    )
    if not undetermined:
        return [spread]
    rows = [(name, str(len(muscles)), ", ".join(muscles)) for name, muscles in undetermined.items()]
    return [
        spread,
        markup.table(
            ("parameter", "number", "muscles"),
            rows,
            caption="Parameters that the recordings do not determine: they differ between starts of equal "
            "cost.",
        ),
    ]


@in_style
def start_cost_figure(result: CalibrationResult) -> Figure:
    """Draw the final cost of each start, one row a start."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    rows, selected = np.arange(len(costs)), costs[result.chosen]
    figure = new_figure(0.6 * PAGE_WIDTH, 0.2 * len(rows) + 0.7)
    panel = figure.subplots()
    if np.isfinite(selected):
        panel.axvspan(selected, selected * (1.0 + EQUALLY_GOOD), color=PALE_BLUE, zorder=0)
    panel.hlines(rows, 0.0, 1.0, transform=panel.get_yaxis_transform(), color=LIGHT_GRAY, linewidth=0.8)
    for number, marker in enumerate(_markers(result)):
        panel.plot(costs[number], number, "o", **marker)
    origins = [_origin(outcome.seed) for outcome in result.outcomes]
    panel.set_yticks(rows, [f"{number}: {origin}" for number, origin in enumerate(origins)])
    panel.set_ylim(len(rows) - 0.5, -0.5)
    panel.margins(x=0.1)
    panel.ticklabel_format(axis="x", useOffset=False)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("cost (no unit)")
    return figure


@in_style
def spread_figure(result: CalibrationResult) -> Figure:
    """Draw the final parameters of all starts, one column a parameter, one row a muscle."""
    places, good = end_places(result), equally_good(result)
    rows = np.arange(len(result.muscles))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(rows) + 1.9)
    panels = figure.subplots(1, len(places), sharey=True, squeeze=False)[0]
    for panel, (name, values) in zip(panels, places.items(), strict=True):
        panel.hlines(rows, 0.0, 1.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        low, high = values[good].min(axis=0), values[good].max(axis=0)
        apart = high - low > APART
        panel.hlines(rows[apart], low[apart], high[apart], color=VERMILION, linewidth=1.4, zorder=1)
        for start, marker in zip(values, _markers(result), strict=True):
            panel.plot(start, rows, "o", **marker)
        label_bounds(panel, name)
    label_rows(panels, result.muscles)
    drawn = dict(zip(*panels[0].get_legend_handles_labels()[::-1], strict=True))
    labels = [marker["label"] for marker in (_SELECTED, _GOOD, _POORER) if marker["label"] in drawn]
    figure.legend([drawn[label] for label in labels], labels, loc="outside upper left", ncols=len(labels))
    return figure


def _markers(result: CalibrationResult) -> list[dict[str, Any]]:
    """Choose the marker of each start."""
    markers = [_GOOD if good else _POORER for good in equally_good(result)]
    markers[result.chosen] = _SELECTED
    return markers


def _origin(seed: int | None) -> str:
    return "model's values" if seed is None else f"seed {seed}"
