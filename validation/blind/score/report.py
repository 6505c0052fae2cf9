"""Scores of answerers on a sealed bank, as JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from validation.blind.case_selection import ALL_CASES, CaseSelection
from validation.blind.score import breakdown
from validation.blind.score.figures import CLEAR, Row, all_rows, correctly_named
from validation.blind.score.intervals import Figure
from validation.blind.score.records import Case, read_cases, read_truth, unanswered
from validation.blind.seal import broken_seals, digest


class NotReady(Exception):
    """Raised if answers are missing or the bank differs from its manifest."""


def score(
    bank: Path,
    answerers: Mapping[str, Path],
    withheld: Mapping[str, Path] | None = None,
    manifest: Path | None = None,
    selection: CaseSelection = ALL_CASES,
) -> dict[str, Any]:
    """Score all answerers; every run is logged in ``score_log.jsonl`` of the bank.

    Parameters
    ----------
    bank, manifest
        Folder of the bank, and its manifest (default: that of the bank).
    answerers, withheld
        Folders of answers by name, and of answers with each single cause withheld from the catalogue.
    selection
        Cases to score; the truth of the others is not read.

    Raises
    ------
    NotReady
        If the bank differs from its manifest or an answer is missing.
    """
    faults = broken_seals(bank, manifest, selection)
    if faults:
        raise NotReady(f"the seal is broken: {'; '.join(faults[:5])}" + (" ..." if len(faults) > 5 else ""))
    truths = read_truth(bank, selection)
    withheld = withheld or {}
    for name, folder in answerers.items():
        missing = unanswered(truths, folder, withheld.get(name))
        if missing:
            raise NotReady(f"{name}: {len(missing)} cases are without an answer, the first {missing[0]}")
    result = {
        name: score_answerer(bank, read_cases(truths, folder, withheld.get(name)))
        for name, folder in answerers.items()
    }
    _log(bank, answerers, manifest, len(truths), selection)
    return result


def score_answerer(bank: Path, cases: list[Case]) -> dict[str, Any]:
    """Compute all figures of one answerer."""
    single = [c for c in cases if c.truth.tier == "single"]
    clear = [c for c in single if c.truth.d_star > CLEAR]
    effects = breakdown.by_effect(single)
    return {
        "rows": all_rows(bank, cases),
        "confusion": breakdown.confusion(cases),
        "magnitude": breakdown.over_magnitude(single),
        "magnitude_named": breakdown.over_magnitude(single, correctly_named),
        "noise": breakdown.over_noise(clear),
        "noise_named": breakdown.over_noise(clear, correctly_named),
        "effects": effects,
        "worst": breakdown.worst(effects),
        "cases": len(cases),
    }


def _log(
    bank: Path, answerers: Mapping[str, Path], manifest: Path | None, cases: int, selection: CaseSelection
) -> None:
    line = {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "manifest": digest(manifest or bank / "manifest.json"),
        "cases": cases,
        "after": selection.after,
        "left_out": selection.left_out,
        "answers": {name: digest(folder) for name, folder in answerers.items()},
    }
    with (bank / "score_log.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(line, sort_keys=True) + "\n")


def as_json(result: dict[str, Any]) -> str:
    def plain(value: Any) -> Any:
        if isinstance(value, (Row, Figure)):
            extra = {"verdict": value.verdict} if isinstance(value, Row) else {}
            return {**asdict(value), **extra}
        raise TypeError(type(value).__name__)

    return json.dumps(result, default=plain, indent=1) + "\n"


def as_markdown(result: dict[str, Any]) -> str:
    """Format figures of all answerers side by side, then the confusion and curves of each."""
    names = list(result)
    lines = ["| figure | target | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for index, row in enumerate(result[names[0]]["rows"]):
        cells = [_cell(result[name]["rows"][index]) for name in names]
        lines.append(f"| {row.text} | {row.target or ''} | " + " | ".join(cells) + " |")
    for name in names:
        part = result[name]
        lines += ["", f"**{name}**, {part['cases']} cases. Cause (down) and what was named (across):", ""]
        lines += _confusion(part["confusion"])
        lines += ["", _curve("Right first by d*", part["magnitude"])]
        lines += [_curve("Named and right by d*", part["magnitude_named"])]
        lines += [_curve("Right first by EMG noise, d* over 2", part["noise"])]
        lines += [_curve("Named and right by EMG noise, d* over 2", part["noise_named"])]
        if part["worst"]:
            effect, figure = part["worst"]
            lines += [f"Worst effect: `{effect}`, right first in {_number(figure)} of {figure.n}."]
    return "\n".join(lines) + "\n"


def _number(figure: Figure) -> str:
    return "-" if figure.value is None else f"{figure.value:.2f}"


def _cell(row: Row) -> str:
    f = row.figure
    if f.value is None:
        return "-"
    bounds = f" [{f.lower:.2f}, {f.upper:.2f}]" if f.lower is not None else ""
    return f"{f.value:.2f}{bounds} n={f.n}" + (f" **{row.verdict}**" if row.verdict else "")


def _curve(title: str, figures: dict[str, Figure]) -> str:
    return (
        f"{title}: "
        + "; ".join(f"{name.split(': ')[-1]}: {_number(f)} (n={f.n})" for name, f in figures.items())
        + "  "
    )


def _confusion(table: dict[str, dict[str, int]]) -> list[str]:
    columns = sorted({column for row in table.values() for column in row})
    lines = ["| | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    lines += [
        f"| {name} | " + " | ".join(str(row.get(c, "")) for c in columns) + " |"
        for name, row in table.items()
    ]
    return lines
