"""Constants that turn log Bayes factors into probabilities, fitted to cases with known causes.

``python -m validation.diagnosis.temperature_scaling --bank BANK --lines LINES`` reads the linearized models
of a development bank (see `validation.diagnosis.linearizations`), scores its cases, prints how often the
cause is ranked first, and fits the constants of the probabilities (temperature scaling, Guo et al. 2017) and
the detection threshold. The search starts from the shipped constants or those of ``--constants``; ``--out``
writes the result.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from validation.diagnosis.linearizations import linearizations_parser
from validation.diagnosis.scored_cases import GROSS_MISFIT, ScoredCase, ranking, score_cases
from wrapjax.diagnosis.claims.decision import DecisionConstants
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import write_json
from wrapjax.io.json_and_arrays import load_json

#: Constants that are fitted here.
_FITTED = (
    "temperature",
    "offset",
    "least_detection_threshold",
    "unknown_scale",
    "adequacy_factor",
    "set_level",
    "family_level",
)
#: Lower bound of probabilities in the objective, so that no single case dominates it.
_FLOOR = 1e-3
# Finer changes of a constant are not significant among a hundred cases.
_TOLERANCES = {"xatol": 0.02, "fatol": 1e-4}
#: Smallest and largest scale (logarithm of an error) of the transition from `none` to `unknown`: a step, and
#: no information.
_SMALLEST_SCALE, _LARGEST_SCALE = 0.01, 2.0
#: Allowed shares of cases without effect whose evidence exceeds the detection threshold, and which leave more
#: error than the gate for adequate models allows.
_FALSE_POSITIVES, _INADEQUATE = 0.025, 0.05
#: Share of cases that credible sets should cover.
_COVERAGE = 0.9


def main() -> int:
    options = _parser().parse_args()
    try:
        start = read_constants(options.constants) if options.constants else DecisionConstants.shipped()
        scored = score_cases(options.bank, options.lines, options.workers)
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"right cause {ranking(scored)}")
    print(_describe_nothing_amiss(scored))
    bank = hashlib.sha256((options.bank / "manifest.json").read_bytes()).hexdigest()
    fitted = replace(fit_constants(scored, start), sha256=bank)
    for name, constants in (("given", start), ("fitted", fitted)):
        values = ", ".join(f"{key} {getattr(constants, key):g}" for key in _FITTED)
        print(f"{name}: {values}: {_describe(scored, constants)}", flush=True)
    if options.out:
        write_json(options.out, asdict(fitted))
    return 0


def _describe_nothing_amiss(cases: Sequence[ScoredCase]) -> str:
    """Describe the strongest evidence in cases without effect, and the repeatable error that is left."""
    nothing = [one for one in cases if one.nothing_amiss]
    evidence = [max(one.evidence.values()) for one in nothing]
    left = [one.left for one in nothing]
    return (
        f"{len(nothing)} with nothing amiss: strongest evidence {min(evidence):.1f} to {max(evidence):.1f} "
        f"nats, median {np.median(evidence):.1f}; repeatable error left {min(left):.2f} to {max(left):.2f} "
        "times the 95th percentile of null replicates"
    )


def _describe(cases: Sequence[ScoredCase], constants: DecisionConstants) -> str:
    """Describe the effect of the detection threshold, and the negative log probability of correct answers."""
    clear = [one for one in cases if one.clear]
    right = [one for one in clear if one.ranked[0] in one.accepted]
    over = sum(max(one.evidence.values()) > constants.least_detection_threshold for one in right)
    none = [max(one.evidence.values()) for one in cases if one.nothing_amiss]
    alarms = sum(most > constants.least_detection_threshold for most in none)
    return (
        f"{over} of {len(right)} correct and {alarms} of {len(none)} without effect over the threshold; "
        f"negative log probability {negative_log_probability(cases, constants):.2f} nats"
    )


def read_constants(file: Path) -> DecisionConstants:
    """Read constants from a file; raises `InputError` if it has none."""
    try:
        return DecisionConstants(**load_json(file))
    except (TypeError, ValueError):
        raise InputError(Problem(str(file), "no constants of the score")) from None


def negative_log_probability(cases: Sequence[ScoredCase], constants: DecisionConstants) -> float:
    """Compute the mean negative log probability of the correct answers (nats)."""
    correct = [one.correct_probability(one.stated(constants)) for one in cases]
    return -float(np.mean([np.log(max(share, _FLOOR)) for share in correct if share is not None]))


def fit_constants(cases: Sequence[ScoredCase], constants: DecisionConstants) -> DecisionConstants:
    """Fit the constants by maximum likelihood; cases without effect rarely exceed the detection threshold.

    Parameters
    ----------
    cases
        Scored cases; pairs and cases with gross misfit are ignored, and some cases must be without effect.
    constants
        Initial values, and values of the other constants.
    """
    cases = [one for one in cases if one.truth.get("world") != GROSS_MISFIT]
    nothing = [one for one in cases if one.nothing_amiss]
    worlds = {one.truth.get("world", "") for one in nothing}

    def exceeded_by(of: Callable[[ScoredCase], float], share: float) -> float:
        """Compute the value that at most this share of the cases of each family exceeds."""
        by_world = [[of(one) for one in nothing if one.truth.get("world", "") == world] for world in worlds]
        return max(float(np.quantile(own, 1.0 - share)) for own in by_world)

    constants = replace(
        constants,
        least_detection_threshold=float(
            np.ceil(10.0 * exceeded_by(lambda one: max(one.evidence.values()), _FALSE_POSITIVES)) / 10.0
        ),
        adequacy_factor=max(
            1.0, float(np.ceil(100.0 * exceeded_by(lambda one: one.left, _INADEQUATE)) / 100.0)
        ),
    )

    def at(point: Float[np.ndarray, " constant"]) -> DecisionConstants:
        temperature, scale = np.exp(point[[0, 2]])
        return replace(
            constants,
            temperature=float(temperature),
            offset=float(point[1]),
            unknown_scale=float(np.clip(scale, _SMALLEST_SCALE, _LARGEST_SCALE)),
        )

    # Not from the largest scale, where the objective is flat.
    start = [np.log(constants.temperature), constants.offset, np.log(_LARGEST_SCALE / 5.0)]
    solution = minimize(
        lambda point: negative_log_probability(cases, at(point)),
        start,
        method="Nelder-Mead",
        options=_TOLERANCES,
    )
    best = at(solution.x)
    best = replace(
        best,
        temperature=round(best.temperature, 2),
        offset=round(best.offset, 2),
        unknown_scale=round(best.unknown_scale, 2),
    )
    return replace(
        best,
        set_level=_covering_everywhere(cases, lambda one: one.set_level(one.stated(best))),
        family_level=_covering_everywhere(cases, lambda one: one.family_level(one.stated(best))),
    )


def _covering_everywhere(cases: Sequence[ScoredCase], level: Callable[[ScoredCase], float | None]) -> float:
    """Compute the level of credible sets that cover a new case of these worlds, and 90 % of each world's.

    A new person belongs to none of these worlds, so that the world that needs most counts, not their mean.
    """
    by_world: dict[str, list[float]] = {}
    for one in cases:
        if (known := level(one)) is not None:
            by_world.setdefault(one.truth.get("world", ""), []).append(known)
    together = [known for own in by_world.values() for known in own]
    each = [sorted(own)[math.ceil(_COVERAGE * len(own)) - 1] for own in by_world.values()]
    return max(covering_level(together), *map(_rounded_up, each))


def covering_level(known: Sequence[float | None]) -> float:
    """Compute the level of credible sets that cover a new case with 90 % probability (split conformal).

    See Vovk et al. 2005 (doi:10.1007/b106715); cases are taken as exchangeable.

    Parameters
    ----------
    known
        Level above which the set of each case covers it; None where no single answer is correct.
    """
    levels = sorted(level for level in known if level is not None)
    place = math.ceil(_COVERAGE * (len(levels) + 1)) - 1
    return 1.0 if place >= len(levels) else _rounded_up(levels[place])


def _rounded_up(level: float) -> float:
    """Round a level up, since sets contain what lies below it."""
    return min(1.0, math.floor(100.0 * level + 1.0) / 100.0)


def _parser() -> argparse.ArgumentParser:
    parser = linearizations_parser("temperature_scaling", __doc__)
    parser.add_argument(
        "--constants", type=Path, metavar="FILE.json", help="initial constants (default: shipped)"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write the constants to")
    parser.add_argument("--workers", type=int, default=2)
    return parser


if __name__ == "__main__":
    sys.exit(main())
