"""Who would lead if every effect's shape were known: the score, with the simulator's signatures for ours.

``python -m validation.diagnosis.simulator_signatures --bank BANK --lines LINES`` takes a development bank and its straight lines
(see `validation.diagnosis.linearizations`) and scores every case twice: with the catalogue's signatures, and with those that the
simulator itself has of this person, at its true parameters. The null hypothesis stays. What the second ranks
no better does not hang on the shapes of the catalogue; evidence where nothing is amiss shows along which
directions the plain model differs from the simulated people as a whole.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.library import Library, library_of
from validation.diagnosis.linearizations import Lines, development_lines
from validation.diagnosis.scored_cases import Scored, ranking
from validation.diagnosis.signal_losses import in_rows
from wrapjax.diagnosis.linearization import LinearizedModel
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.projection import Candidate
from wrapjax.diagnosis.score import score_each
from wrapjax.errors import InputError

#: So many effects are listed that have most evidence where nothing is amiss.
_LISTED = 6


def main() -> int:
    options = _parser().parse_args()
    ours: list[Scored] = []
    theirs: list[Scored] = []
    try:
        for truth, lines in development_lines(options.bank, options.lines):
            by_ours, by_theirs = both(truth, lines, library_of(options.bank, truth["person"]))
            ours.append(by_ours)
            theirs.append(by_theirs)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    for whose, found in (("the catalogue's", ours), ("the simulator's", theirs)):
        print("\n".join([f"{whose} signatures: {ranking(found)}", *usual(found)]))
    return 0


def both(truth: dict[str, Any], lines: Lines, library: Library) -> tuple[Scored, Scored]:
    """Score a case with the catalogue's signatures, then with the simulator's."""
    gap = lines.gap
    candidates = (*gap.candidates, *borrowed(gap, library))
    (found,) = score_each(gap.residual.reshape(1, -1), nulls(gap, lines.sizes), candidates)
    # Under the same ids, so that they are told apart by their places.
    evidence = [(one.id, one.evidence) for one in found.scores]
    own = len(gap.candidates)
    return (
        Scored(truth, dict(evidence[:own]), found.structured),
        Scored(truth, dict(evidence[own:]), found.structured),
    )


def borrowed(gap: LinearizedModel, library: Library) -> tuple[Candidate, ...]:
    """Make candidates of all that the simulator knows; a shape for each muscle or joint it can be about."""
    # Of either sign: the library holds each at one amount, which is as large as it is plausible.
    shapes: dict[str, list[Any]] = {}
    for (id, _), signal in zip(library.entries, library.signals.T, strict=True):
        shapes.setdefault(id, []).append(in_rows(signal, gap)[None])
    return tuple(Candidate(id, tuple(own), np.array([1.0]), np.array([False])) for id, own in shapes.items())


def usual(cases: Sequence[Scored]) -> list[str]:
    """List the effects with most evidence in the median of the cases without any."""
    nothing = [one.evidence for one in cases if one.truth["tier"] == "none"]
    if not nothing:
        return []
    medians = {id: float(np.median([own[id] for own in nothing if id in own])) for id in nothing[0]}
    largest = float(np.median([max(own.values()) for own in nothing]))
    listed = sorted(medians, key=lambda id: -medians[id])[:_LISTED]
    words = ", ".join(f"{id} {medians[id]:.1f}" for id in listed)
    return [f"  where nothing is amiss: strongest {largest:.1f} nats in the median; by effect {words}"]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.simulator_signatures", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    return parser


if __name__ == "__main__":
    sys.exit(main())
