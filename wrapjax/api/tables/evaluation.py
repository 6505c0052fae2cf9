"""A finished calibration on other cycles, for a terminal."""

from __future__ import annotations

from typing import Any


def evaluation_table(content: dict[str, Any]) -> str:
    """Show errors by coordinate and use, and cycle by cycle."""
    run = content["run"]
    columns = {use: own for use, own in content["mae_Nm"].items() if own is not None}
    columns |= {f"run's {use}": own for use, own in run["mae_Nm"].items() if own is not None}
    names = (*content["coordinates"], "mean")
    width = max(map(len, (*names, *content["trials"], "coordinate")))
    lines = [
        f"{content['subject']}, predicted by the {run['method']} calibration of {run['subject']}",
        "",
        "Mean absolute error of the joint moments, N m",
        f"{'coordinate':{width}s}" + "".join(f"{name:>20s}" for name in columns),
        *(f"{name:{width}s}" + "".join(f"{own[name]:20.2f}" for own in columns.values()) for name in names),
        "",
        f"{'cycle':{width}s}{'use':>20s}{'mean':>20s}",
        *(
            f"{name:{width}s}{own['use']:>20s}{own['mae_Nm']['mean']:20.2f}"
            for name, own in content["trials"].items()
        ),
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in content["notes"])])
