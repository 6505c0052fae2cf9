"""Decisions on the cases of each development world, with constants that were fitted on the other worlds.

``python -m validation.diagnosis.left_out_worlds --bank BANK --lines LINES`` reads the linearized models of
the bank `worlds` (see `validation.diagnosis.linearizations`), fits the constants of the decision on all
worlds but one, decides on the cases of that one, and prints ranks, names and families by world and over all.
Decisions are those of a diagnosis up to its refits: effects that do not improve held-out cycles are not
removed, several effects are not named together, and the gates are those of linearised fits.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from validation.blind.score.figures import calibration_error
from validation.diagnosis.linearizations import linearizations_parser
from validation.diagnosis.scored_cases import (
    GROSS_MISFIT,
    OUTCOMES,
    ScoredCase,
    decision_on,
    score_cases,
)
from validation.diagnosis.temperature_scaling import fit_constants
from wrapjax.diagnosis.claims.decision import (
    Decision,
    DecisionConstants,
    Probabilities,
    credible_families,
    credible_set,
)
from wrapjax.diagnosis.claims.gates import Gates
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, family_of
from wrapjax.errors import InputError


@dataclass(frozen=True)
class DecidedCase:
    """Scored case, and the decision on it by constants from other worlds."""

    case: ScoredCase
    decision: Decision
    set_level: float = 1.0
    family_level: float = 1.0

    @property
    def probabilities(self) -> Probabilities:
        """Probabilities of the decision."""
        assert self.decision.probabilities is not None
        return self.decision.probabilities

    @property
    def covered(self) -> bool | None:
        """Whether the credible set has the correct answer; None where no single answer is correct."""
        level = self.case.set_level(self.probabilities)
        return None if level is None else level < self.set_level

    @property
    def families_covered(self) -> bool | None:
        """Whether the credible set of families has the correct one; None where no single one is correct."""
        level = self.case.family_level(self.probabilities)
        return None if level is None else level < self.family_level

    @property
    def families(self) -> int:
        """Number of members of the credible set of families."""
        return len(credible_families(self.probabilities, self.family_level))

    @property
    def set_size(self) -> int:
        """Number of members of the credible set."""
        tie = () if self.case.claim is None else self.case.claim.tie
        return len(credible_set(self.probabilities, tie, self.set_level))

    @property
    def most_probable(self) -> tuple[str, float, bool]:
        """Most probable answer, its probability, and whether it is correct."""
        stated = self.probabilities
        answers = {**stated.effects, "none": stated.none, "unknown": stated.unknown}
        first = max(answers, key=lambda id: answers[id])
        correct = OUTCOMES.get(self.case.truth["tier"])
        return first, answers[first], first in self.case.accepted if correct is None else first == correct

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that are named or tied."""
        return self.decision.accepted

    @property
    def right(self) -> bool:
        """Whether an effect that is correct is named, or in the tie."""
        return bool(set(self.named) & self.case.accepted)

    @property
    def right_family(self) -> bool:
        """Whether the family of the cause is named."""
        causes = {family_of(cause["id"]) for cause in self.case.truth["causes"] if cause["id"] in CATALOGUE}
        return self.decision.family in causes


def main() -> int:
    parser = linearizations_parser("left_out_worlds", __doc__)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    try:
        cases = score_cases(options.bank, options.lines, options.workers)
        decided = decide_by_world(cases, DecisionConstants.shipped())
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(table(decided), ablations(cases, decided), sep="\n\n")
    return 0


def decide_by_world(
    cases: Sequence[ScoredCase],
    start: DecisionConstants,
    *,
    ignored: Sequence[str] = (),
    from_one_world: bool = False,
) -> dict[str, list[DecidedCase]]:
    """Decide on the cases of each world by constants that were fitted on the others.

    Parameters
    ----------
    cases
        Scored cases of at least two worlds.
    start
        Initial values of the constants.
    ignored
        Names of gates that every claim passes.
    from_one_world
        Whether the constants are those of the next world alone that has cases with nothing amiss.

    Raises
    ------
    InputError
        If no other world has a case with nothing amiss.
    """
    decided: dict[str, list[DecidedCase]] = {}
    worlds = list(dict.fromkeys(one.truth["world"] for one in cases))
    quiet = {one.truth["world"] for one in cases if one.nothing_amiss and one.truth["world"] != GROSS_MISFIT}
    for place, world in enumerate(worlds):
        fitted_on = [
            one for one in worlds[place + 1 :] + worlds[:place] if one in quiet or not from_one_world
        ]
        if from_one_world:
            fitted_on = fitted_on[:1]
        constants = fit_constants([one for one in cases if one.truth["world"] in fitted_on], start)
        decided[world] = [
            DecidedCase(
                one, decision_on(one, constants, ignored), constants.set_level, constants.family_level
            )
            for one in cases
            if one.truth["world"] == world
        ]
    return decided


def ablations(cases: Sequence[ScoredCase], complete: dict[str, list[DecidedCase]]) -> str:
    """Describe the decisions over all worlds but the one with gross misfit, without one part after the other.

    Parameters
    ----------
    cases
        Scored cases.
    complete
        Decisions with all parts.
    """
    gates = tuple(field.name for field in fields(Gates))
    start = DecisionConstants.shipped()
    variants = {
        "complete": complete,
        **{f"without the gate {name}": decide_by_world(cases, start, ignored=[name]) for name in gates},
        "without gates": decide_by_world(cases, start, ignored=gates),
        "constants from one world": decide_by_world(cases, start, from_one_world=True),
    }
    return _format({name: _pooled(decided) for name, decided in variants.items()}, "decision")


def table(decided: dict[str, list[DecidedCase]]) -> str:
    """Describe ranks, names and families by world and over all worlds but the one with gross misfit."""
    return _format({**decided, f"all but {GROSS_MISFIT}": _pooled(decided)}, "world")


def _pooled(decided: dict[str, list[DecidedCase]]) -> list[DecidedCase]:
    return [one for world, cases in decided.items() if world != GROSS_MISFIT for one in cases]


def _format(rows: dict[str, list[DecidedCase]], what: str) -> str:
    columns = (
        *(what, "first, d* 2 to 5", "first, d* above 5", "first three", "named right, of named"),
        *("in the tie, of ties", "named, tie or family right", "named, nothing amiss", "named, background"),
        *("named, outside", "family named wrongly", "90 % sets cover", "mean size"),
        *("90 % sets of families cover", "mean size", "calibration error"),
    )
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    lines += [f"| {world} | {' | '.join(_row(cases))} |" for world, cases in rows.items()]
    return "\n".join(lines)


def _row(cases: Sequence[DecidedCase]) -> list[str]:
    clear = [one for one in cases if one.case.clear]
    single = [one for one in cases if one.case.truth["tier"] == "single"]
    strong = [one for one in clear if one.case.truth["d_star"] > 5.0]
    weak = [one for one in clear if one not in strong]
    quiet = [one for one in cases if one.case.nothing_amiss]
    background = [one for one in cases if one.case.truth["tier"] == "none" and not one.case.nothing_amiss]
    outside = [one for one in cases if one.case.truth["tier"] == "outside"]
    family = [one for one in single if one.decision.family]

    answered = [one for one in cases if one.covered is not None]
    by_family = [one for one in cases if one.families_covered is not None]

    def share(some: Sequence[DecidedCase], holds: Callable[[DecidedCase], bool]) -> str:
        return f"{sum(map(holds, some))} of {len(some)}"

    def first(count: int) -> Callable[[DecidedCase], bool]:
        return lambda one: bool(set(one.case.ranked[:count]) & one.case.accepted)

    return [
        share(weak, first(1)),
        share(strong, first(1)),
        share(clear, first(3)),
        share([one for one in single if one.decision.named], lambda one: one.right),
        share([one for one in single if one.decision.tie], lambda one: one.right),
        share(clear, lambda one: one.right or one.right_family),
        share(quiet, lambda one: bool(one.named or one.decision.family)),
        share(background, lambda one: bool(one.named or one.decision.family)),
        share(outside, lambda one: bool(one.named)),
        share(family, lambda one: not one.right_family),
        share(answered, lambda one: bool(one.covered)),
        f"{np.mean([one.set_size for one in answered]):.1f}" if answered else "-",
        share(by_family, lambda one: bool(one.families_covered)),
        f"{np.mean([one.families for one in by_family]):.1f}" if by_family else "-",
        f"{calibration_error(np.array([one.most_probable[1:] for one in answered], float)):.2f}"
        if answered
        else "-",
    ]


if __name__ == "__main__":
    sys.exit(main())
