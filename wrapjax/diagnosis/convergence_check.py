"""Whether the plain model was fitted as well as it can be: without that, what is left is the fit's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.solvers.interface import Linearization
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.result import ConvergenceCheck

#: Relative difference of the two lowest starts, and share of the explainable error that could still be won,
#: above which a fit is no ground for a diagnosis.
SPREAD, DECREMENT = 0.01, 0.01


def check_convergence(
    outcomes: Sequence[Outcome],
    decrement: float,
    explainable: float,
    conflicts: Mapping[str, Mapping[str, float]],
) -> ConvergenceCheck:
    """Judge a fit from several starts.

    Parameters
    ----------
    outcomes
        Where each start led.
    decrement
        By how much the cost could still fall: see `decrement_of`.
    explainable
        What the explainable error costs.
    conflicts
        See `ConvergenceCheck`.
    """
    ended = sorted(outcomes, key=lambda one: _height(one.solution.cost))
    costs, spread = _spread(outcomes)
    # What is not known is no ground for going on.
    share = 0.0 if explainable <= 0.0 else decrement / explainable
    problems = []
    if not any(one.solution.status.converged for one in outcomes):
        problems.append(f"no start converged: {ended[0].solution.status.value}")
    if np.isfinite(costs).sum() < 2:
        problems.append("a fit from one start cannot show that it is the best one")
    elif not spread <= SPREAD:
        problems.append(
            f"the two best starts end {100.0 * spread:.1f} % apart; {100.0 * SPREAD:.0f} % are allowed"
        )
    if not share <= DECREMENT:
        problems.append(f"{100.0 * share:.1f} % of the explainable error could still be won by fitting on")
    return ConvergenceCheck(
        tuple(problems),
        costs,
        float(spread),
        float(share),
        {kind: dict(own) for kind, own in conflicts.items()},
    )


def unfinished(outcomes: Sequence[Outcome], reason: str) -> ConvergenceCheck:
    """Give what is known of a fit that was not looked at further."""
    return ConvergenceCheck((reason,), *_spread(outcomes), np.nan)


def _spread(outcomes: Sequence[Outcome]) -> tuple[tuple[float, ...], float]:
    """Give all costs, lowest first and failed starts last, and how far the two lowest are apart."""
    costs = tuple(sorted((float(one.solution.cost) for one in outcomes), key=_height))
    known = [cost for cost in costs if np.isfinite(cost)]
    return costs, (known[1] - known[0]) / known[0] if len(known) > 1 else np.nan


def _height(cost: float) -> float:
    return cost if np.isfinite(cost) else np.inf


def decrement_of(
    model: Linearization,
    variables: Float[np.ndarray, " variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
) -> float:
    """By how much a Gauss-Newton step would let the cost fall, of variables that no bound holds."""
    gradient = np.asarray(model.gradient)
    held = ((variables <= lower) & (gradient > 0.0)) | ((variables >= upper) & (gradient < 0.0))
    free = ~held
    curvature = np.asarray(model.gauss_newton)[np.ix_(free, free)]
    ridge = 1e-10 * np.trace(curvature) / max(len(curvature), 1) * np.eye(len(curvature))
    return float(gradient[free] @ np.linalg.solve(curvature + ridge, gradient[free]))


def conflict(
    labels: Sequence[str],
    one: Float[np.ndarray, " variable"],
    other: Float[np.ndarray, " variable"],
    sd: Float[np.ndarray, " variable"],
) -> dict[str, float]:
    """Say by kind of parameter how far two fits are apart, in standard deviations, root mean square."""
    apart = (one - other) / (np.sqrt(2.0) * sd)
    kinds = np.array([label.rsplit(".", 1)[1] for label in labels])
    return {str(kind): float(np.sqrt(np.mean(apart[kinds == kind] ** 2))) for kind in dict.fromkeys(kinds)}
