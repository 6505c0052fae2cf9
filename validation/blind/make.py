"""Make a bank: people and their libraries first, then the plan, then the cases; resumes where it stopped."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

from validation.blind.case import make_case
from validation.blind.case_selection import ALL_CASES, Lot
from validation.blind.effects import EFFECTS
from validation.blind.library import Library, build_library, library_file
from validation.blind.noise import EMG_LEVELS
from validation.blind.oracle import oracles
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import Person, person
from validation.blind.plan import Bank, Planned, draft, family_of, paretic, with_targets
from validation.blind.seal import seal

#: Variants do not depend on the person.
VARIANTS = {name: effect.variants(None) for name, effect in {**EFFECTS, **OUTSIDE}.items()}  # type: ignore[arg-type]


def someone(bank: Bank, index: int) -> Person:
    return person(f"{bank.name}_{index:02d}", (bank.seed, 0, index), family_of(bank, index), paretic(index))


def make(bank: Bank, folder: Path, workers: int = 1, lot: Lot = ALL_CASES) -> list[Planned]:
    """Make all cases of a bank, or some, and seal them."""
    (folder / "library").mkdir(parents=True, exist_ok=True)
    people = range(bank.people)
    missing = [index for index in people if not library_file(folder, index).exists()]
    _spread(workers, _make_library, [(bank, folder, index) for index in missing], "people")
    libraries = {index: Library.load(library_file(folder, index)) for index in people}
    planned = with_targets(bank, draft(bank, VARIANTS), libraries)
    wanted = set(lot.of(case.id for case in planned))
    planned = [case for case in planned if case.id in wanted]
    todo = [[case for case in planned if case.person == i and not _made(folder, case)] for i in people]
    jobs = [(bank, folder, index, some) for index, some in zip(people, todo, strict=True) if some]
    _spread(workers, _make_cases, jobs, "people's cases")
    seal(folder)
    return planned


def _made(folder: Path, case: Planned) -> bool:
    return (folder / "cases" / case.id).exists()


def _make_library(bank: Bank, folder: Path, index: int) -> str:
    start = perf_counter()
    who = someone(bank, index)
    library = build_library(who.world, oracles(who.world, EMG_LEVELS))
    partial = folder / "library" / f"partial_{index:02d}.npz"
    library.save(partial)
    partial.replace(library_file(folder, index))
    return f"{who.name}: {len(library.entries)} signatures in {perf_counter() - start:.0f} s"


def _make_cases(bank: Bank, folder: Path, index: int, planned: list[Planned]) -> str:
    start = perf_counter()
    who = someone(bank, index)
    library = Library.load(library_file(folder, index))
    known = oracles(who.world, tuple(sorted({case.level for case in planned})))
    for case in planned:
        make_case(bank, case, who, library, known, folder)
    seconds = perf_counter() - start
    return f"{who.name}: {len(planned)} cases in {seconds:.0f} s ({seconds / len(planned):.1f} s each)"


def _spread(workers: int, work: Callable[..., str], jobs: Iterable[tuple], what: str) -> None:
    jobs = list(jobs)
    if workers <= 1:
        for done, job in enumerate(jobs, 1):
            print(f"{what} {done}/{len(jobs)}: {work(*job)}", file=sys.stderr, flush=True)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for done, line in enumerate(pool.map(work, *zip(*jobs, strict=True)), 1) if jobs else ():
            print(f"{what} {done}/{len(jobs)}: {line}", file=sys.stderr, flush=True)
