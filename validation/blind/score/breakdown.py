"""Accuracy of an answerer by family, by EMG noise, by d* and by effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from validation.blind.effects import EFFECTS
from validation.blind.score.figures import cause_among_first, correctly_named, people
from validation.blind.score.intervals import Figure, share
from validation.blind.score.records import FAMILY_OUTCOME, STOPPED_OUTCOMES, UNNAMED_OUTCOMES, Case

#: Bin edges of d*.
EDGES = (0.0, 1.0, 2.0, 3.5, 5.0, 8.0, 12.0, np.inf)
#: Least number of cases for an effect to count as the worst.
FEWEST = 3


def confusion(cases: Sequence[Case]) -> dict[str, dict[str, int]]:
    """Count cases by the family of their cause (or tier) and by the named family or other outcome."""
    table: dict[str, dict[str, int]] = {}
    for case in cases:
        row = table.setdefault(case.truth.family, {})
        column = answered_family(case)
        row[column] = row.get(column, 0) + 1
    return {name: dict(sorted(row.items())) for name, row in sorted(table.items())}


def answered_family(case: Case) -> str:
    answer = case.answer
    if answer.outcome in (*UNNAMED_OUTCOMES, *STOPPED_OUTCOMES, FAMILY_OUTCOME):
        return f"({answer.outcome})"
    named = answer.named
    if correctly_named(case):
        return case.truth.family
    families = {EFFECTS[name].family for name in named if name in EFFECTS}
    return families.pop() if len(families) == 1 else "(several)"


def curve(
    cases: Sequence[Case], key: Callable[[Case], str], hit: Callable[[Case], bool] = cause_among_first
) -> dict[str, Figure]:
    """Compute the share of hits by a key."""
    groups: dict[str, list[Case]] = {}
    for case in cases:
        groups.setdefault(key(case), []).append(case)
    return {
        name: share(np.array([hit(c) for c in some]), people(some)) for name, some in sorted(groups.items())
    }


def over_magnitude(
    cases: Sequence[Case], hit: Callable[[Case], bool] = cause_among_first
) -> dict[str, Figure]:
    def key(case: Case) -> str:
        index = int(np.searchsorted(EDGES, case.truth.d_star, side="right")) - 1
        return f"{index}: {EDGES[index]:g} to {EDGES[index + 1]:g}"

    return curve(cases, key, hit)


def over_noise(cases: Sequence[Case], hit: Callable[[Case], bool] = cause_among_first) -> dict[str, Figure]:
    return curve(cases, lambda case: f"{100 * case.truth.raw['emg_noise']:02.0f} %", hit)


def by_effect(cases: Sequence[Case]) -> dict[str, Figure]:
    return curve(cases, lambda case: case.truth.causes[0])


def worst(figures: dict[str, Figure]) -> tuple[str, Figure] | None:
    enough = {name: f for name, f in figures.items() if f.n >= FEWEST and f.value is not None}
    if not enough:
        return None
    name = min(enough, key=lambda key: (enough[key].value, key))
    return name, enough[name]
