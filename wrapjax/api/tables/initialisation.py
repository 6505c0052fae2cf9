"""Lengths to start from, for a terminal."""

from __future__ import annotations

from typing import Any


def initialisation_table(content: dict[str, Any]) -> str:
    """Show lengths before and after, and what passive moments say."""
    width = max(map(len, (*content["muscles"], "coordinate")))
    lines = [f"{content['subject']}: {content['message']}", ""]
    if content["passive_mae_Nm"]:
        lines += [
            "Mean absolute error of passive moments, N m",
            f"{'coordinate':{width}s}{'before':>12s}{'after':>12s}",
        ]
        lines += [
            f"{name:{width}s}{own['before']:12.2f}{own['after']:12.2f}"
            for name, own in content["passive_mae_Nm"].items()
        ]
        lines.append("")
    lines += [
        "Lengths in mm (before, after), and normalised fiber lengths in walking after",
        f"{'muscle':{width}s}{'fiber':>16s}{'slack':>18s}{'range':>16s}",
    ]
    for muscle, own in content["muscles"].items():
        pairs = [
            f"{1e3 * own[name]['before']:8.1f}{1e3 * own[name]['after']:8.1f}"
            for name in ("optimal_fiber_length_m", "tendon_slack_length_m")
        ]
        low, high = own["normalized_fiber_length"]["after"]
        lines.append(f"{muscle:{width}s}{pairs[0]}  {pairs[1]}{low:9.2f} to {high:.2f}")
    return "\n".join([*lines, *(f"note: {note}" for note in content["notes"])])
