"""Ranking of effects that is learned from the evidence of all effects, judged in worlds that were left out.

``python -m validation.diagnosis.learned_ranking --bank BANK --lines LINES`` makes labelled residuals from the
linearized cases without a cause of a development bank: to each it adds one signal of every simulated effect,
at a d* between 2 and 15, and scores all effects (as `validation.diagnosis.added_signals`, but in units of the
simulator's detectability). A logistic regression then learns the cause from the evidence and the
detectability of all effects, in every world but one, and ranks the effects of that world.

With ``--judge BANK ANSWERS``, one or several times, the regression that was fitted on all worlds also ranks
the single causes of banks of the independent simulator, from the evidence in their answers. This opens them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from validation.blind.effects import EFFECTS
from validation.blind.library import SHARE, Library, library_of
from validation.diagnosis.bank_cases import CLEAR
from validation.diagnosis.judge_table import judged_cases
from validation.diagnosis.linearizations import (
    LinearizedCase,
    development_linearizations,
    linearizations_parser,
)
from validation.diagnosis.signal_losses import in_residual_order
from wrapjax.diagnosis.evidence.score_test import score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError

#: Smallest and largest d* of added signals, between which its logarithm is uniform.
SIZES = (CLEAR, 15.0)
#: d* above which an ideal observer ranks the cause first.
PLAIN = 5.0
# Signals of each effect that are added to a case.
_REPEATED = 3
# Inverse strength of the regression's prior.
_STRENGTH = 0.03


@dataclass(frozen=True)
class Example:
    """Evidence (nats) and detectability of all effects in a residual with one known cause."""

    world: str
    cause: str
    d_star: float
    evidence: Mapping[str, float]
    detectability: Mapping[str, float]

    @property
    def ranked(self) -> list[str]:
        """Effects by decreasing evidence."""
        return sorted(self.evidence, key=lambda id: -self.evidence[id])


class LearnedRanking:
    """Logistic regression from the evidence and detectability of all effects to the cause."""

    def __init__(self, examples: Sequence[Example]) -> None:
        from sklearn.linear_model import LogisticRegression

        self.ids = sorted({id for one in examples for id in one.evidence})
        features = np.array([self._features(one) for one in examples])
        self.model = LogisticRegression(C=_STRENGTH, max_iter=300)
        self.model.fit(features, [one.cause for one in examples])

    def ranked(self, example: Example) -> list[str]:
        """Effects that were scored, by decreasing probability."""
        shares = dict(
            zip(
                self.model.classes_,
                self.model.predict_proba(self._features(example)[None])[0],
                strict=True,
            )
        )
        return sorted(example.evidence, key=lambda id: -shares.get(id, 0.0))

    def _features(self, example: Example) -> Float[np.ndarray, " feature"]:
        # An effect that was not scored says nothing.
        evidence = np.array([example.evidence.get(id, 0.0) for id in self.ids])
        seen = np.array([example.detectability.get(id, 0.0) for id in self.ids])
        compressed = np.sign(evidence) * np.log1p(np.abs(evidence))
        return np.concatenate([np.clip(evidence, -4.0, 12.0) / 3.0, compressed, np.log1p(seen)])


def labelled(
    world: str, lines: LinearizedCase, library: Library, generator: np.random.Generator
) -> list[Example]:
    """Add one signal of every effect of a person to the residual of a case without a cause, and score all."""
    linearized = lines.linearized
    own = linearized.residual.ravel()
    residuals, causes = [], []
    for cause in sorted({name for name, _ in library.entries}):
        place = generator.choice(library.of(cause))
        reach = float(library.reach[:, place].mean())
        d_star = min(float(np.exp(generator.uniform(*np.log(SIZES)))), reach)
        sign = -1.0 if EFFECTS[cause].two_sided and generator.random() < 0.5 else 1.0
        if d_star < SIZES[0]:
            continue
        signal = in_residual_order(library.signals[:, place], linearized)
        # The library has signals at a share of the largest amount, and the d* of the largest amount.
        residuals.append(own + sign * d_star / (reach * SHARE) * signal)
        causes.append((cause, d_star))
    if not residuals:
        return []
    tests = score_each(
        np.array(residuals), nulls(linearized, lines.recorded.measured_moment_sd), linearized.candidates
    )
    return [
        Example(
            world,
            cause,
            d_star,
            {one.id: one.evidence for one in test.scores},
            {one.id: one.detectability for one in test.scores},
        )
        for (cause, d_star), test in zip(causes, tests, strict=True)
    ]


def learned_elsewhere(examples: Sequence[Example]) -> list[tuple[Example, list[str]]]:
    """Rank the effects of every example by a regression fitted on the other worlds."""
    ranked = []
    for world in sorted({one.world for one in examples}):
        regression = LearnedRanking([one for one in examples if one.world != world])
        ranked += [(one, regression.ranked(one)) for one in examples if one.world == world]
    return ranked


def row(title: str, ranked: Sequence[tuple[Example, list[str]]]) -> str:
    """Format how often the cause is first and among three, by size."""
    figures = []
    for low, high in ((CLEAR, PLAIN), (PLAIN, np.inf)):
        own = [
            order.index(one.cause) if one.cause in order else np.inf
            for one, order in ranked
            if low <= one.d_star < high
        ]
        first, three = sum(place == 0 for place in own), sum(place < 3 for place in own)
        figures += [f"{first} of {len(own)}", f"{three} of {len(own)}"]
    return f"| {title} | {' | '.join(figures)} |"


def judge_examples(bank: Path, answers: Path) -> list[Example]:
    """Read the single causes of a bank of the independent simulator, with the evidence of their answers."""
    return [
        Example(
            "judge",
            case.truth.causes[0],
            case.truth.d_star,
            _by_effect(case.answer.raw, "evidence_nats"),
            _by_effect(case.answer.raw, "detectability"),
        )
        for case in judged_cases(bank, answers)
        if case.truth.tier == "single" and case.truth.d_star > CLEAR
    ]


def _by_effect(answer: Mapping[str, Any], key: str) -> dict[str, float]:
    return {one["id"]: one[key] for one in answer["effects"] if one[key] is not None}


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    generator = np.random.default_rng(0)
    examples: list[Example] = []
    try:
        for truth, lines in development_linearizations(options.bank, options.lines):
            if truth["tier"] == "none":
                library = library_of(options.bank, truth["person"])
                for _ in range(_REPEATED):
                    examples += labelled(truth["world"], lines, library, generator)
        judged = [one for bank, answers in options.judge for one in judge_examples(bank, answers)]
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    if len({one.world for one in examples}) < 2:
        print("expected linearized cases without a cause in two worlds at least", file=sys.stderr)
        return 2
    print("| ranked by | first, d* 2 to 5 | first three | first, d* above 5 | first three |")
    print("|---|---|---|---|---|")
    print(row("evidence, worlds", [(one, one.ranked) for one in examples]))
    print(row("regression fitted on the other worlds", learned_elsewhere(examples)))
    if judged:
        regression = LearnedRanking(examples)
        print(row("evidence, independent simulator", [(one, one.ranked) for one in judged]))
        print(row("regression fitted on all worlds", [(one, regression.ranked(one)) for one in judged]))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = linearizations_parser("learned_ranking", __doc__)
    parser.add_argument(
        "--judge",
        nargs=2,
        type=Path,
        action="append",
        default=[],
        metavar=("BANK", "ANSWERS"),
        help="bank of the independent simulator, and its answers",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
