"""Simulation of a bank: libraries of the persons, plan, cases and manifest; continues an interrupted run."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

from validation.blind.case import make_case
from validation.blind.case_selection import ALL_CASES, CaseSelection
from validation.blind.effects import EFFECTS
from validation.blind.library import Library, build_library, library_file
from validation.blind.noise import EMG_LEVELS
from validation.blind.oracle import oracles
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import Person, draw_person
from validation.blind.plan import Bank, PlannedCase, family_of, paretic, plan_cases, with_targets
from validation.blind.seal import seal

#: Variants of each effect; they do not depend on the person.
VARIANTS = {name: effect.variants(None) for name, effect in {**EFFECTS, **OUTSIDE}.items()}  # type: ignore[arg-type]


def person_of(bank: Bank, index: int) -> Person:
    """Draw a person of a bank by number."""
    return draw_person(
        f"{bank.name}_{index:02d}", (bank.seed, 0, index), family_of(bank, index), paretic(index)
    )


def make(
    bank: Bank, folder: Path, workers: int = 1, selection: CaseSelection = ALL_CASES
) -> list[PlannedCase]:
    """Make the selected cases of a bank and write their manifest."""
    (folder / "library").mkdir(parents=True, exist_ok=True)
    people = range(bank.people)
    missing = [index for index in people if not library_file(folder, index).exists()]
    _run_jobs(workers, _make_library, [(bank, folder, index) for index in missing], "people")
    libraries = {index: Library.load(library_file(folder, index)) for index in people}
    planned = with_targets(bank, plan_cases(bank, VARIANTS), libraries)
    selected = set(selection.select(case.id for case in planned))
    planned = [case for case in planned if case.id in selected]
    todo = [[case for case in planned if case.person == i and not _is_made(folder, case)] for i in people]
    jobs = [(bank, folder, index, some) for index, some in zip(people, todo, strict=True) if some]
    _run_jobs(workers, _make_cases, jobs, "people's cases")
    seal(folder)
    return planned


def _is_made(folder: Path, case: PlannedCase) -> bool:
    return (folder / "cases" / case.id).exists()


def _make_library(bank: Bank, folder: Path, index: int) -> str:
    start = perf_counter()
    who = person_of(bank, index)
    library = build_library(who.world, oracles(who.world, EMG_LEVELS))
    partial = folder / "library" / f"partial_{index:02d}.npz"
    library.save(partial)
    partial.replace(library_file(folder, index))
    return f"{who.name}: {len(library.entries)} signatures in {perf_counter() - start:.0f} s"


def _make_cases(bank: Bank, folder: Path, index: int, planned: list[PlannedCase]) -> str:
    start = perf_counter()
    who = person_of(bank, index)
    library = Library.load(library_file(folder, index))
    known = oracles(who.world, tuple(sorted({case.level for case in planned})))
    for case in planned:
        make_case(bank, case, who, library, known, folder)
    seconds = perf_counter() - start
    return f"{who.name}: {len(planned)} cases in {seconds:.0f} s ({seconds / len(planned):.1f} s each)"


def _run_jobs(workers: int, work: Callable[..., str], jobs: Iterable[tuple], what: str) -> None:
    jobs = list(jobs)
    if workers <= 1:
        for done, job in enumerate(jobs, 1):
            print(f"{what} {done}/{len(jobs)}: {work(*job)}", file=sys.stderr, flush=True)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for done, line in enumerate(pool.map(work, *zip(*jobs, strict=True)), 1) if jobs else ():
            print(f"{what} {done}/{len(jobs)}: {line}", file=sys.stderr, flush=True)
