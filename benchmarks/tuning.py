"""What everybody has of each effect, and how bold evidence is, by cases whose truth is known.

``python -m benchmarks.tuning --bank BANK --lines LINES`` takes a development bank and its straight lines
(see `benchmarks.lines`), and gives the constants of `wrapjax.gap`'s score. People differ from any model of
them: by how much is estimated by maximum likelihood, with an effect that a case is known to have allowed for
(MacKay 1992, doi:10.1162/neco.1992.4.3.415). Then evidence is tempered (see `benchmarks.tempering`). Families
of force curves take turns: what one half of the people says is tried on the other, and printed beside what
the shipped constants do. ``--out`` writes constants with those of all cases.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import softmax

from benchmarks.banks import CLEAR
from benchmarks.lines import Lines, development_lines
from benchmarks.tempering import Scored, surprise, tempered
from wrapjax.errors import InputError
from wrapjax.files import write_json
from wrapjax.gap.conclude.verdict import Tuning
from wrapjax.gap.evidence.null import nulls
from wrapjax.gap.evidence.projection import Candidate, Projection, project
from wrapjax.gap.evidence.score import score_projected

#: Of an effect that a case has, as a share of its prior deviation: larger than any.
_THERE = 3.0
_TURNS = 15
#: Nats by which a null is less likely than the likeliest.
_RULED_OUT = 12.0
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

    def scored(self, shares: Mapping[str, float]) -> Scored:
        """Score effects."""
        allowed = [one.allowing(self.spread(shares)) for one in self.projections]
        (found,) = score_projected(allowed, self.candidates)
        return Scored(self.truth, {one.id: one.evidence for one in found.scores}, found.structured)


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
        for name, tuning in (
            ("nothing", replace(shipped, background={})),
            ("shipped", shipped),
            ("fitted", tuned(others, shipped)),
        ):
            print(f"  {world}, allowing for {name}: {_judged(own, tuning)}", flush=True)
    if options.out:
        bank = hashlib.sha256((options.bank / "manifest.json").read_bytes()).hexdigest()
        write_json(options.out, asdict(replace(tuned(known, shipped), sha256=bank)))
    return 0


def tuned(cases: Sequence[Known], start: Tuning) -> Tuning:
    """Estimate all constants that cases decide; the others are those of the start.

    What everybody has is estimated by all cases. How bold evidence is, and what sets off an alarm, is what it
    is where each family of force curves was scored by what the others say everybody has: people of a family
    that nobody has seen are no better known.
    """
    worlds = sorted({case.truth["world"] for case in cases})
    scored = []
    for world in worlds:
        others = [case for case in cases if case.truth["world"] != world] or cases
        shares = _rounded(everybody(others))
        scored += [case.scored(shares) for case in cases if case.truth["world"] == world]
    return replace(tempered(scored, start), background=_rounded(everybody(cases)))


def _rounded(shares: Mapping[str, float]) -> dict[str, float]:
    return {name: round(share, 2) for name, share in shares.items()}


def read(bank: Path, lines: Path) -> list[Known]:
    """Take in all cases whose lines are there; raises what `development_lines` does."""
    found = []
    for truth, own in development_lines(bank, lines):
        candidates = own.gap.candidates
        residual = own.gap.residual.reshape(1, -1)
        found.append(Known(truth, candidates, _seen(residual, own, candidates)))
    return found


def _seen(
    residual: Float[np.ndarray, "1 row"], lines: Lines, candidates: Sequence[Candidate]
) -> tuple[Projection, ...]:
    """Look through every null but those that the residual rules out; the first is what others count from."""
    first, *others = (project(residual, null, candidates) for null in nulls(lines.gap, lines.sizes))
    likeliest = max(float(one.weight[0]) for one in (first, *others))
    return (first, *(one for one in others if one.weight[0] > likeliest - _RULED_OUT))


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


def _judged(cases: Sequence[Known], tuning: Tuning) -> str:
    scored = [case.scored(tuning.background) for case in cases]
    clear = first = three = over = 0
    for case, one in zip(cases, scored, strict=True):
        if case.truth["tier"] == "single" and case.truth["d_star"] > CLEAR:
            order = sorted(one.evidence, key=lambda id: -one.evidence[id])
            right = order[0] in case.accepted
            clear, first, three = clear + 1, first + right, three + bool(set(order[:3]) & case.accepted)
            over += right and one.evidence[order[0]] > tuning.alarm
    none = [max(one.evidence.values()) for one in scored if one.truth["tier"] == "none"]
    alarms = sum(most > tuning.alarm for most in none)
    return (
        f"first {first} and among three {three} of {clear}, {over} of them over the alarm of "
        f"{tuning.alarm:g} nats, as are {alarms} of {len(none)} without effect; "
        f"surprise {surprise(scored, tuning):.2f} nats"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tuning", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    return parser


if __name__ == "__main__":
    sys.exit(main())
