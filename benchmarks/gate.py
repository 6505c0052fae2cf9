"""Whether a change made anything worse: ``python -m benchmarks.gate`` (or ``make bench-gate``).

A short set is measured: kernels, our solve and what it needed, programs compiled again, how times grow with
muscles and trials. Each number is held to what ``floors.toml`` says; with ``--against FILE.json``, which
``--out`` wrote before the change, also to what it was then, within its own tolerance. Exit status 1 if
anything is worse.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.comparison import regressions
from benchmarks.floors import read_floors, shortfalls
from benchmarks.machine import pin_threads, processor
from benchmarks.metric import Metric, text_table
from benchmarks.subjects import default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from benchmarks.run_file import EarlierRun

#: What runs of this set have in common.
ASKED = "gate"
#: What the gate looks at of the kernels that may grow: this one holds all that the others do.
_GROWING = ("linearization",)


def main(words: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(words)
    # Before JAX and NumPy are loaded, which read it once.
    pin_threads()
    set_up_jax()
    from benchmarks.run_file import read_run, write_run
    from wrapjax.errors import InputError, Problem

    with default_subject(options.subject) as folder:
        try:
            earlier = read_run(options.against) if options.against else None
            if earlier and earlier.subject != folder.name:
                message = f"is of subject '{earlier.subject}', where '{folder.name}' was expected"
                raise InputError(Problem(str(options.against), message))
        except InputError as error:
            print(error, file=sys.stderr)
            return 2
        metrics = _measure(folder)
    print(text_table(metrics))
    if options.out:
        write_run(options.out, ASKED, folder.name, metrics)
    worse = judge(metrics, folder.name, earlier)
    for sentence in worse:
        print(f"WORSE  {sentence}")
    if not worse:
        print(f"none of {len(metrics)} numbers is worse than it must be")
    return 1 if worse else 0


def judge(metrics: Sequence[Metric], subject: str, earlier: EarlierRun | None) -> list[str]:
    """Say what falls short of the floors, or got worse since an earlier run: a sentence each."""
    worse = shortfalls(metrics, read_floors(subject))
    if earlier is not None:
        worse += regressions(
            earlier.metrics,
            metrics,
            same_machine=earlier.processor == processor(),
            same_set=earlier.asked == ASKED,
        )
    return worse


def _measure(folder: Path) -> list[Metric]:
    import wrapjax
    from benchmarks import calibration, growth, recompilation, solving
    from benchmarks.case import nga_case

    case = nga_case(wrapjax.load_subject(folder))
    grown = [*growth.by_muscles(case.problem, _GROWING), *growth.by_trials(case.problem, _GROWING)]
    return [
        *calibration.kernels(case, quick=True),
        *solving.our_solve(case, quick=True)[1],
        *recompilation.recompilations(case.problem),
        *(metric for one in grown for metric in one.metrics()),
    ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gate", description=__doc__)
    parser.add_argument(
        "--subject",
        type=Path,
        metavar="DIR",
        help="subject folder (default: $WRAPJAX_DATA/s1_left, else a virtual subject)",
    )
    parser.add_argument("--against", type=Path, metavar="FILE.json", help="an earlier run to compare with")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="where to write the result")
    return parser


if __name__ == "__main__":
    sys.exit(main())
