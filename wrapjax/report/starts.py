"""Where the starts of a calibration ended, and what that says about its parameters."""

from __future__ import annotations

import csv
import io
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibrate import CalibrationResult, Objective
from wrapjax.model import QUANTITIES
from wrapjax.report.parameter_figures import place_within_bounds

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
