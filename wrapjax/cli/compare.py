"""Command ``wrapjax compare``, with the table of a comparison of methods."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrapjax.cli.common import (
    CURVES_HELP,
    DONE,
    INTERRUPTED,
    NOT_CONVERGED,
    AddCommand,
    checkpoint_folder,
    positive_integer,
    print_result,
)
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.comparison.comparison import Comparison
    from wrapjax.comparison.statistics import Spread


def comparison_table(comparison: Comparison) -> str:
    """Tabulate mean and standard deviation of moment errors by use, speed, method and coordinate."""
    from wrapjax.report.comparison.summary import note

    errors = [row for row in comparison.rows if row.quantity == "moment_error"]
    items = list(dict.fromkeys(row.item for row in errors))
    groups = list(dict.fromkeys((row.use, row.speed) for row in errors))
    cells = {(row.use, row.speed, row.item): row for row in errors}
    width = max(len(f"{use}, {speed}") for use, speed in groups) + 2
    method_width = max(len(method) for method in comparison.methods) + 2
    lines = [
        "Mean absolute error of the joint moments, N m: mean ± standard deviation",
        " " * (width + method_width) + "".join(f"{item:>16s}" for item in items),
    ]
    for use, speed in groups:
        for number, method in enumerate(comparison.methods):
            group_rows = [cells.get((use, speed, item)) for item in items]
            name = "" if number else f"{use}, {speed}"
            texts = ["" if row is None else mean_and_deviation(row.spreads[method]) for row in group_rows]
            lines.append(
                f"{name:{width}s}{method:{method_width}s}" + "".join(f"{text:>16s}" for text in texts)
            )
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


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    compare = command(
        "compare", run, "Calibrate subjects by several methods, and test whether the methods differ.", writing
    )
    compare.add_argument("subjects", type=Path, nargs="+", metavar="SUBJECT", help="subject folders")
    compare.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    compare.add_argument(
        "--methods",
        type=lambda text: tuple(text.split(",")),
        metavar="NAME,NAME",
        help="methods, separated by commas; the others are tested against the first (default: "
        "NGA,SGA,LSGA,PGA)",
    )
    compare.add_argument("--curves", choices=["paper", "opensim"], default="paper", help=CURVES_HELP)
    compare.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="source of the muscle paths of NGA and PGA: surrogate, polynomials (default); engine, exact "
        "paths. SGA and LSGA always use polynomials",
    )
    compare.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="number of starting points of each calibration (default: 4)",
    )
    compare.add_argument(
        "--max-iterations",
        type=positive_integer,
        metavar="N",
        help="largest number of iterations from each starting point (default: 500)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.calibration.problem import METHODS
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.comparison.comparison import compare
    from wrapjax.progress import print_progress
    from wrapjax.subject.subject import load_subject

    check_output_folder(options.out, options.force)
    checkpoints = checkpoint_folder(options)
    inner = ProjectedLevenbergMarquardt()
    if options.max_iterations:
        inner = replace(inner, max_iterations=options.max_iterations)
    try:
        done = compare(
            _load_all(options.subjects, load_subject),
            options.methods or METHODS,
            geometry=options.geometry,
            solver=AugmentedLagrangian(inner),
            starts=options.starts,
            seed=options.seed,
            callback=iteration_printer(quiet=options.quiet),
            curves=options.curves,
            processes=options.threads,
            quiet=options.quiet,
            checkpoints=checkpoints,
            resume=options.resume,
        )
    except KeyboardInterrupt:
        if not checkpoints.exists():
            raise
        print_progress(INTERRUPTED)
        return NOT_CONVERGED
    done.save(options.out, force=options.force)
    print_result(options, "comparison.json", lambda: comparison_table(done))
    return DONE if done.converged else NOT_CONVERGED


def _load_all(folders: Sequence[Path], load: Callable[[Path], Any]) -> list[Any]:
    """Read all subjects, and report the problems of all of them together."""
    subjects: list[Any] = []
    problems: list[Problem] = []
    for folder in folders:
        try:
            subjects.append(load(folder))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return subjects
