"""Two conditions of recorded people: ``python -m validation.recorded.conditions --out DIR``.

Every second calibration cycle of a recording is one condition, and the others are the second one. Nothing
differs between them, or one known error (`manipulations_of`) was added to the first. The table says which
effect ``wrapjax diagnose --against`` finds. Recordings with fewer than three cycles of each condition at a
speed have no answer. Answers that are in DIR already are kept.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from benchmarks.machine import pin_threads
from validation.diagnosis.condition_pairs import Judged, Pair, answer, judged
from validation.recorded.manipulations import Manipulation, manipulations_of, write_manipulation
from validation.recorded.recordings import add_subjects_argument, settings_of
from validation.recorded.subsets import parts_of
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.diagnosis.effects.catalogue import family_of
from wrapjax.errors import InputError
from wrapjax.io.json_and_arrays import load_json

#: Folders of $WRAPJAX_DATA that are used by default: those with enough cycles at one speed.
PEOPLE = ("healthy_treadmill", "healthy_running")
UNTOUCHED = Manipulation("untouched", "nothing", list, None)


def main() -> int:
    options = _parser().parse_args()
    # JAX reads the thread counts once, when it is imported.
    pin_threads()
    out = options.out.resolve()
    try:
        known = {
            f"{person.name}.{one.name}": one
            for person in options.subjects
            for one in write_pairs(person, out / "cases", options.size)
        }
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    jobs = {name: Pair(out / "cases" / name, out / "answers" / name) for name in known}
    failed = 0
    for number, one in enumerate(run_jobs(answer, jobs, workers=options.workers), 1):
        failed += bool(one.failure)
        print(f"{number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr, flush=True)
    found = {
        name: judged(_truth(known[name]), load_json(job.answer / "difference.json"))
        for name, job in jobs.items()
        if (job.answer / "difference.json").exists()
    }
    print(table(known, found), end="")
    return 1 if failed else 0


def write_pairs(person: Path, out: Path, size: float) -> list[Manipulation]:
    """Write ``<person>.<error>/with`` and ``/without`` for every error that a condition can have.

    Parameters
    ----------
    person
        Subject folder.
    out
        Folder of the pairs.
    size
        Size of the errors in prior standard deviations.

    Returns
    -------
    errors
        What was added to the first condition of each pair; first nothing.
    """
    # A channel that one condition lacks makes them incomparable, and is no question for a diagnosis.
    possible = [one for one in manipulations_of(person, (size,)) if not one.hidden]
    settings = (person / "subject.toml").read_text(encoding="utf-8")
    halves = parts_of(settings)
    model = settings_of(person)["model"]["file"]
    written = [UNTOUCHED, *possible]
    for one in written:
        place = out / f"{person.name}.{one.name}"
        if place.exists():
            continue
        work = place.with_name(f"{place.name}.part")
        shutil.rmtree(work, ignore_errors=True)
        for name, error, half in (("with", one, "odd_cycles"), ("without", UNTOUCHED, "even_cycles")):
            work.mkdir(parents=True, exist_ok=True)
            write_manipulation(person, work / name, error)
            # Masses are wrong in inverse dynamics alone: both conditions have one model.
            shutil.copyfile(person / model, work / name / model)
            (work / name / "subject.toml").write_text(halves[half], encoding="utf-8")
        work.rename(place)
    return written


def _truth(error: Manipulation) -> dict[str, object]:
    causes = [{"effect": error.effect}] if error.effect else []
    return {"causes": causes, "d_star": 0.0}


def table(errors: Mapping[str, Manipulation], found: Mapping[str, Judged]) -> str:
    """Format a Markdown table of all pairs, and the counts of right and wrong answers."""
    lines = [
        "| recording | error of one condition | outcome | rank of its effect | first |",
        "|---|---|---|---|---|",
    ]
    for name, one in found.items():
        outcome = ", ".join([one.outcome, *(f"`{each}`" for each in one.names)])
        person = name.partition(".")[0]
        lines.append(f"| `{person}` | {errors[name].says} | {outcome} | {one.rank or '-'} | `{one.first}` |")
    changed = [one for one in found.values() if one.cause]
    same = [one for one in found.values() if not one.cause]
    claimed = [one for one in changed if one.names]
    families = sum(
        bool(one.first) and family_of(one.first.split()[0]) == family_of(one.cause) for one in changed
    )
    lines += [
        "",
        f"Right effect first, in the condition that has it: {sum(one.rank == 1 for one in changed)} of "
        f"{len(changed)}; right family first: {families}. Named or tied: {len(claimed)}, "
        f"{sum(one.right for one in claimed)} of them with the right effect.",
        f"Nothing added: a name or tie in {sum(bool(one.names) for one in same)} of {len(same)}.",
    ]
    return "\n".join(lines) + "\n"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.recorded.conditions", description=__doc__)
    add_subjects_argument(parser, PEOPLE)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--size", type=float, default=2.0, help="size of the errors in prior standard deviations"
    )
    parser.add_argument("--workers", type=int, default=1)
    return parser


if __name__ == "__main__":
    sys.exit(main())
