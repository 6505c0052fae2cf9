"""Number of cases in which several effects are significant together, for one, two or no true causes.

``python -m validation.diagnosis.multiple_effects --bank BANK --lines LINES`` reads the linearized models of a
development bank (see `validation.diagnosis.linearizations`) and selects the effects that are each significant
beside the others, as a diagnosis does before it tests them on held-out cycles. The detection threshold is the
shipped one; in a diagnosis its own null replicates may raise it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from validation.diagnosis.linearizations import (
    LinearizedCase,
    development_linearizations,
    linearizations_parser,
)
from wrapjax.diagnosis.claims.decision import DecisionConstants
from wrapjax.diagnosis.evidence.score import jointly_significant_effects
from wrapjax.diagnosis.evidence.score_test import project, score_projected
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls
from wrapjax.errors import InputError

#: Tiers of cases with causes in the catalogue.
TIERS = ("none", "single", "pair")


def main() -> int:
    options = linearizations_parser("multiple_effects", __doc__).parse_args()
    found: dict[str, list[tuple[tuple[str, ...], set[str]]]] = defaultdict(list)
    try:
        for tier, together, causes in significant_in_cases(options.bank, options.lines):
            found[tier].append((together, causes))
            print(f"{tier:8s}{', '.join(sorted(causes)):60s}{', '.join(together)}", flush=True)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"\n{'':8s}{'cases':>8s}{'several':>10s}{'all of them true':>18s}")
    for tier in TIERS:
        own = found[tier]
        several = [(together, causes) for together, causes in own if together]
        right = sum(set(together) <= causes for together, causes in several)
        print(f"{tier:8s}{len(own):8d}{len(several):10d}{right:18d}")
    return 0


def significant_in_cases(bank: Path, lines: Path) -> Iterator[tuple[str, tuple[str, ...], set[str]]]:
    """Iterate over cases: tier, effects that are significant together, and causes."""
    constants = DecisionConstants.shipped()
    for truth, own in development_linearizations(bank, lines):
        if truth["tier"] in TIERS:
            yield truth["tier"], together(own, constants), {cause["id"] for cause in truth["causes"]}


def together(lines: LinearizedCase, constants: DecisionConstants) -> tuple[str, ...]:
    """Return the effects that are each significant beside the others; none if one effect suffices."""
    linearized = lines.linearized
    residual = lines.linearized.residual.reshape(1, -1)
    projections = [
        project(residual, null, linearized.candidates)
        for null in nulls(linearized, lines.recorded.measured_moment_sd)
    ]
    (scored,) = score_projected(projections, linearized.candidates)
    scores = {one.id: one for one in sorted(scored.scores, key=lambda one: -one.evidence)}
    return jointly_significant_effects(
        projections, linearized.candidates, scores, constants.least_detection_threshold
    )


if __name__ == "__main__":
    sys.exit(main())
