"""Regression test of speed and quality: ``python -m benchmarks.gate`` (or ``make bench-gate``).

A short set of metrics is measured: kernels, one solve and its effort, repeated compilations, and how times
grow with muscles and trials. Each metric is checked against ``gate_limits.toml`` and, with ``--against
FILE.json`` (written by ``--out`` before the change), against its earlier value within its tolerance. The exit
status is 1 if any metric is worse.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.gate_limits import read_limits, violations_of
from benchmarks.machine import pin_threads, processor
from benchmarks.metric import Metric, text_table
from benchmarks.regressions import regressions
from benchmarks.subjects import add_subject_argument, default_subject
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from benchmarks.run_file import EarlierRun

#: Name of this set of metrics in the files of runs.
ASKED = "gate"
#: Kernels whose growth the gate measures: the linearization contains the others.
_GROWING = ("linearization",)


def main(words: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(words)
    # JAX and NumPy read the thread counts once, when they are imported.
    pin_threads()
    set_up_jax()
    from benchmarks.run_file import read_run, write_run
    from wrapjax.errors import InputError, Problem

    with default_subject(options.subject) as folder:
        try:
            earlier = read_run(options.against) if options.against else None
            if earlier and earlier.subject != folder.name:
                message = f"run of subject '{earlier.subject}', expected a run of '{folder.name}'"
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
        print(f"all {len(metrics)} metrics are within their limits")
    return 1 if worse else 0


def judge(metrics: Sequence[Metric], subject: str, earlier: EarlierRun | None) -> list[str]:
    """Describe the metrics that violate their limits or are worse than earlier, one sentence each."""
    worse = violations_of(metrics, read_limits(subject))
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
    measured = [*growth.by_muscles(case.problem, _GROWING), *growth.by_trials(case.problem, _GROWING)]
    return [
        *calibration.kernels(case, quick=True),
        *solving.our_solve(case, quick=True)[1],
        *recompilation.recompilations(case.problem),
        *(metric for kernel in measured for metric in kernel.metrics()),
    ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gate", description=__doc__)
    add_subject_argument(parser)
    parser.add_argument(
        "--against", type=Path, metavar="FILE.json", help="file of an earlier run to compare with"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write the metrics to")
    return parser


if __name__ == "__main__":
    sys.exit(main())
