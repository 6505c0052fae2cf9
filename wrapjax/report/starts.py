"""Where the starts of a calibration ended, and what that says about its parameters.

The starts in the report: whether they agree, in words, a table and figures.
"""

from __future__ import annotations

import csv
import io
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.result import CalibrationResult
from wrapjax.model.parameters import QUANTITIES
from wrapjax.report import markup
from wrapjax.report.parameters import place_within_bounds
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

#: Costs this close, relatively, are taken for equally good.
EQUALLY_GOOD = 0.01
#: A parameter whose values at equally good ends lie further apart, in parts of its bounds, is not determined.
APART = 0.1

START_COLUMNS = ("start", "seed", "owner", "parameter", "value", "unit")

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


def starts_csv(result: CalibrationResult) -> str:
    """Write one row a start, muscle and freed parameter, SI units and all digits.

    No seed means the model's own values. Of paths there is nothing here: their coefficients are many.
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
    """Read every freed parameter where each start ended, in its own unit."""
    trees = [
        outcome.solution.problem.parameters(jnp.asarray(outcome.solution.variables))
        for outcome in result.outcomes
    ]
    names = [parameter.name for parameter in result.freedom.parameters]
    return {name: np.stack([np.asarray(getattr(tree, name)) for tree in trees]) for name in names}


def end_places(result: CalibrationResult) -> Values:
    """Place the same between 0 at the lower and 1 at the upper bound."""
    freed = {parameter.name: parameter for parameter in result.freedom.parameters}
    return {
        name: np.stack([place_within_bounds(freed[name], row) for row in values])
        for name, values in end_values(result).items()
    }


def equally_good(result: CalibrationResult) -> Bool[np.ndarray, " start"]:
    """Mark the start that was taken and those that converged about as low or lower."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    converged = np.array([outcome.solution.status.converged for outcome in result.outcomes])
    good = converged & (costs <= costs[result.chosen] * (1.0 + EQUALLY_GOOD))
    good[result.chosen] = True
    return good


def undetermined_parameters(result: CalibrationResult) -> dict[str, list[str]]:
    """Name, by parameter, the muscles for which equally good ends give values that are far apart."""
    good = equally_good(result)
    found = {}
    for name, places in end_places(result).items():
        width = np.ptp(places[good], axis=0)
        muscles = [muscle for muscle, own in zip(result.muscles, width, strict=True) if own > APART]
        if muscles:
            found[name] = muscles
    return found


def moment_arm_spread(result: CalibrationResult) -> float:
    """Give how far moment arms (m) of equally good ends are apart at most, over the calibration cycles."""
    arms = []
    for place in np.flatnonzero(equally_good(result)):
        solution = result.outcomes[place].solution
        problem = solution.problem
        assert isinstance(problem, Objective)
        changes = problem.parameters(jnp.asarray(solution.variables)).path_changes
        path = problem.recording.path.at(changes)
        arms.append(np.asarray(path.moment_arm))
    return float(np.ptp(np.stack(arms), axis=0).max())


# How the ends of starts are told apart. Rings go round the dot of the one taken, not under it.
_TAKEN = {"color": BLUE, "markersize": 4.2, "zorder": 3, "label": "taken"}
_GOOD = {"color": GRAY, "markersize": 5.0, "markerfacecolor": "none", "zorder": 4, "label": "about as good"}
_POORER = {"color": "#C4C4C4", "markersize": 2.6, "zorder": 2, "label": "poorer, or not converged"}


def starts_section(result: CalibrationResult) -> str:
    """Write the part of the report on the starts."""
    count = len(result.outcomes)
    if count == 1:
        return markup.section(
            "Starts",
            markup.paragraph(
                "The calibration ran from one start, the model's own values. Problems of this kind have "
                "several minima: whether another start would end lower, or as low with other values, is not "
                "known."
            ),
        )
    costs = markup.picture(
        start_cost_figure(result),
        alternative=f"Cost at which each of {count} starts ended.",
        caption="Cost at which each start ended. The band reaches up to 1 % above the one taken (blue). "
        "Random starts (with a seed) lie up to 30 % of the way from the model's own values towards the "
        "bounds.",
    )
    table = markup.table(
        ("start", "made from", "cost", "converged", "iterations", "seconds"),
        [
            (
                f"{number}{' (taken)' if entry['taken'] else ''}",
                _origin(entry["seed"]),
                f"{entry['cost']:#.5g}",
                "yes" if entry["converged"] else "no",
                str(entry["iterations"]),
                f"{entry['seconds']:.1f}",
            )
            for number, entry in enumerate(describe_starts(result))
        ],
        caption="Where each start ended.",
    )
    return markup.section(
        "Starts", *map(markup.paragraph, findings(result)), table, costs, *_parameter_spread(result)
    )


def findings(result: CalibrationResult) -> list[str]:
    """Say in plain sentences whether the starts agree on the cost and on the parameters."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    good, count = int(equally_good(result).sum()), len(costs)
    taken = f"{costs[result.chosen]:.4g}"
    all_converged = all(outcome.solution.status.converged for outcome in result.outcomes)
    if good == count:
        all_of_them = "Both starts" if count == 2 else f"All {count} starts"
        sentences = [f"{all_of_them} ended within 1 % of one cost, {taken}."]
    elif good == 1:
        sentences = [
            f"None of the other starts came within 1 % of the cost of the one taken, {taken}: more starts "
            "may find a lower one."
        ]
    else:
        sentences = [
            f"{good} of {count} starts ended within 1 % of one cost, {taken}; the others "
            f"{'ended in poorer minima' if all_converged else 'ended higher or did not converge'}."
        ]
    if good == 1:
        return sentences
    number = sum(map(len, undetermined_parameters(result).values()))
    total = len(result.freedom.parameters) * len(result.muscles)
    sentences.append(
        f"Of {counted(total, 'muscle parameter')} {number} "
        f"{'differs' if number == 1 else 'differ'} among these by more than a tenth of the way between the "
        "bounds: the recordings do not determine them."
        if number
        else "These agree on every muscle parameter to within a tenth of the way between its bounds."
    )
    if result.freedom.moving_paths is not None:
        apart = max(0.1, 1e3 * moment_arm_spread(result))
        sentences.append(f"Their moment arms differ by {apart:.1f} mm at most.")
    return sentences


def _parameter_spread(result: CalibrationResult) -> list[str]:
    if not result.freedom.parameters:
        return []
    undetermined = undetermined_parameters(result)
    spread = markup.picture(
        spread_figure(result),
        alternative=f"Parameters of {len(result.muscles)} muscles where {len(result.outcomes)} starts ended, "
        f"within their bounds; {sum(map(len, undetermined.values()))} differ although the costs agree.",
        caption="Each freed parameter between its lower bound (left) and upper bound (right) where the "
        "starts ended. Red strokes join values of about equally good ends that lie more than a tenth of the "
        "way apart.",
    )
    if not undetermined:
        return [spread]
    rows = [(name, str(len(muscles)), ", ".join(muscles)) for name, muscles in undetermined.items()]
    return [
        spread,
        markup.table(
            ("parameter", "number", "muscles"),
            rows,
            caption="Parameters that the recordings do not determine: they differ, the costs do not.",
        ),
    ]


@in_style
def start_cost_figure(result: CalibrationResult) -> Figure:
    """Draw the cost at which each start ended, one row a start."""
    costs = np.array([outcome.solution.cost for outcome in result.outcomes])
    rows, taken = np.arange(len(costs)), costs[result.chosen]
    figure = new_figure(0.6 * PAGE_WIDTH, 0.2 * len(rows) + 0.7)
    panel = figure.subplots()
    if np.isfinite(taken):
        panel.axvspan(taken, taken * (1.0 + EQUALLY_GOOD), color="#F1F6FA", zorder=0)
    panel.hlines(rows, 0.0, 1.0, transform=panel.get_yaxis_transform(), color=LIGHT_GRAY, linewidth=0.8)
    for number, kind in enumerate(_kinds(result)):
        panel.plot(costs[number], number, "o", **kind)
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
    """Draw where the starts ended, one column a parameter, one row a muscle."""
    places, good = end_places(result), equally_good(result)
    rows = np.arange(len(result.muscles))
    figure = new_figure(PAGE_WIDTH, 0.18 * len(rows) + 1.9)
    panels = figure.subplots(1, len(places), sharey=True, squeeze=False)[0]
    for panel, (name, values) in zip(panels, places.items(), strict=True):
        panel.hlines(rows, 0.0, 1.0, color=LIGHT_GRAY, linewidth=0.8, zorder=0)
        low, high = values[good].min(axis=0), values[good].max(axis=0)
        apart = high - low > APART
        panel.hlines(rows[apart], low[apart], high[apart], color=VERMILION, linewidth=1.4, zorder=1)
        for own, kind in zip(values, _kinds(result), strict=True):
            panel.plot(own, rows, "o", **kind)
        panel.set_title(name.replace("_", "\n", 1).replace("_", " "))
        panel.set_xlim(-0.06, 1.06)
        panel.set_xticks([0.0, 1.0], ["lower", "upper"])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        # Inwards, or the labels of neighbors meet.
        for label, side in zip(panel.get_xticklabels(), ("left", "right"), strict=True):
            label.set_horizontalalignment(side)
    panels[0].set_yticks(rows, result.muscles, parse_math=False)
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    drawn = dict(zip(*panels[0].get_legend_handles_labels()[::-1], strict=True))
    labels = [kind["label"] for kind in (_TAKEN, _GOOD, _POORER) if kind["label"] in drawn]
    figure.legend([drawn[label] for label in labels], labels, loc="outside upper left", ncols=len(labels))
    return figure


def _kinds(result: CalibrationResult) -> list[dict[str, Any]]:
    """How to draw the end of each start."""
    kinds = [_GOOD if good else _POORER for good in equally_good(result)]
    kinds[result.chosen] = _TAKEN
    return kinds


def _origin(seed: int | None) -> str:
    return "model's values" if seed is None else f"seed {seed}"
