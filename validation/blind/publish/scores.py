"""Reader of the JSON file of the scorer."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.blind.score.figures import Row
from validation.blind.score.intervals import Figure, Target


class Unreadable(Exception):
    """Raised for a file that the scorer has not written, or an answerer that is not in it."""


@dataclass(frozen=True)
class PublishedScore:
    """Scores of one answerer; curves by their abscissa, confusion by family of the cause and of the name."""

    name: str
    rows: dict[str, Row]
    confusion: dict[str, dict[str, int]]
    curves: dict[str, dict[str, Figure]]
    effects: dict[str, Figure]
    cases: int

    @property
    def title(self) -> str:
        return self.name.replace("_", " ")


def read_scores(file: Path, of: str | None = None) -> list[PublishedScore]:
    """Read the scores of all answerers, the published one (by default the first of the file) first.

    Raises
    ------
    Unreadable
        If the scorer has not written the file, or it has no such answerer.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        scores = {name: _read_answerer(name, part) for name, part in content.items()}
    except OSError as error:
        raise Unreadable(f"{file}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"{file}: not what this version of 'score --json' writes ({type(error).__name__}: {error})"
        raise Unreadable(message) from error
    if not scores or (of is not None and of not in scores):
        raise Unreadable(f"{file}: no answerer {of or 'at all'}; there are {', '.join(scores) or 'none'}")
    first = of or next(iter(scores))
    return [scores[first], *(one for name, one in scores.items() if name != first)]


def _read_answerer(name: str, part: dict[str, Any]) -> PublishedScore:
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
    return PublishedScore(
        name,
        {row.key: row for row in rows},
        part["confusion"],
        {key: _figures(part[key]) for key in curves},
        _figures(part["effects"]),
        part["cases"],
    )


def _figures(part: dict[str, dict[str, Any]]) -> dict[str, Figure]:
    return {key: Figure(**entry) for key, entry in part.items()}
