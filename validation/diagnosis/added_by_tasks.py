"""What tasks other than gait added to the evidence: ``python -m validation.diagnosis.added_by_tasks``.

``--bank BANK --answers ANSWERS`` reads answers of `validation.diagnosis.diagnose_bank` to cases with such
trials, and the bank's truths. For each case a row: outcome; evidence of the first cause by walking, and what
the other tasks add; the same of the effect that is no cause and has most evidence with all of it. Below them
the places of single causes above d* 2 among all effects, by the evidence of walking and by all evidence.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from validation.diagnosis.bank_cases import CLEAR
from wrapjax.io.json_and_arrays import load_json


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.added_by_tasks", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--answers", type=Path, required=True)
    options = parser.parse_args()
    rows, places = [], []
    for file in sorted(options.answers.glob("*/gap.json")):
        truth = json.loads((options.bank / "truth" / f"{file.parent.name}.json").read_text(encoding="utf-8"))
        found = load_json(file)
        rows.append(row(file.parent.name, truth, found))
        if truth["tier"] == "single" and truth["d_star"] > CLEAR:
            places.append(places_of_cause(truth, found))
    if not rows:
        print(f"no answers in {options.answers}", file=sys.stderr)
        return 2
    header = ("case", "causes (d*)", "outcome", "of the first cause", "strongest of the others")
    rows[:0] = [header, ("---",) * len(header)]
    for cells in rows:
        print(f"| {' | '.join(cells)} |")
    for label, own in zip(("walking", "all tasks"), zip(*places, strict=True), strict=False):
        first, three = (sum(place is not None and place <= last for place in own) for last in (1, 3))
        print(f"by {label}: right first in {first} of {len(own)}, in the first three in {three}")
    return 0


def places_of_cause(truth: dict[str, Any], answer: dict[str, Any]) -> tuple[int | None, int | None]:
    """Return the place of the cause among all effects, by walking and by all tasks; None if not testable."""
    added = (answer["other_tasks"] or {"added_nats": {}})["added_nats"]
    total = {one["id"]: one["evidence_nats"] for one in answer["effects"] if one["evidence_nats"] is not None}
    cause = truth["causes"][0]["effect"]
    if cause not in total:
        return None, None
    walking = {id: value - added.get(id, 0.0) for id, value in total.items()}
    by_walking, by_all = (
        1 + sum(value > evidence[cause] for value in evidence.values()) for evidence in (walking, total)
    )
    return by_walking, by_all


def row(name: str, truth: dict[str, Any], answer: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a case, from its truth and its answer."""
    added = (answer["other_tasks"] or {"added_nats": {}})["added_nats"]
    evidence = {
        one["id"]: one["evidence_nats"] for one in answer["effects"] if one["evidence_nats"] is not None
    }
    causes = {one["effect"]: one["d_star"] for one in truth["causes"]}
    others = [id for id in evidence if id not in causes]
    strongest = max(others, key=lambda id: evidence[id]) if others else ""
    outcome = ", ".join([answer["outcome"], *(f"`{id}`" for id in answer["named"])])

    def described(id: str) -> str:
        more = added.get(id, 0.0)
        return f"{evidence[id] - more:.1f} {more:+.1f}" if id in evidence else "not testable"

    first = next(iter(causes), "")
    return (
        name,
        ", ".join(f"`{id}` ({size:.1f})" for id, size in causes.items()) or "none",
        outcome,
        described(first) if first else "",
        f"`{strongest}` {described(strongest)}" if strongest else "",
    )


if __name__ == "__main__":
    sys.exit(main())
