"""What a model says of cycles that it has not seen.

Held-out error confirms a finding; it must not select one, for a wrong mechanism fits left-out cycles of
the same walk almost as well as the right one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.calibration.solvers.checkpoints import SolveCache
from wrapjax.diagnosis.refit import JointProblem, Refit, fit_jointly

#: From five cycles a speed on, one of each is left out at a time; below, single cycles are.
BLOCKS = 5

#: From calibrated variables and amounts to the moments of all cycles, N m.
Predict = Callable[
    [Float[np.ndarray, " variable"], Float[np.ndarray, " amount"]],
    Float[np.ndarray, "cycle coordinate frame"],
]


@dataclass(frozen=True)
class Plan:
    """Which cycles are left out together.

    Parameters
    ----------
    calibration
        Numbers of the cycles that fits may see, among all.
    blocks
        Of those, by their place among them: one array a fit that does not see them.
    speeds
        Speed of each of those, counted from 0.
    new_speed
        Cycles, among all, at a speed that no fit may see.
    """

    calibration: Int[np.ndarray, " seen"]
    blocks: tuple[Int[np.ndarray, " _"], ...]
    speeds: Int[np.ndarray, " seen"]
    new_speed: Bool[np.ndarray, " cycle"]

    @property
    def counts(self) -> Int[np.ndarray, " speed"]:
        """How many cycles a speed fits may see."""
        return np.bincount(self.speeds)


def plan_of(uses: Sequence[str], speeds: Int[np.ndarray, " cycle"]) -> Plan:
    """Say which cycles are left out together.

    Parameters
    ----------
    uses
        ``calibration`` or another use of each cycle.
    speeds
        Counted from 0.
    """
    seen = np.flatnonzero([use == "calibration" for use in uses])
    known = np.unique(speeds[seen])
    own = np.searchsorted(known, speeds[seen])
    turn = np.array([np.sum(own[:place] == speed) for place, speed in enumerate(own)])
    few = not len(own) or np.bincount(own).min() < BLOCKS
    turn = np.arange(len(own)) if few else turn % BLOCKS
    blocks = tuple(np.flatnonzero(turn == number) for number in range(turn.max() + 1)) if len(turn) else ()
    return Plan(seen, blocks, own, ~np.isin(speeds, known))


@dataclass(frozen=True)
class CrossFit:
    """A model fitted to all it may see, and to parts of that.

    Parameters
    ----------
    full
        The fit to all calibration cycles.
    predicted
        Moments of all cycles, N m, each from a fit that has not seen it.
    of_speeds
        Fits to each single speed; none where there is but one.
    at_other_speed
        Moments, each cycle's from a fit that has not seen its speed; None where there is no such fit.
    """

    full: Refit
    predicted: Float[np.ndarray, "cycle coordinate frame"]
    of_speeds: tuple[Refit, ...]
    at_other_speed: Float[np.ndarray, "cycle coordinate frame"] | None


def cross_fit(
    problem: JointProblem,
    start: Float[np.ndarray, " variable"],
    plan: Plan,
    speeds: Int[np.ndarray, " cycle"],
    predict: Predict,
    kept: SolveCache | None = None,
) -> CrossFit:
    """Fit to all cycles, and to all but each block, and but each speed; starts are the whole fit's end.

    Parameters
    ----------
    problem
        Over the plan's calibration cycles.
    start
        Of the first fit.
    plan, speeds
        Speeds are those of all cycles, counted from 0.
    predict
        Of the same model.
    kept
        As of `fit_jointly`.
    """
    full = fit_jointly(problem, start, kept=kept)
    predicted = np.array(_predicted(full, predict))
    everything = np.arange(len(plan.calibration))

    def fitted_to(used: Bool[np.ndarray, " seen"]) -> Refit:
        return fit_jointly(problem, full.variables, used, kept=kept)

    for block in plan.blocks if len(plan.blocks) > 1 else ():
        left_out = plan.calibration[block]
        predicted[left_out] = _predicted(fitted_to(~np.isin(everything, block)), predict)[left_out]
    known = np.unique(plan.speeds)
    if len(known) < 2:
        return CrossFit(full, predicted, (), predicted if plan.new_speed.any() else None)
    of_speeds = tuple(fitted_to(plan.speeds == speed) for speed in known)
    if plan.new_speed.any():
        return CrossFit(full, predicted, of_speeds, predicted)
    elsewhere = np.array(predicted)
    for number, speed in enumerate(np.unique(speeds[plan.calibration])):
        # Of two speeds, the fit to the other one is there already.
        other = of_speeds[1 - number] if len(known) == 2 else fitted_to(plan.speeds != known[number])
        cycles = speeds == speed
        elsewhere[cycles] = _predicted(other, predict)[cycles]
    return CrossFit(full, predicted, of_speeds, elsewhere)


def speed_conflict(fit: CrossFit, effect_size_weight: float) -> float | None:
    """Give how far amounts fitted to two speeds are apart, in squared standard deviations.

    The mean over amounts, and of several speeds the largest; None where there is one speed.
    """
    count = len(fit.full.problem.amount_sd)
    if len(fit.of_speeds) < 2 or not count:
        return None
    found = [
        (refit.effect_sizes, effect_size_covariance(refit, effect_size_weight)) for refit in fit.of_speeds
    ]
    worst = 0.0
    for place, (effect_sizes, covariance) in enumerate(found):
        for other, spread in found[:place]:
            apart = effect_sizes - other
            worst = max(worst, float(apart @ np.linalg.solve(covariance + spread, apart)) / count)
    return worst


def effect_size_covariance(refit: Refit, effect_size_weight: float) -> Float[np.ndarray, "amount amount"]:
    """Covariance of amounts in their units, by Laplace; the weight turns curvature of the cost into it."""
    curvature = np.asarray(refit.model.gauss_newton)
    count, sizes = refit.problem.plain.variables.count, np.asarray(refit.problem.amount_sd)
    kept = curvature[:count, :count] + 1e-9 * np.trace(curvature) / len(curvature) * np.eye(count)
    across = curvature[:count, count:]
    own = curvature[count:, count:] - across.T @ np.linalg.solve(kept, across)
    # A fit to some cycles lets them weigh what all did, and they say less.
    seen = np.mean(np.isfinite(refit.problem.plain.moment_error))
    unit = effect_size_weight / seen * np.linalg.inv(0.5 * (own + own.T))
    return unit * np.outer(sizes, sizes)


def _predicted(refit: Refit, predict: Predict) -> Float[np.ndarray, "cycle coordinate frame"]:
    return np.asarray(predict(refit.calibrated, refit.effect_sizes))
