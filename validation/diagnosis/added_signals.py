"""Ranking of effects when a known signal is added to subjects without effect, in linearized models.

``python -m validation.diagnosis.added_signals --bank BANK --lines LINES`` takes the linearized models (see
`validation.diagnosis.linearizations`) of the persons of a development bank without effect, one case each. To
the residual it adds every signal of the simulator for this person in turn, scaled to a number of standard
deviations under the null hypothesis (``--sizes``), and scores all effects: how often the true effect is
ranked first or among the first three, the share of the squared signal that its signatures can form, its
evidence, and the effects that are ranked first instead. Calibrations compensate for the added signal only
within the linearized model, so the cases of a bank are harder.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from validation.blind.library import Library, library_of
from validation.diagnosis.linearizations import (
    LinearizedCase,
    development_linearizations,
    linearizations_parser,
)
from validation.diagnosis.signal_losses import captured_share, in_residual_order, standardize
from wrapjax.diagnosis.evidence.score_test import project, score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError

#: Least size of a signal, in standard deviations: smaller ones would need implausible effect sizes.
_SMALLEST = 0.3


@dataclass(frozen=True)
class AddedSignal:
    """Score of one added signal.

    Parameters
    ----------
    cause, size
        Effect of the signal, and its size in standard deviations under the null hypothesis.
    captured
        Share of the squared signal that the signatures of the effect can form.
    rank, evidence
        Rank of the effect among all, from 0, and its log Bayes factor, nats.
    first
        Effect that is ranked first.
    """

    cause: str
    size: float
    captured: float
    rank: int
    evidence: float
    first: str


def main() -> int:
    options = _parser().parse_args()
    found: list[AddedSignal] = []
    persons: set[str] = set()
    try:
        for truth, lines in development_linearizations(options.bank, options.lines):
            if truth["tier"] == "none" and truth["person"] not in persons:
                persons.add(truth["person"])
                found += add_signals(lines, library_of(options.bank, truth["person"]), options.sizes)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    if not found:
        print("no linearized models of cases without effect", file=sys.stderr)
        return 2
    print("\n".join(table_lines(found)))
    return 0


def add_signals(lines: LinearizedCase, library: Library, sizes: Sequence[float]) -> list[AddedSignal]:
    """Add the signal of every tested effect in each size, and score all effects."""
    linearized = lines.linearized
    own = linearized.residual.reshape(1, -1)
    every = list(nulls(linearized, lines.recorded.measured_moment_sd))
    best = max(every, key=lambda null: project(own, null, ()).weight[0])
    factor = scipy.linalg.cholesky(best.covariance, lower=True)
    known = {one.id: one for one in linearized.candidates}
    residuals, of_which = [], []
    for (cause, _), signal in zip(library.entries, library.signals.T, strict=True):
        rows = in_residual_order(signal, linearized)
        left = standardize(rows[None], factor)[:, 0]
        seen = float(np.linalg.norm(left))
        if cause not in known or seen < _SMALLEST:
            continue
        share = captured_share(left, known[cause], factor)
        for size in sizes:
            residuals.append(own[0] + size / seen * rows)
            of_which.append((cause, size, share))
    if not residuals:
        return []
    found = []
    for (cause, size, share), scored in zip(
        of_which, score_each(np.array(residuals), every, linearized.candidates), strict=True
    ):
        evidence = {one.id: one.evidence for one in scored.scores}
        order = sorted(evidence, key=lambda id: -evidence[id])
        found.append(AddedSignal(cause, size, share, order.index(cause), evidence[cause], order[0]))
    return found


def table_lines(found: Sequence[AddedSignal]) -> list[str]:
    """Format a line for each effect and size, and means with equal weight of all effects."""
    lines = [
        f"{'':34s}{'size':>6s}{'signals':>9s}{'first':>7s}{'three':>7s}{'captured':>10s}{'nats':>7s}"
        "  ranked first instead"
    ]
    sizes = sorted({one.size for one in found})
    means: dict[float, list[tuple[float, float]]] = {size: [] for size in sizes}
    for cause in sorted({one.cause for one in found}):
        for size in sizes:
            own = [one for one in found if (one.cause, one.size) == (cause, size)]
            first, three = (_share(one.rank < most for one in own) for most in (1, 3))
            means[size].append((first, three))
            captured, nats = (float(np.median([getattr(one, name) for one in own])) for name in _MEDIANS)
            others = Counter(one.first for one in own if one.rank).most_common(3)
            words = ", ".join(f"{name} {count}" for name, count in others)
            figures = f"{len(own):9d}{first:7.2f}{three:7.2f}{captured:10.2f}{nats:7.1f}"
            lines.append(f"{cause:34s}{size:6.1f}{figures}  {words}")
    for size in sizes:
        first, three = np.mean(means[size], axis=0)
        lines.append(f"{'mean of effects':34s}{size:6.1f}{'':9s}{first:7.2f}{three:7.2f}")
    return lines


_MEDIANS = ("captured", "evidence")


def _share(which: Iterable[bool]) -> float:
    return float(np.mean(list(which)))


def _parser() -> argparse.ArgumentParser:
    parser = linearizations_parser("added_signals", __doc__)
    parser.add_argument("--sizes", type=float, nargs="+", default=[5.0, 8.0], help="standard deviations")
    return parser


if __name__ == "__main__":
    sys.exit(main())
