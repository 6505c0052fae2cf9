"""What everybody has of each effect, by cases whose truth is known: constants of `wrapjax.gap`'s score.

``python -m benchmarks.tuning --bank BANK --lines LINES`` takes a development bank and its straight lines (see
`benchmarks.lines`). People differ from any model of them: by how much is estimated by maximum likelihood,
with an effect that a case is known to have allowed for (MacKay 1992, doi:10.1162/neco.1992.4.3.415). Families
of force curves take turns: what one half of the people says is tried on the other, and the worse of both is
printed beside what the shipped constants do. ``--out`` writes constants with those of all cases.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import softmax

from benchmarks.banks import CLEAR
from benchmarks.lines import development_lines
from wrapjax.errors import InputError
from wrapjax.files import content_hash, write_json
from wrapjax.gap.conclude.verdict import Tuning
from wrapjax.gap.evidence.null import nulls
from wrapjax.gap.evidence.projection import Candidate, Projection, project
from wrapjax.gap.evidence.score import score_projected

#: Of an effect that a case has, as a share of its prior deviation: larger than any.
_THERE = 3.0
_TURNS = 30
#: Shares below this are none, and none is larger than this: an effect that everybody has so much of is no
#: effect.
_LEAST, _MOST = 0.05, 1.0


@dataclass(frozen=True)
class Known:
    """A case through every null hypothesis, and its truth.

    Parameters
    ----------
    truth
        Of the bank.
    candidates
        Its effects.
    projections
        One a null.
    """

    truth: dict[str, Any]
    candidates: tuple[Candidate, ...]
    projections: tuple[Projection, ...]

    @property
    def causes(self) -> tuple[str, ...]:
        return tuple(cause["id"] for cause in self.truth["causes"])

    @property
    def accepted(self) -> set[str]:
        return {*self.causes, *self.truth["ties"]}

    def spread(self, shares: Mapping[str, float]) -> Float[np.ndarray, " amount"]:
        """Standard deviations of all amounts of all shapes, which share what everybody has."""
        return np.concatenate([shares.get(one.id, 0.0) * one.shared_sd for one in self.candidates])

    def evidence(self, shares: Mapping[str, float]) -> dict[str, float]:
        """Score effects."""
        allowed = [one.allowing(self.spread(shares)) for one in self.projections]
        (scored,) = score_projected(allowed, self.candidates)
        return {one.id: one.evidence for one in scored.scores}


def main() -> int:
    options = _parser().parse_args()
    try:
        known = read(options.bank, options.lines)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    shipped = Tuning.shipped()
    worlds = sorted({case.truth["world"] for case in known})
    print(f"{len(known)} cases of {', '.join(worlds)}; right cause first, d* over {CLEAR:g}")
    for world in worlds:
        others = [case for case in known if case.truth["world"] != world]
        own = [case for case in known if case.truth["world"] == world]
        found = everybody(others)
        for name, shares in (("nothing", {}), ("shipped", shipped.background), ("fitted", found)):
            print(f"  {world}, allowing for {name}: {_judged(own, shares)}", flush=True)
    if options.out:
        shares = {name: round(share, 2) for name, share in everybody(known).items()}
        bank = content_hash(options.bank / "manifest.json")
        content = dataclasses.asdict(shipped) | {"sha256": bank, "background": shares}
        write_json(options.out, content)
    return 0


def read(bank: Path, lines: Path) -> list[Known]:
    """Take in all cases whose lines are there; raises what `development_lines` does."""
    found = []
    for truth, own in development_lines(bank, lines):
        candidates = own.gap.candidates
        residual = own.gap.residual.reshape(1, -1)
        seen = tuple(project(residual, null, candidates) for null in nulls(own.gap, own.sizes))
        found.append(Known(truth, candidates, seen))
    return found


def everybody(cases: Sequence[Known]) -> dict[str, float]:
    """Estimate how much of each effect everybody has, in parts of its prior deviation, by id.

    Cases with a mechanism that no effect stands for are left out.
    """
    known = [case for case in cases if case.truth["tier"] != "outside"]
    ids = sorted({one.id for case in known for one in case.candidates})
    shares = dict.fromkeys(ids, 0.3)
    for _ in range(_TURNS):
        size, told = dict.fromkeys(ids, 0.0), dict.fromkeys(ids, 1e-9)
        for case in known:
            _add_up(case, shares, size, told)
        shares = {name: min(float(np.sqrt(size[name] / told[name])), _MOST) for name in ids}
    return {name: share for name, share in shares.items() if share >= _LEAST}


def _add_up(case: Known, shares: Mapping[str, float], size: dict[str, float], told: dict[str, float]) -> None:
    """Add a case's amounts, squared in prior deviations, and how many of them its data have decided."""
    own = {**shares, **dict.fromkeys(case.causes, _THERE)}
    spread = case.spread(own)
    allowed = [one.allowing(spread) for one in case.projections]
    weights = softmax([one.weight[0] for one in allowed])
    amounts = [spread**2 * one.slope[0] for one in allowed]
    decided = [spread**2 * np.diag(one.information) for one in allowed]
    first = 0
    for one in case.candidates:
        count = len(one.prior_sd) * len(one.variants)
        place = slice(first, first := first + count)
        if one.id in case.causes:
            continue
        for weight, amount, share in zip(weights, amounts, decided, strict=True):
            size[one.id] += float(weight * np.sum((amount[place] / one.shared_sd) ** 2))
            told[one.id] += float(weight * np.sum(share[place]))


def _judged(cases: Sequence[Known], shares: Mapping[str, float]) -> str:
    single = [c for c in cases if c.truth["tier"] == "single" and c.truth["d_star"] > CLEAR]
    first = three = 0
    for case in single:
        found = case.evidence(shares)
        order = sorted(found, key=lambda id: -found[id])
        first += order[0] in case.accepted
        three += bool(set(order[:3]) & case.accepted)
    none = [max(c.evidence(shares).values()) for c in cases if c.truth["tier"] == "none"]
    alarm = f"{np.quantile(none, 0.95):.1f}" if none else "-"
    return (
        f"first {first} and among three {three} of {len(single)}; where nothing is amiss 95 % of "
        f"{len(none)} cases have at most {alarm} nats"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tuning", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    return parser


if __name__ == "__main__":
    sys.exit(main())
