"""How bold evidence is: constants that turn nats into probabilities, from cases whose truth is known.

``python -m validation.diagnosis.temperature_scaling --bank BANK --lines LINES`` takes a development bank and its straight lines
(see `validation.diagnosis.linearizations`), scores its cases, says how often the cause is first, and chooses the constants of
probabilities. The search begins at the shipped ones, or at those of ``--constants``; ``--out`` writes what
it finds.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from validation.diagnosis.scored_cases import Scored, ranking, read
from wrapjax.diagnosis.verdict import DecisionConstants, probabilities
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_json
from wrapjax.io.json_and_arrays import load_json

#: Constants that are chosen here.
_TEMPERED = ("temperature", "offset", "detection_threshold", "structured_offset", "structured_scale")
#: Probability that is given to what was thought impossible: one case alone must not decide everything.
_FLOOR = 1e-3
# Finer changes of a constant than this mean nothing among a hundred cases.
_ENOUGH = {"xatol": 0.02, "fatol": 1e-4}
#: Nats over which what is unknown becomes likelier than nothing: beyond this they say nothing of it.
_FLATTEST = 25.0
#: Share of cases without effect that may have more evidence than the alarm, and more for what is unknown than
#: for nothing.
_ALARMS, _UNKNOWNS = 0.025, 0.10


def main() -> int:
    options = _parser().parse_args()
    try:
        start = read_constants(options.constants) if options.constants else DecisionConstants.shipped()
        scored = read(options.bank, options.lines)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"right cause {ranking(scored)}")
    bank = hashlib.sha256((options.bank / "manifest.json").read_bytes()).hexdigest()
    found = replace(tempered(scored, start), sha256=bank)
    for name, constants in (("given", start), ("tempered", found)):
        told = ", ".join(f"{key} {getattr(constants, key):g}" for key in _TEMPERED)
        print(f"{name}: {told}: {_told(scored, constants)}", flush=True)
    if options.out:
        write_json(options.out, asdict(found))
    return 0


def _told(cases: Sequence[Scored], constants: DecisionConstants) -> str:
    """Say what an alarm at this level does, and how much what is true surprises."""
    clear = [one for one in cases if one.clear]
    right = [one for one in clear if one.ranked[0] in one.accepted]
    over = sum(max(one.evidence.values()) > constants.detection_threshold for one in right)
    none = [max(one.evidence.values()) for one in cases if one.truth["tier"] == "none"]
    alarms = sum(most > constants.detection_threshold for most in none)
    return (
        f"{over} of {len(right)} right ones and {alarms} of {len(none)} without effect over the alarm; "
        f"surprise {surprise(cases, constants):.2f} nats"
    )


def read_constants(file: Path) -> DecisionConstants:
    """Read constants that were written here; raises `InputError` on anything else."""
    try:
        return DecisionConstants(**load_json(file))
    except (TypeError, ValueError):
        raise InputError(Problem(str(file), "no constants of the score")) from None


def surprise(cases: Sequence[Scored], constants: DecisionConstants) -> float:
    """Give the mean of less the logarithm of the probability of what is true (nats)."""
    found = [one.right(probabilities(one.evidence, one.structured, constants)) for one in cases]
    return -float(np.mean([np.log(max(share, _FLOOR)) for share in found if share is not None]))


def tempered(cases: Sequence[Scored], constants: DecisionConstants) -> DecisionConstants:
    """Choose constants so that cases surprise least and those without effect rarely set off an alarm.

    Parameters
    ----------
    cases
        All tiers but pairs are looked at; some must be without effect.
    tuning
        Where the search begins, and all other constants.
    """
    nothing = [one for one in cases if one.truth["tier"] == "none"]
    worlds = {one.truth.get("world", "") for one in nothing}

    def rarely(of: Callable[[Scored], float], share: float) -> float:
        """Give what so few of any family exceed."""
        by_world = [[of(one) for one in nothing if one.truth.get("world", "") == world] for world in worlds]
        return max(float(np.quantile(own, 1.0 - share)) for own in by_world)

    constants = replace(
        constants,
        detection_threshold=float(
            np.ceil(10.0 * rarely(lambda one: max(one.evidence.values()), _ALARMS)) / 10.0
        ),
        structured_offset=round(rarely(lambda one: one.structured, _UNKNOWNS), 1),
    )

    def at(point: Float[np.ndarray, " constant"]) -> DecisionConstants:
        temperature, scale = np.exp(point[[0, 2]])
        return replace(
            constants,
            temperature=float(temperature),
            offset=float(point[1]),
            structured_scale=float(min(scale, _FLATTEST)),
        )

    # Not at the flattest, where nothing shows which way to go.
    start = [np.log(constants.temperature), constants.offset, np.log(_FLATTEST / 5.0)]
    found = minimize(lambda point: surprise(cases, at(point)), start, method="Nelder-Mead", options=_ENOUGH)
    best = at(found.x)
    return replace(
        best,
        temperature=round(best.temperature, 2),
        offset=round(best.offset, 2),
        structured_scale=round(best.structured_scale, 1),
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m validation.diagnosis.temperature_scaling", description=__doc__
    )
    parser.add_argument("--bank", type=Path, required=True)
    parser.add_argument("--lines", type=Path, required=True)
    parser.add_argument("--constants", type=Path, metavar="FILE.json", help="other ones than the shipped")
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    return parser


if __name__ == "__main__":
    sys.exit(main())
