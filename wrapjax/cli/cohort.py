"""``wrapjax cohort``.

A cohort for a terminal.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import (
    BAD_INPUT,
    DONE,
    NOT_CONVERGED,
    AddCommand,
    positive_integer,
    print_json,
    read_json,
)


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


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    cohort = command("cohort", run, "Calibrate, and diagnose, many subjects side by side.", writing)
    cohort.add_argument("subjects", type=Path, nargs="+", metavar="SUBJECT")
    cohort.add_argument("--out", type=Path, required=True, metavar="DIR")
    cohort.add_argument("--method", choices=["NGA", "SGA", "LSGA", "PGA"], default="NGA", help="default: NGA")
    cohort.add_argument("--diagnose", action="store_true", help="diagnose every subject, too")
    cohort.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a dask scheduler (tcp://host:8786), or 'slurm' (default: processes on this machine)",
    )
    cohort.add_argument(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="processes of one thread each (default: one a core)",
    )
    cohort.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="of each calibration, as in 'calibrate'",
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
        print_progress("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    except OSError as error:
        if not (options.out / "cohort.json").exists():
            raise
        # Subjects that are done stay: nothing of them has to be done again.
        place = error.filename or options.out
        print_progress(
            f"error: {place}: {error.strerror or error}; go on where it stopped with --resume", quiet=False
        )
        return BAD_INPUT
    if options.json:
        print_json(read_json(options.out / "cohort.json"))
    else:
        print(cohort_table(done.content))
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if done.complete else NOT_CONVERGED
