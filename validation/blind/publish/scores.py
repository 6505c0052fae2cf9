"""The scorer's JSON, read back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.blind.score.figures import Row
from validation.blind.score.intervals import Figure, Target


class Unreadable(Exception):
    """A file that the scorer has not written, or a name that is not in it."""


@dataclass(frozen=True)
class Judged:
    """What the scorer says of one answerer; curves by what they are over, confusion by cause and name."""

    name: str
    rows: dict[str, Row]
    confusion: dict[str, dict[str, int]]
    curves: dict[str, dict[str, Figure]]
    effects: dict[str, Figure]
    cases: int

    @property
    def title(self) -> str:
        return self.name.replace("_", " ")


def read_scores(file: Path, of: str | None = None) -> list[Judged]:
    """All answerers, the one that is published (the first if not named) before those it is compared with.

    Raises
    ------
    Unreadable
        If the file is not the scorer's, or has no such answerer.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        found = {name: _judged(name, part) for name, part in content.items()}
    except OSError as error:
        raise Unreadable(f"{file}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"{file}: not what this version of 'score --json' writes ({type(error).__name__}: {error})"
        raise Unreadable(message) from error
    if not found or (of is not None and of not in found):
        raise Unreadable(f"{file}: no answerer {of or 'at all'}; there are {', '.join(found) or 'none'}")
    first = of or next(iter(found))
    return [found[first], *(one for name, one in found.items() if name != first)]


def _judged(name: str, part: dict[str, Any]) -> Judged:
    rows = (
        Row(
            row["key"],
            row["text"],
            Figure(**row["figure"]),
            Target(**row["target"]) if row["target"] else None,
        )
        for row in part["rows"]
    )
    curves = ("magnitude", "magnitude_named", "noise", "noise_named")
    return Judged(
        name,
        {row.key: row for row in rows},
        part["confusion"],
        {key: _figures(part[key]) for key in curves},
        _figures(part["effects"]),
        part["cases"],
    )


def _figures(part: dict[str, dict[str, Any]]) -> dict[str, Figure]:
    return {key: Figure(**own) for key, own in part.items()}
