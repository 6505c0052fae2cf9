"""Simulation of a bank: libraries of the persons, plan, cases and manifest; continues an interrupted run."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

from validation.blind.background import background_of
from validation.blind.case import make_case
from validation.blind.case_selection import ALL_CASES, CaseSelection
from validation.blind.effects import EFFECTS
from validation.blind.effects.effect import Variant
from validation.blind.library import Library, build_library, library_file, variants_in
from validation.blind.oracle import oracles
from validation.blind.outside_catalogue import OUTSIDE
from validation.blind.person import Person, draw_person
from validation.blind.plan import Bank, PlannedCase, paretic, plan_cases, settings_of, with_targets
from validation.blind.seal import seal
from validation.blind.worlds import WorldSettings


def variants_of(settings: WorldSettings) -> dict[str, tuple[Variant, ...]]:
    """Return the variants of each effect in a world."""
    return {name: variants_in(effect, settings) for name, effect in {**EFFECTS, **OUTSIDE}.items()}


def person_of(bank: Bank, index: int, session: tuple[int, ...] | None = None) -> Person:
    """Draw a person of a bank by number; with a seed of a session, walking once more."""
    seed, settings = (bank.seed, 0, index), settings_of(bank, index)
    return draw_person(f"{bank.name}_{index:02d}", seed, settings, paretic(index), session)


def make(
    bank: Bank | Sequence[Bank], folder: Path, workers: int = 1, selection: CaseSelection = ALL_CASES
) -> list[PlannedCase]:
    """Make the selected cases of a bank, or of the worlds of one, and write their manifest."""
    banks = [bank] if isinstance(bank, Bank) else bank
    (folder / "library").mkdir(parents=True, exist_ok=True)
    people = {index: part for part in banks for index in part.persons}
    missing = [index for index in people if not library_file(folder, index).exists()]
    _run_jobs(workers, _make_library, [(people[index], folder, index) for index in missing], "people")
    planned = [case for part in banks for case in _planned(part, folder)]
    selected = set(selection.select(case.id for case in planned))
    planned = [case for case in planned if case.id in selected]
    todo = {i: [case for case in planned if case.person == i and not _is_made(folder, case)] for i in people}
    jobs = [(people[index], folder, index, some) for index, some in todo.items() if some]
    _run_jobs(workers, _make_cases, jobs, "people's cases")
    seal(folder)
    return planned


def _planned(bank: Bank, folder: Path) -> list[PlannedCase]:
    libraries = {index: Library.load(library_file(folder, index)) for index in bank.persons}
    variants = variants_of(settings_of(bank, bank.first_person))
    return with_targets(bank, plan_cases(bank, variants), libraries)


def _is_made(folder: Path, case: PlannedCase) -> bool:
    return (folder / "cases" / case.id).exists()


def _make_library(bank: Bank, folder: Path, index: int) -> str:
    start = perf_counter()
    who = person_of(bank, index)
    library = build_library(who.world, oracles(who.world, who.world.settings.emg.levels))
    partial = folder / "library" / f"partial_{index:02d}.npz"
    library.save(partial)
    partial.replace(library_file(folder, index))
    return f"{who.name}: {len(library.entries)} signatures in {perf_counter() - start:.0f} s"


def _make_cases(bank: Bank, folder: Path, index: int, planned: list[PlannedCase]) -> str:
    start = perf_counter()
    who = person_of(bank, index)
    library = Library.load(library_file(folder, index))
    known = oracles(who.world, tuple(sorted({case.level for case in planned})))
    background = background_of(who, (bank.seed, 4, index))
    for case in planned:
        make_case(bank, case, who, library, known, folder, background)
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
