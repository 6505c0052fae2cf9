"""Figures of the answers to a bank of the independent simulator ``validation.sealed_judge``.

``python -m validation.diagnosis.judge_table --bank BANK --answers ANSWERS`` reads the truth of every case and
the answers of `validation.diagnosis.diagnose_bank`, and prints how often the cause is ranked first and named,
with one-sided 95 % bounds clustered by person. This opens the bank: its manifest is committed before.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from validation.blind.score.figures import Row, naming_rows
from validation.blind.score.intervals import Target
from validation.blind.score.records import Case, Truth, read_answer
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.errors import InputError, Problem

#: Targets of a diagnosis from walking alone, in a simulator that nothing was fitted on.
TARGETS = {
    "first_clear": Target(least=0.68),
    "first_plain": Target(least=0.88),
    "three_clear": Target(least=0.85),
    "three_plain": Target(least=0.95),
    "coverage": Target(least=0.45),
    "right_or_family": Target(least=0.65),
    "precision": Target(least=0.92),
    "false_alarms": Target(most=0.05),
    "wrong_outside": Target(most=0.08),
    "set_coverage": Target(least=0.90),
    "set_size": Target(most=6.0),
    "calibration": Target(most=0.05),
    "pair_both": Target(least=0.50),
}


def main() -> int:
    options = _parser().parse_args()
    try:
        cases = judged_cases(options.bank, options.answers, options.first)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(table(naming_rows(cases, TARGETS)))
    if options.each:
        print("\n".join(map(describe, cases)))
    return 0


def judged_cases(bank: Path, answers: Path, first: int | None = None) -> list[Case]:
    """Read truth and answer of every case, or of the first by id; the truth of others is not opened.

    Raises
    ------
    InputError
        If the bank has no truth, or a case has no answer.
    """
    truths = sorted((bank / "truth").glob("*.json"))[:first]
    if not truths:
        raise InputError(Problem(str(bank), "no bank: make it with python -m validation.sealed_judge make"))
    missing = [file.stem for file in truths if not (answers / file.stem / "gap.json").is_file()]
    if missing:
        raise InputError(Problem(str(answers), f"{len(missing)} cases are not answered, {missing[0]} first"))
    return [Case(Truth(_read_truth(file), file), read_answer(answers / file.stem)) for file in truths]


def _read_truth(file: Path) -> dict[str, Any]:
    """Read a truth of the judge, with the families of the catalogue; it states no ties."""
    truth = json.loads(file.read_text(encoding="utf-8"))
    causes = [{"id": one["effect"], "family": _family(one)} for one in truth["causes"]]
    return {**truth, "causes": causes, "ties": []}


def _family(cause: dict[str, Any]) -> str:
    return CATALOGUE[cause["effect"]].family if cause["effect"] in CATALOGUE else str(cause["family"])


def table(rows: list[Row]) -> str:
    """Write rows as a table in Markdown."""
    lines = ["| figure | value | 95 % bounds | cases | target | |", "|---|---|---|---|---|---|"]
    for row in rows:
        figure = row.figure
        if figure.value is None:
            continue
        bounds = "" if figure.lower is None else f"{figure.lower:.2f} to {figure.upper:.2f}"
        target = row.target or ""
        lines.append(
            f"| {row.text} | {figure.value:.2f} | {bounds} | {figure.n} | {target} | {row.verdict} |"
        )
    return "\n".join(lines)


def describe(case: Case) -> str:
    """Describe the truth of a case and the answer in one line."""
    answer, truth = case.answer, case.truth
    first = ", ".join(f"{id} {answer.probabilities[id]:.2f}" for id in answer.ranking[:3])
    causes = " and ".join(truth.causes) or "nothing"
    said = ", ".join(sorted(answer.named)) or (answer.raw.get("family") or {}).get("id", "")
    return f"{truth.id} {truth.tier}: {causes}, d* {truth.d_star:.1f}; {answer.outcome} {said}; first {first}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.judge_table", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument(
        "--first", type=int, metavar="N", help="only the first N cases by id; their order is random"
    )
    parser.add_argument("--each", action="store_true", help="also print a line for each case")
    return parser


if __name__ == "__main__":
    sys.exit(main())
