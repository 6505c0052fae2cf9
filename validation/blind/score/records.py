"""Truth of a case and answer (`gap.json`), as records."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.case_selection import CaseSelection

UNNAMED_OUTCOMES = ("none", "unknown")
#: Outcome that names no effect, but the family of several.
FAMILY_OUTCOME = "family"
STOPPED_OUTCOMES = ("insufficient_data", "not_converged")


@dataclass(frozen=True)
class Truth:
    """Truth of a case; ``raw`` is the content of the file."""

    raw: dict[str, Any]
    clean_file: Path

    @property
    def id(self) -> str:
        return str(self.raw["id"])

    @property
    def person(self) -> str:
        return str(self.raw["person"])

    @property
    def tier(self) -> str:
        return str(self.raw["tier"])

    @property
    def d_star(self) -> float:
        return float(self.raw["d_star"])

    @property
    def causes(self) -> tuple[str, ...]:
        return tuple(cause["id"] for cause in self.raw["causes"])

    @property
    def family(self) -> str:
        return str(self.raw["causes"][0]["family"]) if self.raw["causes"] else self.tier

    @property
    def ties(self) -> frozenset[str]:
        """Effects that are tied with the cause."""
        return frozenset(self.raw["ties"])

    @property
    def accepted(self) -> frozenset[str]:
        return self.ties | frozenset(self.causes)

    @cached_property
    def clean(self) -> np.ndarray:
        """Recorded moments without noise, (recording, coordinate, frame)."""
        return np.load(self.clean_file)


@dataclass(frozen=True)
class Answer:
    """Answer to a case; ``raw`` is the content of ``gap.json``, ``folder`` also has its moments."""

    raw: dict[str, Any]
    folder: Path

    @property
    def outcome(self) -> str:
        return str(self.raw["outcome"])

    @property
    def names(self) -> bool:
        """Whether it names a cause; a tie does."""
        return self.outcome in ("named", "tie")

    @property
    def named(self) -> frozenset[str]:
        """Named effects, including members of ties."""
        if not self.names:
            return frozenset()
        members = (
            {name for tie in self.raw.get("ties") or [] for name in tie} if self.outcome == "tie" else set()
        )
        return frozenset(members | set(self.raw.get("named") or []))

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Probabilities by effect, `none` and `unknown`; with the remainder at the outcome or `unknown`."""
        given = {str(e["id"]): float(e.get("probability") or 0.0) for e in self.raw.get("effects") or []}
        for name in UNNAMED_OUTCOMES:
            if name in self.raw and isinstance(self.raw[name], (int, float)):
                given[name] = float(self.raw[name])
        for name, value in (self.raw.get("probabilities") or {}).items():
            given[str(name)] = float(value)
        rest = 1.0 - sum(given.values())
        if rest > 1e-6:
            name = self.outcome if self.outcome in UNNAMED_OUTCOMES else "unknown"
            given[name] = given.get(name, 0.0) + rest
        return given

    @property
    def ranking(self) -> list[str]:
        """Effects with positive probability, the most probable first."""
        some = {name: p for name, p in self.probabilities.items() if name not in UNNAMED_OUTCOMES and p > 0.0}
        return sorted(some, key=lambda name: (-some[name], name))

    @property
    def top(self) -> tuple[str, float]:
        name = max(self.probabilities, key=lambda key: (self.probabilities[key], key))
        return name, self.probabilities[name]

    def parameters(self, effect: str) -> dict[str, dict[str, Any]]:
        for entry in self.raw.get("effects") or []:
            if entry["id"] == effect:
                return {p["name"]: p for p in entry.get("parameters") or []}
        return {}


@dataclass(frozen=True)
class Case:
    """Truth and answer of a case, and the answer with its cause withheld."""

    truth: Truth
    answer: Answer
    withheld: Answer | None = None


def read_truth(bank: Path, selection: CaseSelection) -> list[Truth]:
    """Read the truth of the selected cases only, by id."""
    present = {path.stem: path for path in (bank / "truth").glob("*.json")}
    return [
        Truth(json.loads(present[id].read_text(encoding="utf-8")), present[id].with_suffix(".npy"))
        for id in selection.select(present)
    ]


def read_answer(folder: Path) -> Answer:
    return Answer(json.loads((folder / "gap.json").read_text(encoding="utf-8")), folder)


def unanswered(truths: list[Truth], answers: Path, withheld: Path | None) -> list[str]:
    """List cases without an answer; scoring requires all, so that it cannot be stopped at a good result."""
    missing = [t.id for t in truths if not (answers / t.id / "gap.json").exists()]
    if withheld is not None:
        singles = [t for t in truths if t.tier == "single"]
        missing += [f"{t.id} (withheld)" for t in singles if not (withheld / t.id / "gap.json").exists()]
    return missing


def read_cases(truths: list[Truth], answers: Path, withheld: Path | None) -> list[Case]:
    return [
        Case(
            truth,
            read_answer(answers / truth.id),
            read_answer(withheld / truth.id) if withheld and truth.tier == "single" else None,
        )
        for truth in truths
    ]
