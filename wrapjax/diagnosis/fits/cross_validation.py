"""Cross-validation: blocks of cycles that are left out together, and fits without them.

Errors on held-out cycles confirm a finding; they must not select one, since a wrong mechanism fits left-out
cycles of the same walk almost as well as the right one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.fits.joint_fit import JointFit, JointProblem, fit_jointly
from wrapjax.io.store import Store
from wrapjax.threads import map_in_threads

#: Largest number of blocks; with fewer cycles than this at any speed, single cycles are left out.
BLOCKS = 5

#: Function from calibrated variables and effect sizes to the moments of all cycles, N m.
PredictMoments = Callable[
    [Float[np.ndarray, " variable"], Float[np.ndarray, " effect_size"]],
    Float[np.ndarray, "cycle coordinate frame"],
]


@dataclass(frozen=True)
class CrossValidationPlan:
    """Calibration cycles, and the blocks of them that are left out together.

    Parameters
    ----------
    calibration
        Indices of the calibration cycles among all cycles.
    blocks
        Left-out blocks: for each, the positions of its cycles among the calibration cycles.
    speeds
        Speed number of each calibration cycle, counted from 0.
    new_speed
        Whether each cycle, among all, has a speed that no calibration cycle has.
    """

    calibration: Int[np.ndarray, " fitted"]
    blocks: tuple[Int[np.ndarray, " _"], ...]
    speeds: Int[np.ndarray, " fitted"]
    new_speed: Bool[np.ndarray, " cycle"]

    @property
    def counts(self) -> Int[np.ndarray, " speed"]:
        """Number of calibration cycles at each speed."""
        return np.bincount(self.speeds)


def cross_validation_plan(uses: Sequence[str], speeds: Int[np.ndarray, " cycle"]) -> CrossValidationPlan:
    """Divide the calibration cycles into blocks that are left out one after the other.

    Parameters
    ----------
    uses
        Use of each cycle: ``calibration`` or another one.
    speeds
        Speed number of each cycle, counted from 0.
    """
    calibration = np.flatnonzero([use == "calibration" for use in uses])
    known = np.unique(speeds[calibration])
    number = np.searchsorted(known, speeds[calibration])
    # Position of each cycle among those of its speed: each block gets cycles of every speed.
    turn = np.array([np.sum(number[:place] == speed) for place, speed in enumerate(number)])
    few = not len(number) or np.bincount(number).min() < BLOCKS
    turn = np.arange(len(number)) if few else turn % BLOCKS
    blocks = tuple(np.flatnonzero(turn == block) for block in range(turn.max() + 1)) if len(turn) else ()
    return CrossValidationPlan(calibration, blocks, number, ~np.isin(speeds, known))


@dataclass(frozen=True)
class CrossFit:
    """A model fitted to all calibration cycles, and to parts of them.

    Parameters
    ----------
    full
        Fit to all calibration cycles.
    predicted
        Predicted moments of all cycles, N m, each from a fit that did not use it.
    of_speeds
        Fits to the cycles of each speed; none if there is only one speed.
    at_other_speed
        Predicted moments, N m, each cycle's from a fit that did not use its speed; None if there is no such
        fit.
    """

    full: JointFit
    predicted: Float[np.ndarray, "cycle coordinate frame"]
    of_speeds: tuple[JointFit, ...]
    at_other_speed: Float[np.ndarray, "cycle coordinate frame"] | None


def cross_fit(
    problem: JointProblem,
    start: Float[np.ndarray, " variable"],
    plan: CrossValidationPlan,
    speeds: Int[np.ndarray, " cycle"],
    prediction: PredictMoments,
    cache: Store | None = None,
) -> CrossFit:
    """Fit to all calibration cycles, to all but each block, and to single speeds.

    All fits but the first start where the first one ends.

    Parameters
    ----------
    problem
        Joint problem over the calibration cycles of the plan.
    start
        Variables at which the first fit starts.
    plan, speeds
        Blocks that are left out; and the speed number of each cycle, counted from 0, among all cycles.
    prediction
        Function that predicts the moments of all cycles by the same model.
    cache
        Earlier fits; see `fit_jointly`.
    """
    full = fit_jointly(problem, start, cache=cache)
    predicted = np.array(_predict(full, prediction))
    positions = np.arange(len(plan.calibration))

    def fit_to(used: Bool[np.ndarray, " fitted"]) -> JointFit:
        return fit_jointly(problem, full.variables, used, cache=cache)

    blocks = plan.blocks if len(plan.blocks) > 1 else ()
    known = np.unique(plan.speeds)
    speeds_alone = known if len(known) > 1 else known[:0]
    fits = map_in_threads(
        fit_to,
        [~np.isin(positions, block) for block in blocks] + [plan.speeds == speed for speed in speeds_alone],
    )
    for block, fit in zip(blocks, fits, strict=False):
        left_out = plan.calibration[block]
        predicted[left_out] = _predict(fit, prediction)[left_out]
    if len(known) < 2:
        return CrossFit(full, predicted, (), predicted if plan.new_speed.any() else None)
    of_speeds = tuple(fits[len(blocks) :])
    if plan.new_speed.any():
        return CrossFit(full, predicted, of_speeds, predicted)
    at_other_speed = np.array(predicted)
    for number, speed in enumerate(np.unique(speeds[plan.calibration])):
        # Of two speeds, the fit without one is the fit to the other.
        other = of_speeds[1 - number] if len(known) == 2 else fit_to(plan.speeds != known[number])
        cycles = speeds == speed
        at_other_speed[cycles] = _predict(other, prediction)[cycles]
    return CrossFit(full, predicted, of_speeds, at_other_speed)


def _predict(fit: JointFit, prediction: PredictMoments) -> Float[np.ndarray, "cycle coordinate frame"]:
    return np.asarray(prediction(fit.calibrated, fit.effect_sizes))
