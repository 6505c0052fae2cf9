"""Diagnose every case of a blind bank, each for itself, and keep the answers for its scorer.

``python -m validation.diagnosis.diagnose_bank --bank BANK --out ANSWERS`` looks at a case's folder and at nothing else.
Cases that are answered already are not asked again, unless the case or the package is another than then: so
it goes on where it was stopped. ``--withheld FOLDER`` asks again of every case with a single cause, with that
effect left out of the catalogue: the cause is read from the bank's truth once the case's own answer is
written. ``--baselines FOLDER`` also answers as textbooks would (see `validation.diagnosis.baselines`), ``--ablations
FOLDER`` as the score test alone would, whole and with one term left out (see `validation.diagnosis.ablations`), a
folder each.

Cases run as subjects of a cohort do: one here (``--workers 1``), in processes of one thread each, or with
``--scheduler`` wherever a dask scheduler or SLURM puts them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from benchmarks.machine import pin_threads
from validation.blind.case_selection import add_lot, lot_of
from validation.diagnosis.bank_cases import cases_of
from validation.diagnosis.case_answers import Job, answer
from wrapjax.cohorts.scheduling import Finished, run_jobs
from wrapjax.errors import InputError


def main() -> int:
    options = _parser().parse_args()
    # Before JAX is loaded, which reads it once.
    pin_threads()
    try:
        cases = cases_of(options.bank, lot_of(options))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    # Other processes may work elsewhere.
    out, *others = (
        place and place.resolve()
        for place in (options.out, options.baselines, options.ablations, options.withheld)
    )
    jobs = {case.name: Job(case, out / case.name, options.starts, *others) for case in cases}
    out.mkdir(parents=True, exist_ok=True)
    alone = options.workers == 1 and options.scheduler is None
    found = _run_here(jobs) if alone else _run_elsewhere(jobs, options)
    failed = 0
    try:
        for number, one in enumerate(found, 1):
            said = f"FAILED: {one.failure}" if one.failure else one.value
            failed += bool(one.failure)
            print(f"{number}/{len(jobs)} {one.name}: {said}", file=sys.stderr, flush=True)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 1 if failed else 0


def _run_here(jobs: Mapping[str, Job]) -> Iterator[Finished]:
    """One after the other, so that what is compiled serves all."""
    for name, job in jobs.items():
        try:
            yield Finished(name, answer(job))
        except Exception as error:  # One case must not cost all others.
            yield Finished(name, None, f"{type(error).__name__}: {error}")


def _run_elsewhere(jobs: Mapping[str, Job], options: argparse.Namespace) -> Iterator[Finished]:
    return run_jobs(answer, jobs, scheduler=options.scheduler, workers=options.workers)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.diagnose_bank", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a dask scheduler, or 'slurm'")
    parser.add_argument("--starts", type=int, default=4)
    add_lot(parser)
    parser.add_argument("--baselines", type=Path, help="where to answer as textbooks would")
    parser.add_argument("--ablations", type=Path, help="where to answer by the score test less one term")
    parser.add_argument("--withheld", type=Path, help="where to answer with each single cause left out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
