"""The table of figures, targets and verdicts, others beside it, and where it fails."""

from __future__ import annotations

from collections.abc import Sequence

from validation.blind.publish.scores import Judged
from validation.blind.score.breakdown import FEWEST
from validation.blind.score.figures import Row
from validation.blind.score.intervals import Figure, Target

#: Figures that are no shares.
NUMBERS = {"set_size", "calibration", "shrinkage", "map", "unknown_auroc"}
#: What those without probabilities and refits can be compared by.
COMPARED = {
    "first_clear",
    "first_plain",
    "first_all",
    "first_strict",
    "three_clear",
    "three_plain",
    "three_all",
    "coverage",
    "precision",
    "precision_strict",
    "false_alarms",
    "wrong_outside",
    "pair_one",
    "pair_both",
}
#: Effects that are listed where it fails.
FAILURES = 5
NOTHING = "-"

_EXPLAINED = (
    "Bounds in brackets are one-sided, 95 % each, with cases clustered by person. A target is met or failed "
    "where both bounds are on one side of it, else the bank cannot tell (not distinguishable)."
)


def as_table(judged: Sequence[Judged]) -> str:
    """Markdown: the first with targets and verdicts, the others beside it where they can be judged."""
    first, *others = judged
    heads = ["figure", "target", first.title, "cases", "verdict", *(one.title for one in others)]
    lines = [_line(heads), "|" + "---|" * len(heads)]
    for row in first.rows.values():
        own = [
            row.text,
            _target(row),
            _cell(row.key, row.figure),
            str(row.figure.n),
            f"**{row.verdict}**" if row.verdict else "",
        ]
        lines.append(_line([*own, *(_beside(row.key, one) for one in others)]))
    said = f"{first.cases} cases. {_EXPLAINED}"
    return "\n".join([*lines, "", said, "", *_failures(first)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _beside(key: str, other: Judged) -> str:
    return _cell(key, other.rows[key].figure) if key in COMPARED and key in other.rows else NOTHING


def _cell(key: str, figure: Figure) -> str:
    if figure.value is None:
        return NOTHING
    bounds = (
        ""
        if figure.lower is None or figure.upper is None
        else f" [{_number(key, figure.lower)}, {_number(key, figure.upper)}]"
    )
    return f"{_number(key, figure.value)}{_unit(key)}{bounds}"


def _target(row: Row) -> str:
    target = row.target
    if target is None:
        return ""
    scale = 1.0 if row.key in NUMBERS else 100.0
    least, most = (None if one is None else round(one * scale, 6) for one in (target.least, target.most))
    return f"{Target(least, most)}{_unit(row.key)}"


def _unit(key: str) -> str:
    return "" if key in NUMBERS else " %"


def _number(key: str, value: float) -> str:
    return f"{value:.2f}" if key in NUMBERS else f"{100 * value:.0f}"


def _failures(one: Judged) -> list[str]:
    """Say it as plainly as what goes well."""
    enough = {name: f for name, f in one.effects.items() if f.value is not None and f.n >= FEWEST}
    hardest = sorted(enough, key=lambda name: (enough[name].value, name))[:FAILURES]
    listed = (f"`{name}` {_cell(name, enough[name])} of {enough[name].n}" for name in hardest)
    lines = [f"Worst effects, right first: {'; '.join(listed)}."] if hardest else []
    for title, key in (
        ("Right first by d*", "magnitude"),
        ("Named and right by d*", "magnitude_named"),
        ("Right first by EMG noise, d* over 2", "noise"),
        ("Named and right by EMG noise, d* over 2", "noise_named"),
    ):
        parts = (
            f"{label(name)}: {100 * f.value:.0f} % of {f.n}"
            for name, f in one.curves[key].items()
            if f.value is not None
        )
        lines.append(f"{title}: {'; '.join(parts)}.")
    return ["  \n".join(lines)]


def label(key: str) -> str:
    """A curve's key as people read it: numbers that only sort are left out."""
    words = key.split(": ")[-1].replace(" to inf", " and more")
    return f"under {words[5:]}" if words.startswith("0 to ") else words.lstrip("0")
