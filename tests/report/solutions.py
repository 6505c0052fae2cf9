"""Calibration results with a changed solution."""

from dataclasses import replace
from typing import Any

from wrapjax.calibration.calibration_result import CalibrationResult


def with_solution(result: CalibrationResult, **changes: Any) -> CalibrationResult:
    """Change fields of the solution of the only start."""
    outcome = replace(result.outcomes[0], solution=replace(result.solution, **changes))
    return replace(result, outcomes=(outcome,))
