"""Hard limits at the solution: which ones push, and how hard."""

from __future__ import annotations

from typing import Any

from wrapjax.calibrate import CalibrationResult


def pushing_muscles(result: CalibrationResult) -> dict[str, tuple[str, ...]]:
    """Name the muscles that push against each hard limit; empty without limits."""
    return {
        name: tuple(
            muscle for muscle, own in zip(result.muscles, multipliers, strict=True) if (own > 0.0).any()
        )
        for name, multipliers in result.solution.multipliers.items()
    }


def describe_limits(result: CalibrationResult) -> dict[str, dict[str, Any]]:
    """Say of each limit how many values push against it, which muscles, and the largest multiplier.

    A multiplier is how much the cost would fall for one unit of room (normalised fiber length, or cm of
    moment arm).
    """
    muscles = pushing_muscles(result)
    return {
        name: {
            "pushing": int((multipliers > 0.0).sum()),
            "muscles": list(muscles[name]),
            "largest_multiplier": float(multipliers.max(initial=0.0)),
        }
        for name, multipliers in result.solution.multipliers.items()
    }
