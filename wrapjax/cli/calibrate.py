"""Command ``wrapjax calibrate``, with the tables of a calibration and of its uncertainty."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.cli.common import (
    CURVES_HELP,
    DONE,
    INTERRUPTED,
    METHODS_HELP,
    NOT_CONVERGED,
    AddCommand,
    add_undriven_options,
    checkpoint_folder,
    positive_integer,
    positive_number,
    print_result,
)
from wrapjax.errors import InputError, Problem
from wrapjax.evaluation.metrics import moment_errors, pooled_mae
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax
from wrapjax.progress import print_progress, progress_bar

if TYPE_CHECKING:
    from wrapjax.calibration.calibration import Calibration
    from wrapjax.calibration.calibration_result import CalibrationResult
    from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
    from wrapjax.calibration.solvers.interface import Iteration
    from wrapjax.calibration.solvers.multistart import IterationCallback
    from wrapjax.calibration.uncertainty.intervals import LegSpread
    from wrapjax.calibration.uncertainty.uncertainty import Uncertainty
    from wrapjax.evaluation.left_out_tasks import LeftOutTasks
    from wrapjax.path_sources.exact import ExactGeometry
    from wrapjax.path_sources.polynomial_fit import Fit


def iteration_printer(*, quiet: bool = False) -> IterationCallback | None:
    """Return a callback that prints one line for each iteration to standard error; None if ``quiet``."""
    return None if quiet else _iteration_lines(print_progress)


def iteration_log(file: Path) -> IterationCallback:
    """Return a callback that appends one line for each iteration to a file in an existing folder."""

    def append(line: str) -> None:
        with file.open("a", encoding="utf-8") as stream:
            stream.write(line + "\n")

    return _iteration_lines(append)


def _iteration_lines(write: Callable[[str], None]) -> IterationCallback:
    def line(start: int, iteration: Iteration, state: LagrangianState) -> None:
        if iteration.number == 0:
            write("start  iteration        cost  optimality   damping      step  at bounds  seconds")
        write(
            f"{start:5d}  {iteration.number:9d}  {iteration.cost:10.5g}  {iteration.optimality:10.2e}  "
            f"{iteration.damping:8.1e}  {iteration.step:8.1e}  {iteration.at_bounds:9d}  "
            f"{iteration.seconds:7.2f}"
        )

    return line


def calibration_table(calibration: Calibration) -> str:
    """Tabulate the outcome of the solver and the mean absolute moment errors before and after, by use."""
    result = calibration.result
    columns: dict[str, dict[str, float]] = {}
    for use in ("calibration", "validation"):
        rows = [row for row, trial_use in enumerate(result.uses) if trial_use == use]
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
        lines.append(
            f"{name:{width}s}"
            + "".join(
                f"{pooled[name]:20.2f}" if name in pooled else f"{'-':>20s}" for pooled in columns.values()
            )
        )
    return "\n".join(lines)


def _solver_lines(result: CalibrationResult) -> list[str]:
    """Describe starts, limits and changes of muscle paths, as far as they apply."""
    from wrapjax.calibration.calibration_result import describe_limits
    from wrapjax.report.calibration.run_summary import geometry_change
    from wrapjax.report.calibration.starts import equally_good

    solution, count = result.solution, len(result.outcomes)
    costs = [outcome.solution.cost for outcome in result.outcomes]
    starts = f"{count} start{'s' if count > 1 else ''} in {result.solve_seconds:.2f} s (compiling "
    starts += f"{result.compile_seconds:.1f} s)"
    if count > 1:
        starts += f", costs {min(costs):.5g} to {max(costs):.5g}; {equally_good(result).sum()} of {count} "
        starts += f"within 1 % of the chosen one, start {result.chosen}"
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
            f"{result.solver.ctol:.0e}); {pushing} values of {len(muscles)} muscles are at their limit"
        )
    moving = result.freedom.moving_paths
    if moving is not None:
        change = geometry_change(result)
        lines.append(
            f"paths of {moving.sum()} muscles free: on average over all "
            f"{len(result.muscles)} muscles, lengths changed by {1e3 * change['length_mae_m']:.2f} mm, "
            f"moment "
            f"arms by {1e3 * change['moment_arm_mae_m']:.2f} mm"
        )
    return lines


def uncertainty_table(result: Uncertainty) -> str:
    """Tabulate the calibration of each leg, and how well its recordings determine the parameters."""
    legs = zip(result.calibration.legs, result.spreads, strict=True)
    return "\n\n".join(f"{calibration_table(leg)}\n\n{spread_table(spread)}" for leg, spread in legs)


def left_out_table(result: LeftOutTasks) -> str:
    """Tabulate the errors of every task, of models calibrated without it and with all."""
    width = max(len(row.without.coordinate) for row in result.rows)
    lines = [
        "Errors by task, N m: of the model calibrated without the task, and on all tasks",
        f"{'task':12s}{'coordinate':{width}s}{'MAE':>10s}{'RMSE':>8s}{'R2':>7s}{'MAE':>10s}{'RMSE':>8s}{'R2':>7s}",
    ]
    for row in result.rows:
        lines.append(
            f"{row.without.task:12s}{row.without.coordinate:{width}s}"
            + "".join(f"{own.mae:10.2f}{own.rmse:8.2f}{own.r2:7.2f}" for own in (row.without, row.with_all))
            + ("" if row.converged else "  not converged without it")
        )
    return "\n".join(lines)


def spread_table(spread: LegSpread) -> str:
    """Tabulate median standard deviations and the number of determined parameters, by kind of parameter."""
    parameters = spread.parameters
    kinds: dict[str, list[int]] = {}
    for row, label in enumerate(parameters.labels):
        name = label.rsplit(".", 1)[1]
        kinds.setdefault("path modes" if name.startswith("path_changes_") else name, []).append(row)
    failed = len(spread.draws) - spread.converged
    lines = [
        f"Uncertainty by {len(spread.draws)} draws ({spread.way}"
        + (f"; {failed} did not converge" if failed else "")
        + f"); the residuals are worth {spread.independent_samples:.0f} independent samples",
        "Determined: the moments reduce its standard deviation by more than a fifth. Medians of the standard",
        "deviations with the moments and without them (priors, penalties and bounds alone)",
        f"{'parameter':26s}{'determined':>14s}{'with':>10s}{'without':>10s}  unit",
    ]
    for name, rows in kinds.items():
        factor, unit = {"s": (1e3, "ms"), "m": (1e3, "mm")}.get(
            parameters.units[rows[0]], (1.0, parameters.units[rows[0]])
        )
        determined = f"{int(parameters.identified[rows].sum())} of {len(rows)}"
        medians = (
            np.median(deviations[rows]) for deviations in (parameters.deviation, parameters.prior_deviation)
        )
        lines.append(
            f"{name:26s}{determined:>14s}"
            + "".join(f"{factor * median:10.3g}" for median in medians)
            + f"  {unit}"
        )
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    calibrate = command(
        "calibrate", run, "Calibrate a subject's model to the recorded joint moments.", writing
    )
    calibrate.add_argument("subject", type=Path, metavar="SUBJECT", help="subject folder")
    calibrate.add_argument(
        "--method",
        choices=["NGA", "SGA", "LSGA", "PGA"],
        required=True,
        help=f"what is calibrated: {METHODS_HELP}",
    )
    calibrate.add_argument("--out", type=Path, required=True, metavar="RUN", help="output folder")
    calibrate.add_argument(
        "--fit",
        type=Path,
        metavar="FIT",
        help="folder of polynomial muscle paths from 'wrapjax fit' (default: fitted now and cached)",
    )
    calibrate.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="source of the muscle paths: surrogate, polynomials (default); engine, exact paths without a "
        "fit, for NGA and PGA",
    )
    calibrate.add_argument(
        "--surfaces",
        choices=["touched", "all"],
        default="touched",
        help="wrapping surfaces that PGA changes: touched, those that a muscle touches in a recorded frame "
        "(default); all",
    )
    calibrate.add_argument(
        "--bones",
        type=Path,
        metavar="DIR",
        help="folder of the bones' surfaces, .vtp, near which PGA with --geometry engine keeps wrapping "
        "surfaces; polynomials have them from 'wrapjax fit --bones'",
    )
    calibrate.add_argument(
        "--bone-distance",
        type=positive_number,
        metavar="X",
        help="largest increase of a surface's distance from the bones of its body, with --bones, m (default: "
        "0.005)",
    )
    calibrate.add_argument("--curves", choices=["paper", "opensim"], default="paper", help=CURVES_HELP)
    calibrate.add_argument(
        "--tendon",
        choices=["rigid", "compliant"],
        default="rigid",
        help="tendons: rigid, of constant length (default); compliant, elastic, takes several times as long",
    )
    calibrate.add_argument(
        "--muscle-law",
        choices=["nmsm", "de_groote", "thelen", "ceinms"],
        default="nmsm",
        help="published muscle law: nmsm, that of the Hill curves as they are (default); de_groote; thelen; "
        "ceinms, an exponential relation of force to EMG. A diagnosis fits the person's own law",
    )
    calibrate.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="number of starting points: the model's own values and N-1 random ones (default: 4)",
    )
    calibrate.add_argument(
        "--max-iterations",
        type=positive_integer,
        metavar="N",
        help="largest number of iterations from each starting point (default: 500; lbfgs: 20000)",
    )
    calibrate.add_argument(
        "--solver",
        choices=["lm", "lbfgs"],
        default="lm",
        help="lm, Levenberg-Marquardt (default); lbfgs, L-BFGS of jaxopt (an extra of the package), a slower "
        "check of the former",
    )
    calibrate.add_argument(
        "--uncertainty",
        choices=["laplace", "bootstrap"],
        help="also estimate the uncertainty of the parameters: laplace, by a fast approximation; bootstrap, "
        "by repeated calibrations to simulated moments (default: not estimated)",
    )
    calibrate.add_argument(
        "--draws", type=positive_integer, metavar="N", help="number of bootstrap calibrations (default: 50)"
    )
    calibrate.add_argument(
        "--leave-tasks-out",
        action="store_true",
        help="also calibrate without each task in turn and predict it: left_out_tasks.csv",
    )
    add_undriven_options(calibrate)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.calibration.calibration import calibrate
    from wrapjax.calibration.problem import fit_for_methods
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.solvers.external_solvers import JaxoptSolver
    from wrapjax.calibration.solvers.interface import Status
    from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
    from wrapjax.calibration.uncertainty.uncertainty import DRAWS, uncertainty
    from wrapjax.evaluation.left_out_tasks import leave_out_tasks
    from wrapjax.geometry.surrogates.physiological import DEFAULT_THRESHOLDS
    from wrapjax.path_sources.exact import exact_geometry
    from wrapjax.path_sources.polynomial_fit import load_fit
    from wrapjax.path_sources.undriven_muscles import apply_undriven_strategy
    from wrapjax.subject.subject import load_subject, read_legs

    check_output_folder(options.out, options.force)
    if options.fit and options.geometry == "engine":
        raise InputError(Problem("--fit", "is for --geometry surrogate: the exact engine needs no fit"))
    if options.draws and options.uncertainty != "bootstrap":
        raise InputError(Problem("--draws", "is for --uncertainty bootstrap: no other estimate has draws"))
    if options.draws == 1:
        raise InputError(
            Problem("--draws", "expected at least 2, found 1: one draw has no standard deviation")
        )
    if options.surfaces != "touched" and options.method != "PGA":
        raise InputError(
            Problem("--surfaces", "is for --method PGA: the other methods change no wrapping surfaces")
        )
    if options.bones and (options.geometry, options.method) != ("engine", "PGA"):
        raise InputError(
            Problem(
                "--bones",
                "is for --method PGA with --geometry engine",
                hint="polynomials keep surfaces near bones by 'wrapjax fit --bones DIR' and --fit",
            )
        )
    if options.bone_distance and not options.bones:
        raise InputError(Problem("--bone-distance", "is for --bones"))
    if options.leave_tasks_out and options.uncertainty:
        raise InputError(Problem("--leave-tasks-out", "cannot be combined with --uncertainty"))
    checkpoints = checkpoint_folder(options)
    inner = {"lm": ProjectedLevenbergMarquardt, "lbfgs": JaxoptSolver}[options.solver]()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    subject = load_subject(options.subject)
    read_legs(subject)  # Errors of the other leg are reported before the long computation.
    subject = apply_undriven_strategy(subject, options.undriven, options.synergies)
    paths: Fit | ExactGeometry
    if options.geometry == "engine":
        paths = exact_geometry(
            subject,
            bone_folders=(options.bones,) if options.bones else (),
            bone_distance=options.bone_distance or DEFAULT_THRESHOLDS.bone_distance,
        )
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
        muscle_law=options.muscle_law,
        surfaces=options.surfaces,
        undriven=options.undriven,
        synergies=options.synergies,
        checkpoints=checkpoints,
        resume=options.resume,
    )
    if done.status is Status.interrupted:
        print_progress(INTERRUPTED)
        return NOT_CONVERGED
    if options.leave_tasks_out:
        left_out = leave_out_tasks(
            done,
            starts=options.starts,
            seed=options.seed,
            log=lambda line: print_progress(line, quiet=options.quiet),
        )
        left_out.save(options.out, force=options.force)
        tables = f"{calibration_table(done)}\n\n{left_out_table(left_out)}"
        print_result(options, "summary.json", lambda: tables)
        return DONE if done.status.converged else NOT_CONVERGED
    if options.uncertainty is None:
        done.save(options.out, force=options.force, motion=True)
        print_result(options, "summary.json", lambda: "\n\n".join(map(calibration_table, done.legs)))
        return DONE if done.status.converged else NOT_CONVERGED
    count = options.draws or DRAWS[options.uncertainty]
    quiet = options.quiet or options.uncertainty == "laplace"
    print_progress("estimating the uncertainty of the parameters", quiet=options.quiet)
    try:
        with progress_bar("calibrating simulated moments", count, quiet=quiet) as advance:
            result = uncertainty(done, options.uncertainty, draws=count, seed=options.seed, advance=advance)
    except KeyboardInterrupt:
        print_progress(INTERRUPTED)
        return NOT_CONVERGED
    result.save(options.out, force=options.force, motion=True)
    print_result(options, "summary.json", lambda: uncertainty_table(result))
    return DONE if done.status.converged else NOT_CONVERGED
