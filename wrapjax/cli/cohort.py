"""Command ``wrapjax cohort``, with the table of a cohort."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import (
    BAD_INPUT,
    DONE,
    INTERRUPTED,
    METHODS_HELP,
    NOT_CONVERGED,
    AddCommand,
    positive_integer,
    print_json,
    read_json,
)


def cohort_table(content: dict[str, Any]) -> str:
    """Tabulate moment errors and outcomes of all subjects, one line each."""
    width = max(map(len, (*content["subjects"], "subject")))
    lines = [
        "Mean absolute error of the joint moments, N m",
        f"{'subject':{width}s}{'calibration':>14s}{'validation':>14s}  result",
    ]
    for name, subject in content["subjects"].items():
        if subject["state"] != "done":
            lines.append(f"{name:{width}s}{'-':>14s}{'-':>14s}  failed: {subject['message']}")
            continue
        errors = (subject["mae_Nm"][use] for use in ("calibration", "validation"))
        cells = "".join(f"{'-' if error is None else format(error['mean'], '.2f'):>14s}" for error in errors)
        diagnosis = subject["diagnosis"]
        outcome = "converged" if subject["converged"] else "did not converge"
        lines.append(
            f"{name:{width}s}{cells}  {outcome}{'' if diagnosis is None else ', ' + diagnosis['outcome']}"
        )
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    cohort = command(
        "cohort", run, "Calibrate many subjects in parallel, and diagnose them on request.", writing
    )
    cohort.add_argument("subjects", type=Path, nargs="+", metavar="SUBJECT", help="subject folders")
    cohort.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    cohort.add_argument(
        "--method",
        choices=["NGA", "SGA", "LSGA", "PGA"],
        default="NGA",
        help=f"what is calibrated: {METHODS_HELP} (default: NGA)",
    )
    cohort.add_argument("--diagnose", action="store_true", help="also diagnose every subject")
    cohort.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a dask scheduler (tcp://host:8786), or 'slurm' for jobs of a SLURM cluster "
        "(default: processes on this machine)",
    )
    cohort.add_argument(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="number of processes, of one thread each (default: the number of cores)",
    )
    cohort.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="number of starting points of each calibration (default: 4)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from wrapjax.cohorts.cohort import cohort
    from wrapjax.progress import print_progress

    try:
        done = cohort(
            options.subjects,
            options.out,
            options.method,
            diagnose=options.diagnose,
            scheduler=options.scheduler,
            workers=options.workers or options.threads,
            starts=options.starts,
            seed=options.seed,
            resume=options.resume,
            force=options.force,
            quiet=options.quiet,
        )
    except KeyboardInterrupt:
        print_progress(INTERRUPTED)
        return NOT_CONVERGED
    except OSError as error:
        if not (options.out / "cohort.json").exists():
            raise
        # Results of finished subjects are kept.
        place = error.filename or options.out
        print_progress(f"error: {place}: {error.strerror or error}; continue with --resume", quiet=False)
        return BAD_INPUT
    if options.json:
        print_json(read_json(options.out / "cohort.json"))
    else:
        print(cohort_table(done.content))
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if done.complete else NOT_CONVERGED
