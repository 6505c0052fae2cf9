"""``[[passive]]`` of the settings: recordings of a leg at rest."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrapjax.errors import Problem
from wrapjax.subject.schema import TableReader, describe_value


@dataclass(frozen=True)
class PassiveSettings:
    """One ``[[passive]]``: its name, unique among them, and its files."""

    name: str
    angles: Path
    moments: Path


def read_passive_settings(
    tables: Any, file: Path, folder: Path, problems: list[Problem]
) -> tuple[PassiveSettings, ...]:
    """Take all ``[[passive]]`` tables, without those that are unfit; none where there is none."""
    if tables is None:
        return ()
    if not isinstance(tables, list):
        message = f"expected tables [[passive]], found {describe_value(tables)}"
        problems.append(Problem(str(file), message, "passive"))
        return ()
    found = []
    for number, table in enumerate(tables, start=1):
        label = table.get("name") if isinstance(table, dict) else None
        place = (
            f"[[passive]] '{label}'" if isinstance(label, str) and label else f"[[passive]] number {number}"
        )
        reader = TableReader(table, file, place, problems)
        name = reader.text("name")
        angles, moments = (reader.path(key, folder) for key in ("angles", "moments"))
        reader.finish()
        if name is not None and angles is not None and moments is not None:
            found.append(PassiveSettings(name, angles, moments))
    for name, count in Counter(trial.name for trial in found).items():
        if count > 1:
            message = f"expected every trial to have a name of its own, found {count}"
            problems.append(Problem(str(file), message, f"[[passive]] '{name}'"))
    return tuple(found)
