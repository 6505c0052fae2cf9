"""Who leads when a known signal is added to people with nothing amiss, along straight lines.

``python -m validation.diagnosis.added_signals --bank BANK --lines LINES`` takes the people of a development bank that have no
effect, each once, and their straight lines (see `validation.diagnosis.linearizations`). To each one's residual it adds every
signal that the simulator knows of this person, in turn and as large as the null hypothesis leaves so many
standard deviations of it (``--sizes``), and scores all effects: how often the right one comes first, or among
three, what share of the signal (of its square) its signatures can form, its evidence, and who leads in its
place. Every effect is asked of every person, so that a change of one signature is seen in a minute. No
calibration gives way to what is added but along its straight lines: cases of a bank are harder.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg

from validation.blind.library import Library, library_of
from validation.diagnosis.linearizations import Lines, development_lines
from validation.diagnosis.signal_losses import captured_share, in_rows, white
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.projection import project
from wrapjax.diagnosis.score import score_each
from wrapjax.errors import InputError

#: A signal of which less is left, in standard deviations, would have to be of no human size.
_LEAST = 0.3


@dataclass(frozen=True)
class Added:
    """What a score says of one signal that was added.

    Parameters
    ----------
    cause, size
        Whose signal, and how many standard deviations of it the null hypothesis leaves.
    captured
        Share of its square that the effect's signatures can form.
    rank, evidence
        Of the cause among all effects, from 0, and in nats.
    leader
        Who is first.
    """

    cause: str
    size: float
    captured: float
    rank: int
    evidence: float
    leader: str


def main() -> int:
    options = _parser().parse_args()
    found: list[Added] = []
    asked: set[str] = set()
    try:
        for truth, lines in development_lines(options.bank, options.lines):
            if truth["tier"] == "none" and truth["person"] not in asked:
                asked.add(truth["person"])
                found += added(lines, library_of(options.bank, truth["person"]), options.sizes)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    if not found:
        print("nobody with nothing amiss has lines there", file=sys.stderr)
        return 2
    print("\n".join(told(found)))
    return 0


def added(lines: Lines, library: Library, sizes: Sequence[float]) -> list[Added]:
    """Add every signal that some effect of these lines is the cause of, in each size."""
    gap = lines.gap
    own = gap.residual.reshape(1, -1)
    every = list(nulls(gap, lines.sizes))
    best = max(every, key=lambda null: project(own, null, ()).weight[0])
    factor = scipy.linalg.cholesky(best.covariance, lower=True)
    known = {one.id: one for one in gap.candidates}
    residuals, of_which = [], []
    for (cause, _), signal in zip(library.entries, library.signals.T, strict=True):
        rows = in_rows(signal, gap)
        left = white(rows[None], factor)[:, 0]
        seen = float(np.linalg.norm(left))
        if cause not in known or seen < _LEAST:
            continue
        share = captured_share(left, known[cause], factor)
        for size in sizes:
            residuals.append(own[0] + size / seen * rows)
            of_which.append((cause, size, share))
    if not residuals:
        return []
    found = []
    for (cause, size, share), scored in zip(
        of_which, score_each(np.array(residuals), every, gap.candidates), strict=True
    ):
        evidence = {one.id: one.evidence for one in scored.scores}
        order = sorted(evidence, key=lambda id: -evidence[id])
        found.append(Added(cause, size, share, order.index(cause), evidence[cause], order[0]))
    return found


def told(found: Sequence[Added]) -> list[str]:
    """Give a line an effect and size, and means over effects, each alike however many signals it has."""
    lines = [
        f"{'':34s}{'size':>6s}{'signals':>9s}{'first':>7s}{'three':>7s}{'captured':>10s}{'nats':>7s}"
        "  leads in its place"
    ]
    sizes = sorted({one.size for one in found})
    means: dict[float, list[tuple[float, float]]] = {size: [] for size in sizes}
    for cause in sorted({one.cause for one in found}):
        for size in sizes:
            own = [one for one in found if (one.cause, one.size) == (cause, size)]
            first, three = (_share(one.rank < most for one in own) for most in (1, 3))
            means[size].append((first, three))
            captured, nats = (float(np.median([getattr(one, name) for one in own])) for name in _MEDIANS)
            others = Counter(one.leader for one in own if one.rank).most_common(3)
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
    parser = argparse.ArgumentParser(prog="python -m validation.diagnosis.added_signals", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    parser.add_argument("--sizes", type=float, nargs="+", default=[5.0, 8.0], help="standard deviations")
    return parser


if __name__ == "__main__":
    sys.exit(main())
