"""Case folders of a blind bank, and the truth of cases of development banks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from validation.blind.case_selection import ALL_CASES, CaseSelection
from wrapjax.errors import InputError, Problem
from wrapjax.io.json_and_arrays import load_json

#: Folder of the manifests of test banks.
SEALED = Path(__file__).parents[1] / "blind" / "sealed"
#: d* above which a cause can be identified.
CLEAR = 2.0


def cases_of(bank: Path, selection: CaseSelection = ALL_CASES) -> list[Path]:
    """Return the folders of a bank's selected cases, ordered by id.

    Raises
    ------
    InputError
        If the bank has no cases.
    """
    folder = bank / "cases"
    cases = sorted(path.parent for path in folder.glob("*/subject.toml"))
    if not cases:
        raise InputError(
            Problem(
                str(folder), "no cases of a blind bank", hint="make them with python -m validation.blind make"
            )
        )
    by_id = {case.name: case.resolve() for case in cases}
    return [by_id[id] for id in selection.select(by_id)]


def development_truth(bank: Path, case: str) -> dict[str, Any]:
    """Read the truth of a case of a development bank (`development` or `worlds`).

    Raises
    ------
    InputError
        If the case belongs to a test bank (its truth is not read), or to no development bank.
    OSError
        If the truth file is missing.
    """
    file = bank / "truth" / f"{case}.json"
    not_development = InputError(Problem(str(file), "expected a case of a development bank"))
    if any(case in load_json(manifest)["cases"] for manifest in SEALED.glob("*.json")):
        raise not_development
    truth = json.loads(file.read_text(encoding="utf-8"))
    if truth["bank"] not in ("development", "worlds"):
        raise not_development
    return dict(truth)
