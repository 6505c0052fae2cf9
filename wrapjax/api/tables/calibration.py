"""Results as plain text for a terminal."""

from __future__ import annotations

import math
import sys
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.api.calibrating.calibration import Calibration
from wrapjax.api.comparing.comparison import Comparison
from wrapjax.api.demonstration.demo import Demonstration
from wrapjax.api.paths.fitting import Fit
from wrapjax.api.paths.wrap_fit import WrapFit
from wrapjax.calibrate import CalibrationResult, Iteration, LagrangianState, Watch
from wrapjax.evaluate import moment_errors, pooled_mae

if TYPE_CHECKING:
    from wrapjax.evaluate.statistics import Spread


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


def fit_table(fit: Fit) -> str:
    """Show the errors of a fit, muscle by muscle."""
    titles = ("wrapped", "terms", "length RMSE", "length max", "arm RMSE", "arm max")
    lines = [
        "Errors on poses never used in fitting, mm (moment arms pooled over coordinates)",
        f"{'muscle':16s}" + "".join(f"{title:>13s}" for title in titles),
    ]
    for name, error in fit.errors.items():
        errors = (
            error.length_rmse_mm,
            error.length_max_mm,
            error.moment_arm_rmse_mm,
            error.moment_arm_max_mm,
        )
        wrapped = "yes" if error.wrapped else "no"
        lines.append(
            f"{name:16s}{wrapped:>13s}{error.terms:13d}" + "".join(f"{value:13.3f}" for value in errors)
        )
    return "\n".join(lines)


def wrap_table(wraps: WrapFit) -> str:
    """Show how a fit's cylinders fared, one by one."""
    titles = ("box", "physiological", "accuracy", "let through", "touched")
    lines = [
        "Cylinders, on samples never used in fitting: half width of the box (mm), share of it that leaves",
        "paths physiological, balanced accuracy of the limit, share of other samples that it lets through",
        f"{'cylinder':24s}" + "".join(f"{title:>15s}" for title in titles),
    ]
    for name, quality in wraps.quality.items():
        shares = (quality.physiological_share, quality.balanced_accuracy, quality.false_physiological)
        columns = "".join(f"{'-':>15s}" if share is None else f"{share:15.3f}" for share in shares)
        touched = "yes" if name in wraps.touched else "no"
        lines.append(f"{name:24s}{1e3 * wraps.translations[name]:15.1f}{columns}{touched:>15s}")
    return "\n".join(lines)


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


def comparison_table(comparison: Comparison) -> str:
    """Show mean and standard deviation of moment errors by speed, method and coordinate, and the unit."""
    from wrapjax.report.comparison.numbers import note

    errors = [row for row in comparison.rows if row.quantity == "moment_error"]
    items = list(dict.fromkeys(row.item for row in errors))
    groups = list(dict.fromkeys((row.use, row.speed) for row in errors))
    cells = {(row.use, row.speed, row.item): row for row in errors}
    width = max(len(f"{use}, {speed}") for use, speed in groups) + 2
    reach = max(len(method) for method in comparison.methods) + 2
    lines = [
        "Mean absolute error of the joint moments, N m: mean ± standard deviation",
        " " * (width + reach) + "".join(f"{item:>16s}" for item in items),
    ]
    for use, speed in groups:
        for number, method in enumerate(comparison.methods):
            own = [cells.get((use, speed, item)) for item in items]
            name = "" if number else f"{use}, {speed}"
            texts = ["" if row is None else mean_and_deviation(row.spreads[method]) for row in own]
            lines.append(f"{name:{width}s}{method:{reach}s}" + "".join(f"{text:>16s}" for text in texts))
    failed = [
        f"{leg.label} by {method}: {result.solution.status.value}"
        for leg in comparison.legs
        for method, result in leg.results.items()
        if not result.solution.status.converged
    ]
    return "\n".join([*lines, "", textwrap.fill(note(comparison.legs), 100), *failed])


def mean_and_deviation(spread: Spread, digits: int = 2) -> str:
    """Write ``mean ± standard deviation``, or the mean alone where there is no deviation."""
    return f"{spread.mean:.{digits}f}" + ("" if math.isnan(spread.sd) else f" ± {spread.sd:.{digits}f}")


def recovery_table(shown: Demonstration) -> str:
    """Show how close a virtual subject's calibration came to its truth."""
    lines = [
        "Distance from the hidden truth, median over muscles (same-form data: a unit test, not an accuracy).",
        "'open' is the standard deviation that the moments alone, with their noise, leave to a parameter:",
        "where it is far above the distance, priors decide and the moments cannot.",
        f"{'parameter':26s}{'before':>10s}{'after':>10s}{'open':>10s}  unit",
    ]
    for row in shown.recovery:
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(row.unit, (1.0, row.unit))
        values = (row.median_error_before, row.median_error_after, row.median_deviation)
        columns = "".join(f"{factor * value:10.3g}" for value in values)
        lines.append(f"{row.parameter:26s}{columns}  {unit}")
    return "\n".join(lines)


def wrap_recovery_table(shown: Demonstration) -> str:
    """Show how close moment arms and cylinders came to a virtual subject's own."""
    found = shown.wraps
    before, after, open_ = (
        1e3 * errors for errors in (found.error_before, found.error_after, found.deviation)
    )
    lines = [
        f"Moment arms of the {len(found.muscles)} muscles round hidden cylinders: mean absolute error, mm",
        "(same-form data: a unit test, not an accuracy). 'before' is round nominal cylinders, 'after' round",
        "those of PGA. 'open' is the standard deviation that the moments alone, with their noise, leave to",
        "an arm; 'told apart' counts muscles where that is below a tenth of the error before. Elsewhere an",
        "EMG scale or a fiber explains the moments as well, and what PGA moves need not be nearer the truth.",
        f"{'about':20s}{'before':>10s}{'after':>10s}{'open':>10s}{'told apart':>12s}",
    ]
    for column, name in enumerate(found.coordinates):
        values = "".join(f"{errors[:, column].mean():10.2f}" for errors in (before, after, open_))
        lines.append(f"{name:20s}{values}{found.told_apart[:, column].sum():12d}")
    lines += ["", "Cylinders, true / found: shift (mm), turns (degrees), factor of the radius"]
    width = max(len(name) for name in found.wraps)
    for name, true, own in zip(found.wraps, found.true_wraps, found.found_wraps, strict=True):
        factors = np.array([*[1e3] * 3, *[np.degrees(1.0)] * 2, 1.0])
        pairs = zip(factors * true, factors * own, (1, 1, 1, 0, 0, 2), strict=True)
        cells = [f"{one:.{digits}f} / {other:.{digits}f}" for one, other, digits in pairs]
        lines.append(f"{name:{width}s}" + "".join(f"{cell:>15s}" for cell in cells))
    return "\n".join(lines)
