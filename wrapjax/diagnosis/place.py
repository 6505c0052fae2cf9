"""Where the plain model's error is, and whether that model was fitted well enough to ask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from wrapjax.calibration.objective import MOMENT_ERROR, Objective
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.convergence_check import check_convergence, conflict, decrement_of
from wrapjax.diagnosis.cycle_noise import CycleNoise
from wrapjax.diagnosis.error_budget import Budget, driven_variance, repeatable_error_map, split_error
from wrapjax.diagnosis.held_out import CrossFit, Plan
from wrapjax.diagnosis.refit import fit_jointly
from wrapjax.diagnosis.result import ConvergenceCheck, Estimate
from wrapjax.diagnosis.shrinkage import Floor, cycle_errors, cycle_floor, explainable_share


@dataclass(frozen=True)
class InputMade:
    """What errors of EMG and angles make of differences between cycles, (N m)^2.

    Parameters
    ----------
    variance
        Of the moments by these errors: it follows inputs, yet no model takes it away.
    beside
        Variance that no input makes, alike at all phases.
    """

    variance: Float[np.ndarray, "coordinate phase"]
    beside: Float[np.ndarray, " coordinate"]


@dataclass(frozen=True)
class Where:
    """The plain model's error on cycles that it has not seen.

    Parameters
    ----------
    residual
        Measured less predicted moments, N m.
    budget, speeds
        Its parts, and the speed of each row, m/s; of speeds with two cycles or more.
    map
        Root mean square of what repeats, N m: see `repeatable_error_map`.
    floor
        What a right model would leave of each cycle.
    explainable
        Share of the whole error that it would not.
    """

    residual: Float[np.ndarray, "cycle coordinate frame"]
    budget: Budget
    speeds: Float[np.ndarray, " speed"]
    map: Float[np.ndarray, "speed coordinate bin"]
    floor: Floor
    explainable: Estimate


def where(
    residual: Float[np.ndarray, "cycle coordinate frame"],
    speeds: Int[np.ndarray, " cycle"],
    speeds_m_s: Float[np.ndarray, " cycle"],
    inputs: Float[np.ndarray, "cycle input frame"],
    independent: float,
    made: InputMade | None = None,
) -> Where:
    """Split the error of cycles that fits have not seen.

    Parameters
    ----------
    residual
        N m.
    speeds, speeds_m_s
        Counted from 0, and as they are.
    inputs
        What may drive differences between cycles, any units.
    independent
        Number of independent values of noise in a cycle, over all coordinates.
    made
        What errors of inputs make of differences between cycles; nothing where it is not known.
    """
    several = np.flatnonzero(np.bincount(speeds)[speeds] > 1)
    kept, own = np.unique(speeds[several], return_inverse=True)
    driven = driven_variance(residual[several], inputs[several], own)
    if made is None:
        between = np.stack(
            [residual[several][own == speed].var(axis=0, ddof=1) for speed in range(len(kept))]
        )
        noise = between - driven
    else:
        noise = np.broadcast_to(made.beside[:, None], driven.shape)
        # In the mean over all: frame by frame, noise on the wrong side would be cut off and that on the other
        # left.
        whole = np.mean(driven, axis=(1, 2), keepdims=True)
        left = 1.0 - made.variance.mean() / np.where(whole > 0.0, whole, np.inf)
        driven = np.maximum(left, 0.0) * driven
    mapped = repeatable_error_map(residual[several], own, noise)
    by_speed = np.zeros(speeds.max() + 1)
    by_speed[kept] = driven.mean(axis=(1, 2))
    floor = cycle_floor(residual, speeds, independent, by_speed)
    first = [int(np.flatnonzero(speeds == speed)[0]) for speed in kept]
    return Where(
        residual,
        split_error(residual[several], own, driven),
        speeds_m_s[first],
        mapped,
        floor,
        explainable_share(cycle_errors(residual), floor, speeds),
    )


def effect_size_weight(noise: CycleNoise, cycles: int) -> float:
    """Say what a squared prior standard deviation costs, beside moments with this noise.

    A calibration's cost is a mean square in allowable errors. Times half the number of independent moments
    and their squared allowable error over their noise, it is a negative log likelihood.
    """
    return float(np.mean(np.diag(noise.between)) / (MOMENT_ERROR**2 * cycles * noise.independent_values))


def convergence_check_of(
    outcomes: Sequence[Outcome],
    plain: CrossFit,
    place: Where,
    problem: Objective,
    plan: Plan,
    weight: float,
) -> ConvergenceCheck:
    """Judge the plain model's fit.

    Parameters
    ----------
    outcomes
        Where each start led.
    plain, place
        The model, fitted to parts of the cycles as well, and what it leaves.
    problem, plan
        What was fitted.
    weight
        From `effect_size_weight`.
    """
    full = plain.full
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    curvature = np.asarray(full.model.gauss_newton)
    width = np.maximum(upper - lower, 1e-12)
    # Of each of two fits to half of the cycles.
    sd = np.sqrt(2.0 * weight * np.diag(np.linalg.inv(curvature + weight * np.diag(1.0 / width**2))))
    labels = problem.variables.labels
    odd, even = (
        fit_jointly(full.problem, full.variables, np.arange(len(plan.speeds)) % 2 == half).calibrated
        for half in (1, 0)
    )
    conflicts = {"by_half": conflict(labels, odd, even, sd)}
    if len(plain.of_speeds) == 2:
        slow, fast = (refit.calibrated for refit in plain.of_speeds)
        conflicts["by_speed"] = conflict(labels, slow, fast, sd)
    explainable = float(np.mean(np.maximum(cycle_errors(place.residual) - place.floor.each, 0.0)))
    decrement = decrement_of(full.model, full.variables, lower, upper)
    return check_convergence(outcomes, decrement, explainable / MOMENT_ERROR**2, conflicts)
