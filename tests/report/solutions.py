"""The same calibration with another ending."""

from dataclasses import replace
from typing import Any

from wrapjax.calibration.result import CalibrationResult


def ended(result: CalibrationResult, **changes: Any) -> CalibrationResult:
    """Change the solution of the one start."""
    outcome = replace(result.outcomes[0], solution=replace(result.solution, **changes))
    return replace(result, outcomes=(outcome,))
