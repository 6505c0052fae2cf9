"""The solver in the report: how it got there, what limits held it, what the cost is made of."""

from __future__ import annotations

from typing import Any

from wrapjax.calibrate import CalibrationResult
from wrapjax.report import markup
from wrapjax.report.parameter_figures import cost_figure, history_figure
from wrapjax.report.wording import counted, decimals, plain


def solver_section(result: CalibrationResult, summary: dict[str, Any]) -> str:
    """Write the part of the report on the solver."""
    largest = max(result.cost_by_term, key=lambda name: result.cost_by_term[name])
    history = result.solution.history
    seconds = summary["seconds"]
    paths = (
        " Where paths may change, the first iterations still hold them; the cost jumps where the hard limits "
        "come in, and where they are enforced more strictly."
        if result.freedom.moving_paths is not None
        else ""
    )
    return markup.section(
        "Solver",
        markup.paragraph(
            f"{counted(summary['starts'], 'start')} in {seconds['solve']:.1f} s, after "
            f"{seconds['compile']:.1f} s of compiling. The one taken needed "
            f"{counted(summary['iterations'], 'iteration')} for {summary['n_variables']} variables and "
            f"{summary['n_residuals']} moment residuals. {summary['message']}"
        ),
        *_limits(result, summary),
        markup.picture(
            history_figure(result),
            alternative=f"Cost and optimality by iteration. The cost falls from {decimals(history[0].cost)} "
            f"to {decimals(history[-1].cost)}; optimality ends at {history[-1].optimality:.2g}.",
            caption="Of the start that was taken: the cost that is minimised, and optimality (the largest "
            "move that steepest descent within the bounds would still make, in solver units), by iteration. "
            f"Both scales are logarithmic.{paths}",
        ),
        markup.picture(
            cost_figure(result),
            alternative=f"Parts of the cost at the solution; the largest is {plain(largest)}, "
            f"{result.cost_by_term[largest]:.3g} of {summary['cost']:.4g}.",
            caption="Parts of the cost at the solution. Each is a mean square in allowable errors: 1 means "
            "an error as large as allowed.",
        ),
    )


def _limits(result: CalibrationResult, summary: dict[str, Any]) -> list[str]:
    limits = summary["limits"]
    if not limits:
        return []
    kept = summary["max_constraint_violation"] <= result.solver.ctol
    return [
        markup.paragraph(
            "Hard limits hold fiber lengths and the signs of moment arms on the calibration cycles. "
            + ("They are kept" if kept else "They are not kept")
            + f": the largest excess is {summary['max_constraint_violation']:.1g}, where "
            f"{result.solver.ctol:.0e} is allowed (normalised fiber length, or cm of moment arm)."
        ),
        markup.table(
            ("limit", "values that push", "largest multiplier", "largest excess", "muscles"),
            [
                (
                    plain(name),
                    str(own["pushing"]),
                    f"{own['largest_multiplier']:.2g}",
                    f"{own['largest_excess']:.1g}",
                    ", ".join(own["muscles"]) or "none",
                )
                for name, own in limits.items()
            ],
            caption="Hard limits that push against the solution. The multiplier is how much the cost would "
            "fall for one unit of room.",
        ),
    ]
