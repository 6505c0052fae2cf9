"""``wrapjax compare``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, positive, show, unfinished
from wrapjax.errors import InputError, Problem
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    compare = command("compare", run, "Calibrate by every method, and test which differ.", writing)
    compare.add_argument("subjects", type=Path, nargs="+", metavar="SUBJECT")
    compare.add_argument("--out", type=Path, required=True, metavar="DIR")
    compare.add_argument(
        "--methods",
        type=lambda text: tuple(text.split(",")),
        metavar="NAME,NAME",
        help="the first is what others are tested against (default: all, against NGA)",
    )
    compare.add_argument("--curves", choices=["paper", "opensim"], default="paper", help="Hill curves")
    compare.add_argument(
        "--geometry",
        choices=["surrogate", "engine"],
        default="surrogate",
        help="what NGA and PGA take paths from (SGA and LSGA: always the polynomials)",
    )
    compare.add_argument(
        "--starts", type=positive, default=4, metavar="N", help="of each calibration, as in 'calibrate'"
    )
    compare.add_argument(
        "--max-iterations", type=positive, metavar="N", help="of each start (default: the solver's)"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import compare, load_subject
    from wrapjax.api.calibrating.problem import METHODS
    from wrapjax.api.tables.calibration import iteration_printer
    from wrapjax.api.tables.comparison import comparison_table
    from wrapjax.calibrate import AugmentedLagrangian, ProjectedLM
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    journal = unfinished(options)
    inner = ProjectedLM()
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
            journal=journal,
            resume=options.resume,
        )
    except KeyboardInterrupt:
        if not journal.exists():
            raise
        say("interrupted; go on where it stopped with --resume", quiet=False)
        return NOT_CONVERGED
    done.save(options.out, force=options.force)
    show(options, "comparison.json", lambda: comparison_table(done))
    return DONE if done.converged else NOT_CONVERGED


def _load_all(folders: Sequence[Path], load: Callable[[Path], Any]) -> list[Any]:
    """Read every subject, and say of all of them at once what is wrong."""
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
