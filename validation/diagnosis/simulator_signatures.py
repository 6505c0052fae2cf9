"""Ranking of effects with the simulator's own signatures in place of those of the catalogue.

``python -m validation.diagnosis.simulator_signatures --bank BANK --lines LINES`` reads the linearized models
of a development bank (see `validation.diagnosis.linearizations`) and scores every case twice under the same
null hypothesis: with the signatures of the catalogue, and with those of the simulator for this person at its
true parameters. If the second ranking is no better, the shapes of the catalogue are not the reason; the
evidence in cases without effect shows the directions in which the plain model differs from all simulated
persons.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from validation.blind.library import Library, library_of
from validation.diagnosis.linearizations import (
    LinearizedCase,
    development_linearizations,
    linearizations_parser,
)
from validation.diagnosis.scored_cases import ScoredCase, ranking
from validation.diagnosis.signal_losses import in_residual_order
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import score_each
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError

#: Number of effects listed, those with most evidence in cases without effect.
_LISTED = 6


def main() -> int:
    options = linearizations_parser("simulator_signatures", __doc__).parse_args()
    catalogue: list[ScoredCase] = []
    simulator: list[ScoredCase] = []
    try:
        for truth, lines in development_linearizations(options.bank, options.lines):
            by_catalogue, by_simulator = score_both(truth, lines, library_of(options.bank, truth["person"]))
            catalogue.append(by_catalogue)
            simulator.append(by_simulator)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    for source, cases in (("the catalogue's", catalogue), ("the simulator's", simulator)):
        print("\n".join([f"{source} signatures: {ranking(cases)}", *null_evidence(cases)]))
    return 0


def score_both(
    truth: dict[str, Any], lines: LinearizedCase, library: Library
) -> tuple[ScoredCase, ScoredCase]:
    """Score a case with the catalogue's signatures, then with the simulator's."""
    linearized = lines.linearized
    candidates = (*linearized.candidates, *simulator_candidates(linearized, library))
    (scored,) = score_each(
        linearized.residual.reshape(1, -1), nulls(linearized, lines.recorded.measured_moment_sd), candidates
    )
    # Both have the same ids, so they are distinguished by their order.
    evidence = [(one.id, one.evidence) for one in scored.scores]
    count = len(linearized.candidates)
    return (
        ScoredCase(truth, dict(evidence[:count])),
        ScoredCase(truth, dict(evidence[count:])),
    )


def simulator_candidates(linearized: LinearizedModel, library: Library) -> tuple[Candidate, ...]:
    """Build candidates from the signatures of the simulator, with a variant for each muscle or joint."""
    # Without sign constraint: the library has each signature at one plausible amount.
    shapes: dict[str, list[Any]] = {}
    for (id, _), signal in zip(library.entries, library.signals.T, strict=True):
        shapes.setdefault(id, []).append(in_residual_order(signal, linearized)[None])
    return tuple(
        Candidate(id, tuple(variants), np.array([1.0]), np.array([False])) for id, variants in shapes.items()
    )


def null_evidence(cases: Sequence[ScoredCase]) -> list[str]:
    """List the effects with the largest median evidence in cases without effect."""
    nothing = [one.evidence for one in cases if one.truth["tier"] == "none"]
    if not nothing:
        return []
    medians = {id: float(np.median([case[id] for case in nothing if id in case])) for id in nothing[0]}
    largest = float(np.median([max(case.values()) for case in nothing]))
    listed = sorted(medians, key=lambda id: -medians[id])[:_LISTED]
    words = ", ".join(f"{id} {medians[id]:.1f}" for id in listed)
    return [f"  cases without effect: strongest {largest:.1f} nats in the median; by effect {words}"]


if __name__ == "__main__":
    sys.exit(main())
