"""Tables of all effects for the documentation.

``python -m wrapjax.diagnosis.effects.table docs/effects.md`` writes them anew.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.definition import EffectDefinition, RepeatedParameter
from wrapjax.diagnosis.effects.effect import FAMILIES, EffectParameter

#: Lines of a document between which the tables stand.
START, END = "<!-- tables: start -->", "<!-- tables: end -->"

#: Unit or limit that differs between the repetitions of a parameter.
_DIFFERS = "differs"


def effect_tables() -> str:
    """Write tables in Markdown: the families, all effects, and all their parameters."""
    families = _markdown_table(("family", "meaning"), ((f"`{id}`", text) for id, text in FAMILIES.items()))
    effects = _markdown_table(
        ("effect", "meaning", "family", "needs", "experiment that shows it"),
        (_effect_row(definition) for definition in CATALOGUE.values()),
    )
    parameters = _markdown_table(
        ("effect", "parameters", "unit", "prior SD", "usual SD", "limits", "source of the prior"),
        (row for definition in CATALOGUE.values() for row in _parameter_rows(definition)),
    )
    return f"{families}\n\n{effects}\n\n{parameters}"


def with_tables(document: str) -> str:
    """Replace the tables of a document, between the lines `START` and `END`."""
    before, _, rest = document.partition(START)
    _, _, after = rest.partition(END)
    return f"{before}{START}\n\n{effect_tables()}\n\n{END}{after}"


def _effect_row(definition: EffectDefinition) -> tuple[str, ...]:
    role = "nuisance" if definition.nuisance else "negative control" if definition.negative_control else ""
    experiment = definition.experiment
    return (
        f"`{definition.id}`" + (f" ({role})" if role else ""),
        definition.meaning,
        f"`{definition.family}`",
        "; ".join(definition.needs) or "nothing else",
        "none" if experiment is None else f"{experiment.text} ({experiment.minutes} min)",
    )


def _parameter_rows(definition: EffectDefinition) -> Iterator[tuple[str, ...]]:
    """Write one row for each group of consecutive parameters that differ in name and meaning only."""
    for numbers, group in groupby(definition.parameters, key=_numbers):
        yield (f"`{definition.id}`", ", ".join(f"`{entry.name}`" for entry in group), *numbers)


def _numbers(entry: EffectParameter | RepeatedParameter) -> tuple[str, ...]:
    prior = entry.prior if isinstance(entry, RepeatedParameter) else ""
    if not prior:
        prior = f"{entry.prior_sd:g}"
    usual = f"{entry.usual_sd:g}" if entry.usual_sd else ""
    return entry.unit or _DIFFERS, prior, usual, _limits(entry.limit, entry.sign), entry.source


def _limits(limit: float | None, sign: int) -> str:
    if limit is None:
        return _DIFFERS
    if np.isinf(limit):
        return "≥ 0" if sign else "none"
    return f"0 to {limit:g}" if sign else f"±{limit:g}"


def _markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    file = Path(sys.argv[1])
    file.write_text(with_tables(file.read_text(encoding="utf-8")), encoding="utf-8")
