"""``wrapjax calibrate``.

A calibration for a terminal: a line an iteration, and errors before and after.

Uncertainty as plain text for a terminal.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.cli.common import (
    DONE,
    NOT_CONVERGED,
    AddCommand,
    add_undriven_options,
    checkpoint_folder,
    positive_integer,
    print_result,
)
from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.metrics import moment_errors, pooled_mae
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.calibration.calibration import Calibration
    from wrapjax.calibration.result import CalibrationResult
    from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
    from wrapjax.calibration.solvers.interface import Iteration
    from wrapjax.calibration.solvers.multistart import IterationCallback
    from wrapjax.calibration.uncertainty.intervals import LegSpread
    from wrapjax.calibration.uncertainty.uncertainty import Uncertainty
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.path_sources.polynomial_fit import Fit


def iteration_printer(*, quiet: bool = False) -> IterationCallback | None:
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
    from wrapjax.calibration.result import describe_limits
    from wrapjax.report.run_summary import geometry_change
    from wrapjax.report.starts import equally_good

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


def uncertainty_table(judged: Uncertainty) -> str:
    """Show each leg's calibration, and how well its recordings determine what was found."""
    legs = zip(judged.calibration.legs, judged.spreads, strict=True)
    return "\n\n".join(f"{calibration_table(leg)}\n\n{spread_table(spread)}" for leg, spread in legs)


def spread_table(spread: LegSpread) -> str:
    """Show medians by kind of parameter, and how many of each the moments determine."""
    own = spread.parameters
    kinds: dict[str, list[int]] = {}
    for row, label in enumerate(own.labels):
        name = label.rsplit(".", 1)[1]
        kinds.setdefault("path modes" if name.startswith("path_changes_") else name, []).append(row)
    failed = len(spread.draws) - spread.converged
    lines = [
        f"Uncertainty by {len(spread.draws)} draws ({spread.way}"
        + (f"; {failed} did not converge" if failed else "")
        + f"); residuals tell as much as {spread.independent_samples:.0f} independent samples",
        "Determined: moments narrow it by more than a fifth. Medians of standard deviations with the",
        "moments, and without them (priors, penalties and bounds alone)",
        f"{'parameter':26s}{'determined':>14s}{'with':>10s}{'without':>10s}  unit",
    ]
    for name, rows in kinds.items():
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(own.units[rows[0]], (1.0, own.units[rows[0]]))
        told = f"{int(own.identified[rows].sum())} of {len(rows)}"
        medians = (np.median(part[rows]) for part in (own.deviation, own.prior_deviation))
        lines.append(
            f"{name:26s}{told:>14s}" + "".join(f"{factor * one:10.3g}" for one in medians) + f"  {unit}"
        )
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    calibrate = command("calibrate", run, "Calibrate the model to the subject.", writing)
    calibrate.add_argument("subject", type=Path, metavar="SUBJECT")
    calibrate.add_argument(
        "--method", choices=["NGA", "SGA", "LSGA", "PGA"], required=True, help="what is adjusted"
    )
    calibrate.add_argument("--out", type=Path, required=True, metavar="RUN")
    calibrate.add_argument(
        "--fit", type=Path, metavar="FIT", help="from 'wrapjax fit' (default: made and cached)"
    )
    calibrate.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="source of the paths: polynomials, or the exact engine, which needs no fit (NGA and PGA)",
    )
    calibrate.add_argument(
        "--surfaces",
        choices=["touched", "all"],
        default="touched",
        help="cylinders that PGA moves: those that muscles lie on in a recorded frame, or all",
    )
    calibrate.add_argument("--curves", choices=["paper", "opensim"], default="paper", help="Hill curves")
    calibrate.add_argument(
        "--tendon",
        choices=["rigid", "compliant"],
        default="rigid",
        help="compliant: stretches with force, and takes several times as long",
    )
    calibrate.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="the model's own values and N-1 random ones",
    )
    calibrate.add_argument(
        "--max-iterations", type=positive_integer, metavar="N", help="of each start (default: the solver's)"
    )
    calibrate.add_argument(
        "--solver", choices=["lm", "lbfgs"], default="lm", help="lbfgs: jaxopt's, a slow second opinion"
    )
    calibrate.add_argument(
        "--uncertainty",
        choices=["laplace", "bootstrap"],
        help="say how well the recordings determine parameters: quickly, or by a calibration a draw",
    )
    calibrate.add_argument(
        "--draws", type=positive_integer, metavar="N", help="of the bootstrap (default: 50)"
    )
    add_undriven_options(calibrate)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.calibration.calibration import calibrate
    from wrapjax.calibration.problem import fit_for_methods
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.solvers.interface import Status
    from wrapjax.calibration.solvers.lbfgs import BoundedLBFGS
    from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
    from wrapjax.calibration.uncertainty.uncertainty import DRAWS, uncertainty
    from wrapjax.path_sources.exact import exact_geometry
    from wrapjax.path_sources.polynomial_fit import load_fit
    from wrapjax.path_sources.undriven_muscles import apply_undriven_strategy
    from wrapjax.progress import print_progress, progress_bar
    from wrapjax.subject.subject import load_subject as load_subject
    from wrapjax.subject.subject import read_legs

    check_output_folder(options.out, options.force)
    if options.fit and options.geometry == "engine":
        raise InputError(Problem("--fit", "is for --geometry surrogate: the exact engine needs no fit"))
    if options.draws and options.uncertainty != "bootstrap":
        raise InputError(Problem("--draws", "is for --uncertainty bootstrap: nothing else is drawn anew"))
    if options.draws == 1:
        raise InputError(Problem("--draws", "expected at least 2, found 1: one draw has no spread"))
    if options.surfaces != "touched" and options.method != "PGA":
        raise InputError(Problem("--surfaces", "is for --method PGA: the others move no cylinders"))
    checkpoints = checkpoint_folder(options)
    inner = {"lm": ProjectedLevenbergMarquardt, "lbfgs": BoundedLBFGS}[options.solver]()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    subject = load_subject(options.subject)
    read_legs(subject)  # whatever is wrong with the other leg is said before the long work
    subject = apply_undriven_strategy(subject, options.undriven, options.synergies)
    paths: Fit | ExactGeometry
    if options.geometry == "engine":
        paths = exact_geometry(subject)
    elif options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = fit_for_methods(
            (options.method,), subject, seed=options.seed, processes=options.threads, quiet=options.quiet
        )
    print_progress("compiling (once; later runs take it from the cache)", quiet=options.quiet)
    done = calibrate(
        subject,
        options.method,
        paths,
        solver=AugmentedLagrangian(inner),
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        curves=options.curves,
        tendon=options.tendon,
        surfaces=options.surfaces,
        undriven=options.undriven,
        synergies=options.synergies,
        checkpoints=checkpoints,
        resume=options.resume,
    )
    if done.status is Status.interrupted:
        print_progress("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    if options.uncertainty is None:
        done.save(options.out, force=options.force)
        print_result(options, "summary.json", lambda: "\n\n".join(map(calibration_table, done.legs)))
        return DONE if done.status.converged else NOT_CONVERGED
    count = options.draws or DRAWS[options.uncertainty]
    quiet = options.quiet or options.uncertainty == "laplace"
    print_progress("judging how well the recordings determine parameters", quiet=options.quiet)
    try:
        with progress_bar("calibrating made-up moments", count, quiet=quiet) as advance:
            judged = uncertainty(done, options.uncertainty, draws=count, seed=options.seed, advance=advance)
    except KeyboardInterrupt:
        print_progress("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    judged.save(options.out, force=options.force)
    print_result(options, "summary.json", lambda: uncertainty_table(judged))
    return DONE if done.status.converged else NOT_CONVERGED
