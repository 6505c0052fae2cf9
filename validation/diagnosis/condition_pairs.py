"""What differs between two conditions: ``python -m validation.diagnosis.condition_pairs``.

``--bank BANK --out ANSWERS`` compares, for every case of a bank of pairs (`python -m
validation.sealed_judge conditions`, or `python -m validation.blind conditions`), walking with the cause
against walking without it, as ``wrapjax diagnose CASE/with --against CASE/without`` does, and writes
``difference.json`` into a folder of each case. Only the folders of walking are read until all answers are
written. Then a row for each case and the figures of all are printed. Answers that are there already are kept.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.diagnosis.bank_cases import CLEAR
from wrapjax.cohorts.scheduling import run_jobs
from wrapjax.io.json_and_arrays import load_json


@dataclass(frozen=True)
class Pair:
    """Folder of a case with both conditions, and folder of its answer."""

    case: Path
    answer: Path


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.condition_pairs", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, help="only the first cases by their ids")
    options = parser.parse_args()
    cases = sorted(path.resolve() for path in (options.bank / "cases").glob("*"))[: options.first]
    if not cases:
        print(f"no cases in {options.bank}", file=sys.stderr)
        return 2
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    jobs = {case.name: Pair(case, out / case.name) for case in cases}
    failed = 0
    for number, one in enumerate(run_jobs(answer, jobs, workers=options.workers), 1):
        failed += bool(one.failure)
        print(f"{number}/{len(jobs)} {one.name}: {one.failure or one.value}", file=sys.stderr, flush=True)
    if failed:
        return 1
    rows = [
        judged(load_json(options.bank / "truth" / f"{name}.json"), load_json(out / name / "difference.json"))
        for name in jobs
    ]
    print("\n".join(table(dict(zip(jobs, rows, strict=True)))))
    return 0


def answer(pair: Pair) -> str:
    """Compare the conditions of a case, unless that was done, and return what was found."""
    from wrapjax.jax_setup import clear_caches_near_map_limit, set_up_jax

    set_up_jax()
    import wrapjax
    from wrapjax.subject.conditions import load_conditions

    file = pair.answer / "difference.json"
    if not file.exists():
        subject, names = load_conditions(pair.case / "with", pair.case / "without")
        paths = wrapjax.fit(subject, "engine", processes=1)
        wrapjax.diagnose_against(subject, names, "NGA", paths).save(pair.answer)
        clear_caches_near_map_limit()
    found = json.loads(file.read_text(encoding="utf-8"))
    return ", ".join([found["outcome"], *(one["id"] for one in found["named"] + found["ties"])])


@dataclass(frozen=True)
class Judged:
    """Cause of a pair with its d* by walking alone (empty and 0 for none), outcome, names, and its rank.

    The rank is the place of the cause, in the condition that has it, among all effects in either condition;
    None where the cause is not testable.
    """

    cause: str
    d_star: float
    outcome: str
    names: tuple[str, ...]
    right: bool
    rank: int | None
    first: str


def judged(truth: dict[str, Any], found: dict[str, Any]) -> Judged:
    """Compare an answer with the truth; a name is right if effect and condition are."""
    cause = cause_of(truth)
    order = [(one["id"], one["condition"]) for one in found["effects"]]
    named = [(one["id"], one["condition"]) for one in found["named"] or found["ties"]]
    true = (cause, "with")
    return Judged(
        cause,
        float(truth["d_star"]),
        found["outcome"],
        tuple(f"{id} {condition}" for id, condition in named),
        true in named,
        order.index(true) + 1 if true in order else None,
        " ".join(order[0]) if order else "",
    )


def cause_of(truth: dict[str, Any]) -> str:
    """Return the cause of a case of either simulator; empty for none."""
    causes = [cause.get("effect") or cause["id"] for cause in truth["causes"]]
    return causes[0] if causes else ""


def table(cases: dict[str, Judged]) -> list[str]:
    """Write a row for each case, and the figures of all."""
    lines = ["| case | cause (d*) | outcome | rank of the cause | first |", "|---|---|---|---|---|"]
    for name, one in cases.items():
        cause = f"`{one.cause}` ({one.d_star:.1f})" if one.cause else "none"
        outcome = ", ".join([one.outcome, *(f"`{each}`" for each in one.names)])
        lines.append(f"| {name} | {cause} | {outcome} | {one.rank or '-'} | `{one.first}` |")
    nulls = [one for one in cases.values() if not one.cause]
    clear = [one for one in cases.values() if one.cause and one.d_star > CLEAR]
    named = [one for one in cases.values() if one.outcome == "named"]
    first, three = (sum(one.rank is not None and one.rank <= last for one in clear) for last in (1, 3))
    lines += [
        "",
        f"nothing amiss: a name or tie in {sum(one.outcome != 'none' for one in nulls)} of {len(nulls)}",
        f"d* above {CLEAR:g}: right first in {first} of {len(clear)}, in the first three in {three}",
        f"named: {sum(one.right for one in named)} right of {len(named)}",
    ]
    return lines


if __name__ == "__main__":
    sys.exit(main())
