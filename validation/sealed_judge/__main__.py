"""Command line: ``make`` a bank of cases, ``check`` it against its manifest."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    parser = argparse.ArgumentParser(prog="sealed_judge", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make", help="make a bank; finished cases are kept")
    make.add_argument("--out", type=Path, required=True)
    make.add_argument("--cases", type=int, default=60)
    make.add_argument("--seed", type=int, required=True)
    make.add_argument("--workers", type=int, default=1)
    tasks = commands.add_parser("tasks", help="copy a bank, and let its people also do other tasks")
    tasks.add_argument(
        "--kind",
        choices=("dynamometer", "squats", "running"),
        default="dynamometer",
        help="passive rotations and isometric ramps by a dynamometer, squats, or running",
    )
    tasks.add_argument("--bank", type=Path, required=True)
    tasks.add_argument("--out", type=Path, required=True)
    tasks.add_argument("--workers", type=int, default=1)
    conditions = commands.add_parser(
        "conditions", help="let the people of a bank walk with and without the cause of their case"
    )
    conditions.add_argument("--bank", type=Path, required=True)
    conditions.add_argument("--out", type=Path, required=True)
    conditions.add_argument("--workers", type=int, default=1)
    check = commands.add_parser("check", help="verify every case against the manifest")
    check.add_argument("--out", type=Path, required=True)
    a = parser.parse_args(arguments)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from . import bank

    if a.command == "make":
        bank.make(a.out, a.cases, a.seed, a.workers)
        return 0
    if a.command == "tasks":
        bank.with_other_tasks(a.bank, a.out, a.workers, a.kind)
        return 0
    if a.command == "conditions":
        bank.with_conditions(a.bank, a.out, a.workers)
        return 0
    wrong = bank.check(a.out)
    print("\n".join(wrong) if wrong else "all cases agree with the manifest")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
