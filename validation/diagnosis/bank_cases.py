"""Cases of a blind bank: as those see them who answer, and with their truth where that may be looked at."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from validation.blind.case_selection import ALL_CASES, CaseSelection
from wrapjax.errors import InputError, Problem
from wrapjax.io.json_and_arrays import load_json

#: Manifests of test banks.
SEALED = Path(__file__).parents[1] / "blind" / "sealed"
#: d* from which on a cause can be found at all.
CLEAR = 2.0


def cases_of(bank: Path, selection: CaseSelection = ALL_CASES) -> list[Path]:
    """Folders of a bank's cases in the order of their ids, which are hashes.

    Raises
    ------
    InputError
        If there are none.
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
    """Read what is true of a case of a development bank.

    Raises
    ------
    InputError
        If the case was sealed for a test bank (nothing is opened then), or is of no development bank.
    OSError
        If there is none.
    """
    file = bank / "truth" / f"{case}.json"
    no_other = InputError(Problem(str(file), "expected a case of a development bank: others teach nothing"))
    if any(case in load_json(manifest)["cases"] for manifest in SEALED.glob("*.json")):
        raise no_other
    truth = json.loads(file.read_text(encoding="utf-8"))
    if truth["bank"] != "development":
        raise no_other
    return dict(truth)
