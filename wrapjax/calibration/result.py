"""What a calibration found, as plain arrays.

Hard limits at the solution: which ones push, how hard, and by how much they are exceeded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian, ConstrainedSolution
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.model.forward import MuscleState
from wrapjax.model.freedom import Freedom
from wrapjax.model.parameters import ModelParameters


@dataclass(frozen=True)
class CalibrationResult:
    """A calibrated model and how it behaves on every recorded cycle.

    Parameters
    ----------
    method
        Name of the freedom.
    muscles, coordinates, trials
        Names along the axes; ``uses`` says what each trial was for, ``speeds`` is in m/s (NaN: unknown).
    time
        Of every frame, in s.
    initial, parameters
        Before and after calibration.
    freedom
        What was free, with its bounds.
    at_bounds
        Variables that ended on a bound, as ``soleus_l.emg_scale``.
    labels
        Names of the variables.
    geometry
        Where paths came from: ``opensim``, ``engine`` or ``engine-parity``.
    paths, calibrated_paths
        As polynomials, before and after calibration; None where paths are exact.
    measured, modelled, initial_modelled
        Joint moments in N m; the last before calibration.
    states, initial_states
        All muscles over all cycles.
    cost_by_term
        The parts of the cost at the solution.
    curves
        Name of the Hill curves.
    tendon
        Kind of tendon.
    outcomes, chosen
        Where each start led, and the number of the one that was taken.
    solver
        With its tolerances.
    n_residuals
        Number of measured moments that were matched.
    compile_seconds
        Time that went into compiling, apart from solving.
    """

    method: str
    muscles: tuple[str, ...]
    coordinates: tuple[str, ...]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    speeds: Float[np.ndarray, " trial"]
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
    solver: AugmentedLagrangian
    outcomes: tuple[Outcome, ...]
    chosen: int
    n_residuals: int
    compile_seconds: float

    @property
    def solution(self) -> ConstrainedSolution:
        """Of the start that was taken."""
        return self.outcomes[self.chosen].solution

    @property
    def solve_seconds(self) -> float:
        """Time that went into solving from all starts, compiling apart."""
        return sum(outcome.seconds for outcome in self.outcomes)


#: Limits on fiber length, in the order of `wrapjax.calibration.path_penalties.FIBER_LENGTH_RANGE`.
FIBER_LIMITS = ("shortest_fiber", "longest_fiber")


def muscles_at_limits(result: CalibrationResult) -> dict[str, tuple[str, ...]]:
    """Name the muscles that push against each hard limit; empty without limits."""
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
        By limit: ``pushing`` (how many values of the calibration cycles do), their ``muscles``,
        ``largest_multiplier`` (how much the cost would fall for one unit of room) and ``largest_excess``
        in the limit's unit (normalised fiber length, cm of moment arm or clearance, the feasibility's
        score), 0 where it is kept.
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
    """Give by how much each limit is exceeded at most on the calibration cycles, in its unit."""
    kept = np.array([use == "calibration" for use in result.uses])
    states = _of_trials(result.states, kept)
    found = {}
    for limit in result.solution.problem.limits:
        excess = np.asarray(limit.excess(limit.values(result.parameters, states)))
        found[limit.name] = float(np.maximum(excess, 0.0).max())
    return found


def _of_trials(states: MuscleState, kept: Bool[np.ndarray, " trial"]) -> MuscleState:
    """Pick trials; how feasible cylinders are, ``muscle wrap``, does not depend on them."""
    return jax.tree.map(lambda leaf: leaf[:, kept] if leaf.ndim > 2 else leaf, states)
