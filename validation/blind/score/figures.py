"""Definitions, cases and targets of all figures that a diagnosis is scored by."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from validation.blind.score.intervals import Figure, Target, share, statistic, verdict
from validation.blind.score.moments import map_pairs, oracle_shrinkage, r_squared, shrinkage_estimate
from validation.blind.score.records import FAMILY_OUTCOME, Case

# Tables are easier to read in one line.
# ruff: noqa: E501


#: d* above which a cause can be identified, and above which it should be easy.
CLEAR, PLAIN = 2.0, 5.0
BINS = 10
#: Relative error assumed for a scored parameter that an answer does not state.
UNSTATED = 10.0


@dataclass(frozen=True)
class Row:
    """Figure with its key, text and target."""

    key: str
    text: str
    figure: Figure
    target: Target | None = None

    @property
    def verdict(self) -> str:
        return verdict(self.figure, self.target)


#: Targets of the rows on names in this simulator's banks.
NAMING_TARGETS: Mapping[str, Target] = MappingProxyType(
    {
        "first_clear": Target(least=0.70),
        "first_plain": Target(least=0.92),
        "three_clear": Target(least=0.85),
        "three_plain": Target(least=0.97),
        "coverage": Target(least=0.60),
        "precision": Target(least=0.90),
        "false_alarms": Target(most=0.05),
        "false_unknown": Target(most=0.15),
        "wrong_outside": Target(most=0.10),
        "withheld": Target(least=0.85),
        "set_coverage": Target(least=0.90),
        "set_size": Target(most=2.0),
        "calibration": Target(most=0.03),
        "unknown_auroc": Target(least=0.88),
        "pair_both": Target(least=0.70),
    }
)


def cause_among_first(case: Case, among: int = 1) -> bool:
    """Check whether the cause, or an effect tied with it, is among the most probable."""
    return any(name in case.truth.accepted for name in case.answer.ranking[:among])


def exact_cause_first(case: Case) -> bool:
    return case.answer.ranking[:1] == [case.truth.causes[0]]


def correctly_named(case: Case) -> bool:
    """Check whether all named effects are the cause or tied with it."""
    return case.answer.names and bool(case.answer.named) and case.answer.named <= case.truth.accepted


def cause_or_family_named(case: Case) -> bool:
    """Check whether the cause is named, or else its family."""
    family = (case.answer.raw.get("family") or {}).get("id")
    of_family = case.answer.outcome == FAMILY_OUTCOME and family == case.truth.family
    return correctly_named(case) or of_family


def exactly_named(case: Case) -> bool:
    return case.answer.named == frozenset(case.truth.causes)


def wrongly_named_when_withheld(case: Case) -> bool:
    """Check whether an effect that is not tied with the cause is named when the cause is withheld."""
    answer = case.withheld
    assert answer is not None
    return answer.names and not (answer.named and answer.named <= case.truth.ties)


def top_is_right(case: Case) -> bool:
    name, _ = case.answer.top
    right = {"none": {"none"}, "outside": {"unknown"}}.get(case.truth.tier, case.truth.accepted)
    return name in right


def calibration_error(values: np.ndarray) -> float:
    """Compute the expected calibration error over equal-count bins, minus that of perfect calibration.

    ``values`` are (case, 2): stated probability, and whether the answer is correct.
    """
    p, right = values[np.argsort(values[:, 0], kind="stable")].T
    bins = np.array_split(np.arange(p.size), min(BINS, p.size))
    means = np.array([p[b].mean() for b in bins])
    weight = np.array([b.size for b in bins]) / p.size

    def error(hits: np.ndarray) -> np.ndarray:
        rates = np.stack([hits[..., b].mean(-1) for b in bins], axis=-1)
        return np.abs(rates - means) @ weight

    draws = np.random.default_rng(2).random((200, p.size)) < p
    return float(error(right) - error(draws.astype(float)).mean())


def auroc(values: np.ndarray) -> float:
    """Compute the area under the ROC curve; values are (case, 2): score, positive or not."""
    high, low = values[values[:, 1] > 0.5, 0], values[values[:, 1] < 0.5, 0]
    if not high.size or not low.size:
        return float("nan")
    return float(np.mean((high[:, None] > low) + 0.5 * (high[:, None] == low)))


def all_rows(bank: Path, cases: Sequence[Case]) -> list[Row]:
    """Compute all rows of the table in their order."""
    single = [c for c in cases if c.truth.tier == "single"]
    clear = [c for c in single if c.truth.d_star > CLEAR]
    return [*naming_rows(cases), *_shrinkage(bank, single), _parameters(clear), _map(clear)]


def naming_rows(cases: Sequence[Case], targets: Mapping[str, Target] = NAMING_TARGETS) -> list[Row]:
    """Compute the rows on ranks, names, families, credible sets and probabilities, with targets by key."""
    by_tier = {
        tier: [c for c in cases if c.truth.tier == tier] for tier in ("single", "none", "outside", "pair")
    }
    single = by_tier["single"]
    clear = [c for c in single if c.truth.d_star > CLEAR]
    plain = [c for c in single if c.truth.d_star > PLAIN]
    named = [c for c in single if c.answer.names]
    held = [c for c in single if c.withheld is not None]
    three = lambda c: cause_among_first(c, 3)  # noqa: E731
    names = lambda c: c.answer.names  # noqa: E731
    rows = [
        _share("first_clear", "right cause first, d* over 2", clear, cause_among_first),
        _share("first_plain", "right cause first, d* over 5", plain, cause_among_first),
        _share("first_all", "right cause first, all", single, cause_among_first),
        _share("first_strict", "the very cause first, ties not counted, d* over 2", clear, exact_cause_first),
        _share("three_clear", "right cause among three, d* over 2", clear, three),
        _share("three_plain", "right cause among three, d* over 5", plain, three),
        _share("three_all", "right cause among three, all", single, three),
        _share("coverage", "a cause is named, d* over 2", clear, names),
        _share("right_or_family", "cause or family named and right, d* over 2", clear, cause_or_family_named),
        _share("precision", "a named cause is right, all", named, correctly_named),
        _share("precision_strict", "a named cause is the very cause, d* over 2", [c for c in clear if c.answer.names], exactly_named),
        _share("false_alarms", "a cause is named where there is none", by_tier["none"], names),
        _share("false_unknown", "'unknown' where there is none", by_tier["none"], lambda c: c.answer.outcome == "unknown"),
        _share("wrong_outside", "a cause is named for a mechanism outside", by_tier["outside"], names),
        _share("withheld", "no wrong name with the cause withheld", held, lambda c: not wrongly_named_when_withheld(c)),
        _share("set_coverage", "credible set holds the cause, all", single, _set_holds),
        _value("set_size", "ids in the credible set, mean, d* over 2", clear, lambda c: [len(c.answer.raw.get("credible_set") or [])], np.mean),
        _calibration([*single, *by_tier["none"], *by_tier["outside"]]),
        _unknowns(by_tier),
        _share("pair_one", "pairs: a member first", by_tier["pair"], lambda c: bool(set(c.answer.ranking[:1]) & set(c.truth.causes))),
        _share("pair_both", "pairs: both among three", by_tier["pair"], lambda c: set(c.truth.causes) <= set(c.answer.ranking[:3])),
        _share("stopped", "no diagnosis (not converged, too few data)", list(cases), lambda c: c.answer.outcome in ("not_converged", "insufficient_data")),
    ]  # fmt: skip
    return [replace(row, target=targets.get(row.key)) for row in rows]


def people(cases: Sequence[Case]) -> np.ndarray:
    return np.array([c.truth.person for c in cases])


def _share(
    key: str, text: str, cases: Sequence[Case], hit: Callable[[Case], bool], target: Target | None = None
) -> Row:
    return Row(key, text, share(np.array([hit(c) for c in cases]), people(cases)), target)


def _value(key, text, cases, values: Callable[[Case], Sequence[float]], of, target=None) -> Row:
    rows = [(value, c.truth.person) for c in cases for value in values(c)]
    figure = statistic(np.array([v for v, _ in rows]), np.array([p for _, p in rows]), of)
    return Row(key, text, figure, target)


def _set_holds(case: Case) -> bool:
    return case.truth.causes[0] in (case.answer.raw.get("credible_set") or [])


def _calibration(cases: Sequence[Case]) -> Row:
    values = np.array([[c.answer.top[1], top_is_right(c)] for c in cases], float).reshape(-1, 2)
    figure = statistic(values, people(cases), calibration_error)
    return Row("calibration", "calibration error of the likeliest, less chance", figure)


def _shrinkage(bank: Path, cases: Sequence[Case]) -> list[Row]:
    away, covered, who = [], [], []
    for case in cases:
        for which in ("held_out_cycles", "held_out_speed"):
            stated = shrinkage_estimate((case.answer.raw.get("shrinkage") or {}).get(which))
            true = oracle_shrinkage(bank, case, which) if stated else None
            if stated and true is not None:
                away.append(abs(stated[0] - true))
                covered.append(stated[1][0] <= true <= stated[1][1])
                who.append(case.truth.person)
    figure = statistic(np.array(away), np.array(who), np.median)
    text = "shrinkage, away from the oracle's, median"
    return [
        Row("shrinkage", text, figure, Target(most=0.07)),
        Row("shrinkage_intervals", "intervals of shrinkage that hold the oracle's", share(np.array(covered), np.array(who)), Target(0.85, 0.95)),
    ]  # fmt: skip


def _parameters(cases: Sequence[Case]) -> Row:
    def errors(case: Case) -> list[float]:
        (cause,) = case.truth.raw["causes"]
        if not correctly_named(case) or cause["id"] not in case.answer.named:
            return []
        stated = case.answer.parameters(cause["id"])
        return [
            abs(float(stated[name]["value"]) - true) / max(abs(true), 1e-12) if name in stated else UNSTATED
            for name, true in cause["parameters"].items()
        ]

    text = "scored parameters, relative error where named, median, d* over 2"
    return _value("parameters", text, cases, errors, np.median, Target(most=0.15))


def _map(cases: Sequence[Case]) -> Row:
    pairs = [(pair, c.truth.person) for c in cases for pair in map_pairs(c)]
    values = np.array([pair for pair, _ in pairs]).reshape(-1, 2)
    figure = statistic(values, np.array([p for _, p in pairs]), r_squared)
    return Row("map", "map of the explainable gap against truth, R2, d* over 2", figure, Target(least=0.9))


def _unknowns(by_tier: dict[str, list[Case]]) -> Row:
    both = [*by_tier["outside"], *by_tier["single"]]
    values = np.array(
        [[c.answer.probabilities.get("unknown", 0.0), c.truth.tier == "outside"] for c in both], float
    ).reshape(-1, 2)
    figure = statistic(values, people(both), auroc)
    return Row("unknown_auroc", "'unknown' tells outside from single, AUROC", figure)
