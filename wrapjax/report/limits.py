"""Hard limits at the solution: which ones push, how hard, and by how much they are exceeded."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from wrapjax.calibrate import CalibrationResult
from wrapjax.model import MuscleState

#: Limits on fiber length, in the order of `wrapjax.calibrate.FIBER_LENGTH_RANGE`.
FIBER_LIMITS = ("shortest_fiber", "longest_fiber")


def pushing_muscles(result: CalibrationResult) -> dict[str, tuple[str, ...]]:
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
    muscles, excess = pushing_muscles(result), largest_excess(result)
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
