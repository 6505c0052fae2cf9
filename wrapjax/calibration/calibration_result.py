"""Result of a calibration as arrays, and its active hard limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian, ConstrainedSolution
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.model.forward import MuscleState
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters


@dataclass(frozen=True)
class CalibrationResult:
    """Calibrated parameters of a leg, and the states and moments of the model over all recorded cycles.

    Parameters
    ----------
    method
        Name of the freedom.
    muscles, coordinates, trials
        Names along the axes of the arrays.
    uses
        Use of each trial, such as ``calibration``.
    speeds
        Walking speed of each trial, m/s; NaN where unknown.
    tasks, recordings
        Task and recording of each trial.
    time
        Time of every frame, s.
    initial, parameters
        Parameter trees before and after calibration.
    freedom
        Selection of calibrated parameters, with its bounds and priors.
    at_bounds
        Names of the variables at a bound at the solution, as ``soleus_l.emg_scale``.
    labels
        Names of the variables.
    geometry
        Source of the paths: ``opensim``, ``engine`` or ``engine-parity``.
    paths, calibrated_paths
        Polynomial paths before and after calibration; None where paths are exact.
    measured, modelled, initial_modelled
        Joint moments, N m: measured (NaN where none was), of the calibrated model, and of the initial model.
    states, initial_states
        States of all muscles over all cycles, after and before calibration.
    cost_by_term
        Cost of each term at the solution.
    curves
        Name of the Hill curves.
    tendon, muscle_law
        Kind of tendon, and name of the muscle law.
    outcomes
        Result of each start.
    chosen
        Number of the start whose result was taken.
    solver
        Solver with its tolerances.
    n_residuals
        Number of measured moments that were matched.
    compile_seconds
        Time for compilation, which is not part of `solve_seconds`, s.
    """

    method: str
    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
    tasks: tuple[str, ...]
    recordings: tuple[str, ...]
    time: Float[np.ndarray, "trial frame"]
    initial: ModelParameters
    parameters: ModelParameters
    freedom: Freedom
    at_bounds: tuple[str, ...]
    labels: tuple[str, ...]
    geometry: str
    paths: PathSurrogate | None
    calibrated_paths: PathSurrogate | None
    measured: Float[np.ndarray, "trial coordinate frame"]
    modelled: Float[np.ndarray, "trial coordinate frame"]
    initial_modelled: Float[np.ndarray, "trial coordinate frame"]
    states: MuscleState
    initial_states: MuscleState
    cost_by_term: dict[str, float]
    curves: str
    tendon: str
    muscle_law: str
    solver: AugmentedLagrangian
    outcomes: tuple[Outcome, ...]
    chosen: int
    n_residuals: int
    compile_seconds: float

    @property
    def solution(self) -> ConstrainedSolution:
        """Solution of the start that was taken."""
        return self.outcomes[self.chosen].solution

    @property
    def solve_seconds(self) -> float:
        """Time of the solves from all starts without compilation, s."""
        return sum(outcome.seconds for outcome in self.outcomes)


#: Limits on fiber length, in the order of `wrapjax.calibration.path_penalties.FIBER_LENGTH_RANGE`.
FIBER_LIMITS = ("shortest_fiber", "longest_fiber")


def muscles_at_limits(result: CalibrationResult) -> dict[str, tuple[str, ...]]:
    """List the muscles with a nonzero multiplier of each hard limit; empty without limits."""
    return {
        name: tuple(
            muscle for muscle, own in zip(result.muscles, multipliers, strict=True) if (own > 0.0).any()
        )
        for name, multipliers in result.solution.multipliers.items()
    }


def describe_limits(result: CalibrationResult) -> dict[str, dict[str, Any]]:
    """Describe each hard limit at the solution.

    Returns
    -------
    dict
        By limit: ``pushing`` (number of values in the calibration cycles with a nonzero multiplier), their
        ``muscles``, ``largest_multiplier`` (decrease of the cost per unit by which the limit is relaxed) and
        ``largest_excess`` in the limit's unit (normalised fiber length, cm of moment arm, feasibility score),
        0 where the limit is satisfied.
    """
    muscles, excess = muscles_at_limits(result), largest_excess(result)
    return {
        name: {
            "pushing": int((multipliers > 0.0).sum()),
            "muscles": list(muscles[name]),
            "largest_multiplier": float(multipliers.max(initial=0.0)),
            "largest_excess": excess[name],
        }
        for name, multipliers in result.solution.multipliers.items()
    }


def largest_excess(result: CalibrationResult) -> dict[str, float]:
    """Compute the largest excess over each limit in the calibration cycles, in the limit's unit."""
    calibrated = np.array([use == "calibration" for use in result.uses])
    states = _select_trials(result.states, calibrated)
    largest = {}
    for limit in result.solution.problem.limits:
        excess = np.asarray(limit.excess(limit.values(result.parameters, states)))
        largest[limit.name] = float(np.maximum(excess, 0.0).max())
    return largest


def of_trials(result: CalibrationResult, chosen: Bool[np.ndarray, " trial"]) -> CalibrationResult:
    """Return the result with the curves of some trials."""

    def pick(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for name, keep in zip(names, chosen, strict=True) if keep)

    return replace(
        result,
        trials=pick(result.trials),
        uses=pick(result.uses),
        tasks=pick(result.tasks),
        recordings=pick(result.recordings),
        speeds=result.speeds[chosen],
        time=result.time[chosen],
        measured=result.measured[chosen],
        modelled=result.modelled[chosen],
        initial_modelled=result.initial_modelled[chosen],
        states=_select_trials(result.states, chosen),
        initial_states=_select_trials(result.initial_states, chosen),
    )


def _select_trials(states: MuscleState, chosen: Bool[np.ndarray, " trial"]) -> MuscleState:
    """Select trials; the infeasibility of wraps, ``muscle wrap``, does not depend on trials."""
    return jax.tree.map(lambda leaf: leaf[:, chosen] if leaf.ndim > 2 else leaf, states)
