"""Markdown table of figures with targets and verdicts for one answerer, compared with others."""

from __future__ import annotations

from collections.abc import Sequence

from validation.blind.publish.scores import PublishedScore
from validation.blind.score.breakdown import FEWEST
from validation.blind.score.figures import Row
from validation.blind.score.intervals import Figure, Target

#: Figures that are not shares.
NUMBERS = {"set_size", "calibration", "shrinkage", "map", "unknown_auroc"}
#: Figures that can be compared with answerers without probabilities and refits.
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
#: Number of worst effects listed.
FAILURES = 5
NO_VALUE = "-"

_EXPLAINED = (
    "Bounds in brackets are one-sided, 95 % each, with cases clustered by person. A target is met or failed "
    "where both bounds are on one side of it, else the bank cannot tell (not distinguishable)."
)


def as_table(scores: Sequence[PublishedScore]) -> str:
    """Format the table: the first answerer with targets and verdicts, the others where comparable."""
    first, *others = scores
    heads = ["figure", "target", first.title, "cases", "verdict", *(one.title for one in others)]
    lines = [_line(heads), "|" + "---|" * len(heads)]
    for row in first.rows.values():
        cells = [
            row.text,
            _target(row),
            _cell(row.key, row.figure),
            str(row.figure.n),
            f"**{row.verdict}**" if row.verdict else "",
        ]
        lines.append(_line([*cells, *(_compared_cell(row.key, one) for one in others)]))
    said = f"{first.cases} cases. {_EXPLAINED}"
    return "\n".join([*lines, "", said, "", *_failures(first)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _compared_cell(key: str, other: PublishedScore) -> str:
    return _cell(key, other.rows[key].figure) if key in COMPARED and key in other.rows else NO_VALUE


def _cell(key: str, figure: Figure) -> str:
    if figure.value is None:
        return NO_VALUE
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


def _failures(one: PublishedScore) -> list[str]:
    """List the worst effects, and the shares of correct answers by d* and EMG noise."""
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
    """Return the label of a curve's key without the number that only serves sorting."""
    words = key.split(": ")[-1].replace(" to inf", " and more")
    return f"under {words[5:]}" if words.startswith("0 to ") else words.lstrip("0")
