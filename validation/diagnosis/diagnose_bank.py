"""Diagnosis of every case of a blind bank: ``python -m validation.diagnosis.diagnose_bank``.

``--bank BANK --out ANSWERS`` reads only the folder of each case and writes its answer for the scorer. Cases
that are answered already are skipped unless the case or the package has changed, so an interrupted run can be
continued. ``--withheld FOLDER`` also diagnoses every case with a single cause with that effect withheld from
the catalogue; the cause is read from the bank's truth once the answer itself is written. ``--baselines
FOLDER`` also answers by standard statistics (see `validation.diagnosis.baselines`), ``--ablations FOLDER`` by
the score test, complete and with one term left out (see `validation.diagnosis.ablations`), in one folder
each.

Cases run as the subjects of a cohort do: one at a time here (``--workers 1``), in processes of one thread
each, or with ``--scheduler`` on a dask scheduler or SLURM.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from benchmarks.machine import pin_threads
from validation.blind.case_selection import add_selection_arguments, selection_of
from validation.diagnosis.bank_cases import cases_of
from validation.diagnosis.case_answers import Job, answer
from wrapjax.cohorts.scheduling import Finished, run_jobs
from wrapjax.errors import InputError


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    try:
        cases = cases_of(options.bank, selection_of(options))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    # Other processes may have another working folder.
    out, *others = (
        place and place.resolve()
        for place in (options.out, options.baselines, options.ablations, options.withheld)
    )
    jobs = {case.name: Job(case, out / case.name, options.starts, *others) for case in cases}
    out.mkdir(parents=True, exist_ok=True)
    in_process = options.workers == 1 and options.scheduler is None
    found = _run_here(jobs) if in_process else _run_in_workers(jobs, options)
    failed = 0
    try:
        for number, one in enumerate(found, 1):
            text = f"FAILED: {one.failure}" if one.failure else one.value
            failed += bool(one.failure)
            print(f"{number}/{len(jobs)} {one.name}: {text}", file=sys.stderr, flush=True)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 1 if failed else 0


def _run_here(jobs: Mapping[str, Job]) -> Iterator[Finished]:
    """Run cases one after another in this process, so that compiled programs are reused."""
    for name, job in jobs.items():
        try:
            yield Finished(name, answer(job))
        except Exception as error:  # One failed case must not stop the others.
            yield Finished(name, None, f"{type(error).__name__}: {error}")


def _run_in_workers(jobs: Mapping[str, Job], options: argparse.Namespace) -> Iterator[Finished]:
    return run_jobs(answer, jobs, scheduler=options.scheduler, workers=options.workers)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.diagnose_bank", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="address of a dask scheduler, or 'slurm'")
    parser.add_argument("--starts", type=int, default=4)
    add_selection_arguments(parser)
    parser.add_argument("--baselines", type=Path, help="folder for answers by standard statistics")
    parser.add_argument(
        "--ablations", type=Path, help="folder for answers by the score test with one term left out"
    )
    parser.add_argument("--withheld", type=Path, help="folder for answers with each single cause withheld")
    return parser


if __name__ == "__main__":
    sys.exit(main())
