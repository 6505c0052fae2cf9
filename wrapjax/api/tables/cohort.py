"""A cohort for a terminal."""

from __future__ import annotations

from typing import Any


def cohort_table(content: dict[str, Any]) -> str:
    """Show every subject on a line, and the population below."""
    width = max(map(len, (*content["subjects"], "subject")))
    lines = [
        "Mean absolute error of the joint moments, N m",
        f"{'subject':{width}s}{'calibration':>14s}{'validation':>14s}  result",
    ]
    for name, own in content["subjects"].items():
        if own["state"] != "done":
            lines.append(f"{name:{width}s}{'-':>14s}{'-':>14s}  failed: {own['message']}")
            continue
        errors = (own["mae_Nm"][use] for use in ("calibration", "validation"))
        cells = "".join(f"{'-' if one is None else format(one['mean'], '.2f'):>14s}" for one in errors)
        gap = own["diagnosis"]
        said = "converged" if own["converged"] else "did not converge"
        lines.append(f"{name:{width}s}{cells}  {said}{'' if gap is None else ', ' + gap['outcome']}")
    return "\n".join(lines)
