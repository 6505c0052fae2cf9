"""A calibration for a terminal: a line an iteration, and errors before and after."""

from __future__ import annotations

import sys

from wrapjax.api.calibrating.calibration import Calibration
from wrapjax.calibrate import CalibrationResult, Iteration, LagrangianState, Watch
from wrapjax.evaluate import moment_errors, pooled_mae


def iteration_printer(*, quiet: bool = False) -> Watch | None:
    """Give a callback that prints one line an iteration to standard error."""
    if quiet:
        return None

    def line(start: int, iteration: Iteration, state: LagrangianState) -> None:
        if iteration.number == 0:
            _report("start  iteration        cost  optimality   damping      step  at bounds  seconds")
        _report(
            f"{start:5d}  {iteration.number:9d}  {iteration.cost:10.5g}  {iteration.optimality:10.2e}  "
            f"{iteration.damping:8.1e}  {iteration.step:8.1e}  {iteration.at_bounds:9d}  "
            f"{iteration.seconds:7.2f}"
        )

    return line


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def calibration_table(calibration: Calibration) -> str:
    """Show how the solver fared, and mean absolute moment errors before and after, by use of trials."""
    result = calibration.result
    columns: dict[str, dict[str, float]] = {}
    for use in ("calibration", "validation"):
        rows = [row for row, own in enumerate(result.uses) if own == use]
        for label, modelled in (("before", result.initial_modelled), ("after", result.modelled)):
            errors = [moment_errors(result.measured[row], modelled[row]) for row in rows]
            pooled = pooled_mae(errors, result.coordinates)
            if pooled:
                columns[f"{use} {label}"] = pooled
    width = max(len(name) for name in (*result.coordinates, "coordinate"))
    lines = [
        f"{result.method} of {calibration.subject.name}: {calibration.status.value}",
        *_solver_lines(result),
        "",
        "Mean absolute error of the joint moments, N m",
        f"{'coordinate':{width}s}" + "".join(f"{name:>20s}" for name in columns),
    ]
    for name in (*result.coordinates, "mean"):
        lines.append(f"{name:{width}s}" + "".join(f"{pooled[name]:20.2f}" for pooled in columns.values()))
    return "\n".join(lines)


def _solver_lines(result: CalibrationResult) -> list[str]:
    """Say how starts, limits and paths fared, each where there is something to say."""
    from wrapjax.report.limits import describe_limits
    from wrapjax.report.starts import equally_good
    from wrapjax.report.summary import geometry_change

    solution, count = result.solution, len(result.outcomes)
    costs = [outcome.solution.cost for outcome in result.outcomes]
    starts = f"{count} start{'s' if count > 1 else ''} in {result.solve_seconds:.2f} s (compiling "
    starts += f"{result.compile_seconds:.1f} s)"
    if count > 1:
        starts += f", costs {min(costs):.5g} to {max(costs):.5g}; {equally_good(result).sum()} of {count} "
        starts += f"within 1 % of the one taken, start {result.chosen}"
    lines = [
        starts,
        f"{solution.iterations} iterations, cost {solution.cost:.6g}, {len(result.at_bounds)} of "
        f"{len(solution.variables)} variables at a bound",
    ]
    if limits := describe_limits(result):
        pushing = sum(limit["pushing"] for limit in limits.values())
        muscles = set().union(*(limit["muscles"] for limit in limits.values()))
        lines.append(
            f"hard limits: largest violation {solution.max_violation:.1e} (allowed "
            f"{result.solver.ctol:.0e}); {pushing} values of {len(muscles)} muscles push against one"
        )
    moving = result.freedom.moving_paths
    if moving is not None:
        change = geometry_change(result)
        lines.append(
            f"paths of {moving.sum()} muscles free: on average over all "
            f"{len(result.muscles)}, lengths changed by {1e3 * change['length_mae_m']:.2f} mm, moment "
            f"arms by {1e3 * change['moment_arm_mae_m']:.2f} mm"
        )
    return lines
