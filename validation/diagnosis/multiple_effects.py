"""How often several effects stand out together, where one, two or none are true.

``python -m validation.diagnosis.multiple_effects --bank BANK --lines LINES`` takes a development bank and its straight lines
(see `validation.diagnosis.linearizations`), and looks for effects that each stand out beside the others, as a diagnosis does
before it asks whether each helps with cycles kept back. The alarm is the shipped one; a diagnosis' own people
with nothing amiss may raise it.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from validation.diagnosis.linearizations import Lines, development_lines
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.projection import project
from wrapjax.diagnosis.score import score_projected
from wrapjax.diagnosis.together import standing_together
from wrapjax.diagnosis.verdict import DecisionConstants
from wrapjax.errors import InputError

#: Cases whose causes the catalogue has, by how many they are.
TIERS = ("none", "single", "pair")


def main() -> int:
    options = _parser().parse_args()
    found: dict[str, list[tuple[tuple[str, ...], set[str]]]] = defaultdict(list)
    try:
        for tier, together, causes in judged(options.bank, options.lines):
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


def judged(bank: Path, lines: Path) -> Iterator[tuple[str, tuple[str, ...], set[str]]]:
    """Give of each case what it is called, what stands out together, and its causes."""
    constants = DecisionConstants.shipped()
    for truth, own in development_lines(bank, lines):
        if truth["tier"] in TIERS:
            yield truth["tier"], together(own, constants), {cause["id"] for cause in truth["causes"]}


def together(lines: Lines, constants: DecisionConstants) -> tuple[str, ...]:
    """Name the effects that each stand out beside the others; none where one explains as much."""
    gap = lines.gap
    residual = lines.gap.residual.reshape(1, -1)
    projections = [project(residual, null, gap.candidates) for null in nulls(gap, lines.sizes)]
    (scored,) = score_projected(projections, gap.candidates)
    scores = {one.id: one for one in sorted(scored.scores, key=lambda one: -one.evidence)}
    return standing_together(projections, gap.candidates, scores, constants.detection_threshold)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.multiple_effects", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    return parser


if __name__ == "__main__":
    sys.exit(main())
