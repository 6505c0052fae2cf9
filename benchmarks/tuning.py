"""What everybody has of each effect, by cases whose truth is known.

``python -m benchmarks.tuning --bank BANK --lines LINES`` takes a development bank and its straight lines
(see `benchmarks.lines`). People differ from any model of them: by how much is estimated by maximum
likelihood, with an effect that a case is known to have allowed for (MacKay 1992,
doi:10.1162/neco.1992.4.3.415). Families of force curves take turns: what one half of the people says is tried
on the other, and printed beside what the shipped shares do. ``--out`` writes the shipped constants with the
shares of all cases; how bold evidence is with these says `benchmarks.tempering`.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.special import softmax

from benchmarks.banks import CLEAR
from benchmarks.known_cases import Known, ranking, read
from wrapjax.errors import InputError
from wrapjax.files import write_json
from wrapjax.gap.conclude.verdict import Tuning

#: Of an effect that a case has, as a share of its prior deviation: larger than any.
_THERE = 3.0
_TURNS = 15
#: Shares below this are none, and none is larger than this: an effect that everybody has so much of is no
#: effect.
_LEAST, _MOST = 0.05, 1.0


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
        for name, shares in (
            ("nothing", {}),
            ("shipped", shipped.background),
            ("fitted", _rounded(everybody(others))),
        ):
            found = ranking([case.scored(shares) for case in own])
            print(f"  {world}, allowing for {name}: {found}", flush=True)
    if options.out:
        bank = hashlib.sha256((options.bank / "manifest.json").read_bytes()).hexdigest()
        shares = _rounded(everybody(known))
        write_json(options.out, asdict(replace(shipped, background=shares, sha256=bank)))
    return 0


def _rounded(shares: Mapping[str, float]) -> dict[str, float]:
    return {name: round(share, 2) for name, share in shares.items()}


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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tuning", description=__doc__)
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    return parser


if __name__ == "__main__":
    sys.exit(main())
