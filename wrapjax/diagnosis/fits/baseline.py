"""Baseline fit: the plain model fitted to all and parts of the cycles, and the check of its convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.calibration.solvers.interface import Linearization
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.effects.effect import Effects
from wrapjax.diagnosis.fits.cross_validation import CrossFit, cross_fit
from wrapjax.diagnosis.fits.joint_fit import fit_jointly, joint_problem
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames
from wrapjax.diagnosis.null_hypotheses.cycle_noise import CycleNoise, cycle_noise
from wrapjax.diagnosis.null_hypotheses.noise_floor import (
    NoiseFloor,
    RepeatedCycles,
    cycle_errors,
    input_driven_variance,
    noise_floor,
)

#: Largest relative difference of the costs of the two best starts; and largest share of the explainable error
#: by which the cost could still fall. Beyond either, the residual may be that of an unfinished fit.
MAX_SPREAD, MAX_DECREMENT = 0.01, 0.01


@dataclass(frozen=True)
class ConvergenceCheck:
    """Whether several starts agree, and whether the cost of the baseline fit could fall further.

    Parameters
    ----------
    problems
        Sentences that say what is wrong; none if the check holds.
    costs
        Cost at which each start ended, lowest first.
    spread
        Relative difference of the two lowest costs.
    decrement
        Possible further fall of the cost, as a share of the explainable error.
    conflicts
        Root mean square difference, by kind of parameter and in standard deviations, between fits to each
        speed (``by_speed``) and between fits to each half of the cycles (``by_half``).
    """

    problems: tuple[str, ...]
    costs: tuple[float, ...]
    spread: float
    decrement: float
    conflicts: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether a diagnosis may use the fit."""
        return not self.problems


@dataclass(frozen=True)
class BaselineFit:
    """Fits of the plain model, and the error that they leave on held-out cycles.

    Parameters
    ----------
    fit
        Fits to all calibration cycles and to parts of them.
    residual
        Measured less predicted moments of all cycles, N m, each from a fit that did not use it.
    driven_variance
        Input-driven variance between cycles at each speed with two cycles or more, (N m)^2.
    noise_floor
        Noise floor of each cycle; a first estimate, in which all input-driven variance could be explained.
    effect_size_weight
        Cost of a squared effect size of one prior standard deviation in joint fits.
    convergence_check
        Whether the fit may be used.
    """

    fit: CrossFit
    residual: Float[np.ndarray, "cycle coordinate frame"]
    driven_variance: Float[np.ndarray, "speed coordinate frame"]
    noise_floor: NoiseFloor
    effect_size_weight: float
    convergence_check: ConvergenceCheck

    @property
    def variables(self) -> Float[np.ndarray, " variable"]:
        """Calibrated variables of the fit to all calibration cycles."""
        return self.fit.full.calibrated


def fit_baseline(data: DiagnosisInput) -> BaselineFit:
    """Fit the plain model to all calibration cycles and to parts of them, and check its convergence.

    Parameters
    ----------
    data
        Input with at least two calibration cycles at one speed.
    """
    plan, problem, speeds = data.plan, data.problem, data.speeds
    no_effects = Effects(())
    fit = cross_fit(
        joint_problem(problem, no_effects, data.variables, np.zeros(0), 0.0),
        data.variables,
        plan,
        speeds,
        data.prediction(no_effects),
        data.cache,
    )
    residual = data.measured - fit.predicted
    noise = cycle_noise(residual[plan.calibration][..., phase_frames(residual.shape[-1])], plan.speeds)
    repeated = RepeatedCycles.of(speeds)
    driven = input_driven_variance(residual[repeated.cycles], data.inputs[repeated.cycles], repeated.number)
    floor = noise_floor(residual, speeds, noise.independent_values, repeated.by_speed(driven))
    weight = effect_size_weight(noise, len(plan.calibration))
    explainable = float(np.mean(np.maximum(cycle_errors(residual) - floor.by_cycle, 0.0)))
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    check = check_convergence(
        data.outcomes,
        attainable_decrease(fit.full.model, fit.full.variables, lower, upper),
        explainable / MOMENT_ERROR**2,
        _conflicts(data, fit, weight),
    )
    return BaselineFit(fit, residual, driven, floor, weight, check)


def effect_size_weight(noise: CycleNoise, cycles: int) -> float:
    """Compute the cost of a squared prior standard deviation relative to moments with this noise.

    The cost of a calibration is a mean square in allowable errors. Multiplied by half the number of
    independent moments and by the squared ratio of allowable error to noise, it is a negative log likelihood.
    """
    return float(np.mean(np.diag(noise.between)) / (MOMENT_ERROR**2 * cycles * noise.independent_values))


def _conflicts(data: DiagnosisInput, fit: CrossFit, weight: float) -> dict[str, dict[str, float]]:
    """Compare fits to odd and even cycles, and fits to two speeds."""
    problem, full = data.problem, fit.full
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    curvature = np.asarray(full.model.gauss_newton)
    width = np.maximum(upper - lower, 1e-12)
    # Standard deviation of each of two fits to half of the cycles.
    sd = np.sqrt(2.0 * weight * np.diag(np.linalg.inv(curvature + weight * np.diag(1.0 / width**2))))
    labels = problem.variables.labels
    number = np.arange(len(data.plan.speeds))
    odd, even = (fit_jointly(full.problem, full.variables, number % 2 == half).calibrated for half in (1, 0))
    conflicts = {"by_half": parameter_conflict(labels, odd, even, sd)}
    if len(fit.of_speeds) == 2:
        slow, fast = (of_speed.calibrated for of_speed in fit.of_speeds)
        conflicts["by_speed"] = parameter_conflict(labels, slow, fast, sd)
    return conflicts


def check_convergence(
    outcomes: Sequence[Outcome],
    decrease: float,
    explainable: float,
    conflicts: Mapping[str, Mapping[str, float]],
) -> ConvergenceCheck:
    """Check a fit from several starts.

    Parameters
    ----------
    outcomes
        Result of each start.
    decrease
        Possible further fall of the cost; see `attainable_decrease`.
    explainable
        Cost of the explainable error.
    conflicts
        See `ConvergenceCheck`.
    """
    ordered = sorted(outcomes, key=lambda one: _finite_cost(one.solution.cost))
    costs, spread = _costs_and_spread(outcomes)
    share = 0.0 if explainable <= 0.0 else decrease / explainable
    problems = []
    if not any(one.solution.status.converged for one in outcomes):
        problems.append(f"no start converged: {ordered[0].solution.status.value}")
    if np.isfinite(costs).sum() < 2:
        problems.append("a fit from one start cannot show that it is the best one")
    # Written as ``not <=`` so that NaN is a problem.
    elif not spread <= MAX_SPREAD:
        problems.append(
            f"the two best starts end {100.0 * spread:.1f} % apart; {100.0 * MAX_SPREAD:.0f} % are allowed"
        )
    if not share <= MAX_DECREMENT:
        problems.append(
            f"further iterations could remove {100.0 * share:.1f} % of the explainable error; "
            f"{100.0 * MAX_DECREMENT:.0f} % are allowed"
        )
    return ConvergenceCheck(
        tuple(problems),
        costs,
        float(spread),
        float(share),
        {kind: dict(by_parameter) for kind, by_parameter in conflicts.items()},
    )


def starts_agree(outcomes: Sequence[Outcome]) -> bool:
    """Return whether the two lowest costs of several starts agree."""
    return _costs_and_spread(outcomes)[1] <= MAX_SPREAD


def unchecked_convergence(outcomes: Sequence[Outcome], reason: str) -> ConvergenceCheck:
    """Report the costs of the starts of a fit whose convergence was not checked further."""
    return ConvergenceCheck((reason,), *_costs_and_spread(outcomes), np.nan)


def _costs_and_spread(outcomes: Sequence[Outcome]) -> tuple[tuple[float, ...], float]:
    """Return all costs, failed starts last, and the relative difference of the two lowest."""
    costs = tuple(sorted((float(one.solution.cost) for one in outcomes), key=_finite_cost))
    known = [cost for cost in costs if np.isfinite(cost)]
    return costs, (known[1] - known[0]) / known[0] if len(known) > 1 else np.nan


def _finite_cost(cost: float) -> float:
    return cost if np.isfinite(cost) else np.inf


def attainable_decrease(
    model: Linearization,
    variables: Float[np.ndarray, " variable"],
    lower: Float[np.ndarray, " variable"],
    upper: Float[np.ndarray, " variable"],
) -> float:
    """Compute the fall of the cost by a Gauss-Newton step of the variables that no bound holds.

    Parameters
    ----------
    model, variables
        Expansion of the cost at these variables.
    lower, upper
        Bounds of the variables.
    """
    gradient = np.asarray(model.gradient)
    held = ((variables <= lower) & (gradient > 0.0)) | ((variables >= upper) & (gradient < 0.0))
    free = ~held
    curvature = np.asarray(model.gauss_newton)[np.ix_(free, free)]
    ridge = 1e-10 * np.trace(curvature) / max(len(curvature), 1) * np.eye(len(curvature))
    return float(gradient[free] @ np.linalg.solve(curvature + ridge, gradient[free]))


def parameter_conflict(
    labels: Sequence[str],
    first: Float[np.ndarray, " variable"],
    second: Float[np.ndarray, " variable"],
    sd: Float[np.ndarray, " variable"],
) -> dict[str, float]:
    """Compute the root mean square difference of two fits by kind of parameter, in standard deviations.

    Parameters
    ----------
    labels
        Label of each variable, ending in the kind of parameter: ``soleus_l.emg_scale``.
    first, second
        Variables of the two fits.
    sd
        Standard deviation of each variable in one fit.
    """
    difference = (first - second) / (np.sqrt(2.0) * sd)
    kinds = np.array([label.rsplit(".", 1)[1] for label in labels])
    return {
        str(kind): float(np.sqrt(np.mean(difference[kinds == kind] ** 2))) for kind in dict.fromkeys(kinds)
    }
