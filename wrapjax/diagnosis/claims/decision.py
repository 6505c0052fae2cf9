"""Decision on the effects: probabilities, ties, credible set and outcome, by constants and thresholds.

The constants were chosen on cases with known causes (see `DecisionConstants`). No fit is made here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import combinations
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logsumexp

from wrapjax.diagnosis.claims.gates import Gates
from wrapjax.diagnosis.effects.catalogue import family_probabilities
from wrapjax.diagnosis.evidence.score import Scores
from wrapjax.diagnosis.evidence.score_test import MIN_DETECTABILITY
from wrapjax.diagnosis.fits.refit import Ids
from wrapjax.diagnosis.fits.verification import Verification
from wrapjax.diagnosis.inputs.input import DiagnosisInput

#: Squared distance, in squared standard deviations, below which two effects cannot be distinguished.
TIE_DISTANCE = 9.0
#: Largest difference of evidence (nats) between the strongest effect and the other members of its tie.
TIE_EVIDENCE = 5.0
#: Smallest probability of an effect that is named, or of all members of a tie together.
MIN_PROBABILITY = 0.5
#: Detectability below which a recording could miss an effect.
RELIABLE_DETECTABILITY = 5.0

#: How a diagnosis can end.
#:
#: named
#:     One effect explains the error best, or several do together, each of them needed beside the others.
#: tie
#:     Several effects do that this recording cannot tell apart.
#: family
#:     Effects of one family do, but the recording does not tell which of them.
#: unknown
#:     The model has an error that no effect of the catalogue explains.
#: none
#:     The error is not larger than that of null replicates.
#: insufficient_data
#:     There are too few cycles to separate the repeatable error from noise.
#: not_converged
#:     The convergence check failed; the error may be that of an unfinished fit.
OUTCOMES = ("named", "tie", "family", "unknown", "none", "insufficient_data", "not_converged")


@dataclass(frozen=True)
class DecisionConstants:
    """Constants of the decision, from a blind bank: cases of a simulator that shares nothing with the model.

    Parameters
    ----------
    bank, sha256
        Name of the blind bank, and hash of its manifest.
    temperature
        Divisor of the evidence; see temperature scaling (Guo et al. 2017).
    offset
        Evidence at which an effect is as probable as none, nats.
    least_detection_threshold
        Evidence that is rarely exceeded without any effect, nats.
    unknown_scale
        Increase of the logarithm of the error that is left, relative to what is allowed, by which the odds of
        an unknown cause against none grow e-fold; they are even at the error that is allowed.
    set_level, family_level
        Nominal probability of a credible set of effects, and of one of families, so that it covers 90 % of
        the people of the world in which that takes the largest sets.
    adequacy_factor
        Factor on the repeatable error that null replicates leave, so that 95 % of people with nothing amiss
        leave less; see `wrapjax.diagnosis.claims.gates.Adequate`.
    """

    bank: str
    sha256: str
    temperature: float
    offset: float
    least_detection_threshold: float
    unknown_scale: float
    set_level: float
    family_level: float
    adequacy_factor: float

    @classmethod
    def shipped(cls) -> DecisionConstants:
        """Read the constants that come with the package."""
        text = (
            resources.files("wrapjax.diagnosis.claims")
            .joinpath("decision_constants.json")
            .read_text(encoding="utf-8")
        )
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Probabilities:
    """Probability of each effect, of no effect, and of a cause outside the catalogue; their sum is 1."""

    effects: dict[str, float]
    none: float
    unknown: float


@dataclass(frozen=True)
class Decision:
    """Outcome of a diagnosis.

    Parameters
    ----------
    outcome, reason
        One of `OUTCOMES`, and a sentence that gives the reason.
    named, tie
        Effects that are named, and members of a tie.
    probabilities
        Probabilities of the effects; None where they were not scored.
    credible_set
        Smallest set of effects with the probability `DecisionConstants.set_level`; can contain
        ``none_of_these``.
    family
        Identifier of the family that is named; empty for none.
    credible_families
        The same of families, with `DecisionConstants.family_level`.
    best_partial
        Effects that explain most where the outcome is ``unknown``, but not as a claim has to; not named.
    gates
        Gates of the claim; None before they are examined (`wrapjax.diagnosis.claims.gates`).
    """

    outcome: str
    reason: str
    named: tuple[str, ...] = ()
    tie: tuple[str, ...] = ()
    probabilities: Probabilities | None = None
    credible_set: tuple[str, ...] = ()
    family: str = ""
    credible_families: tuple[str, ...] = ()
    best_partial: tuple[str, ...] = ()
    gates: Gates | None = None

    @property
    def accepted(self) -> tuple[str, ...]:
        """Effects that are named or in the tie."""
        return self.named or self.tie


def decide(
    data: DiagnosisInput,
    scores: Scores,
    verification: Verification,
    constants: DecisionConstants,
    error_left: float,
) -> Decision:
    """Decide which effects to name.

    Jointly significant effects are named only if refits of all their subsets are among the verified ones;
    see `subsets_to_refit`.

    Parameters
    ----------
    data, scores, verification
        Input of the diagnosis, scores of all effects, and verified refits.
    constants
        Constants of the decision.
    error_left
        Repeatable error of the model without any effect, relative to what is allowed; see `gates.Adequate`.
    """
    evidence = scores.evidence
    tie = tie_of_strongest(scores)
    probability = probabilities(evidence, error_left, constants)
    gains = verification.gains
    decision = decide_on_single_effect(
        probability,
        evidence,
        tie,
        scores.detection_threshold,
        _negative_controls(data),
        _undetectable(scores),
        {id: gains[(id,)] for id in evidence if (id,) in gains},
    )
    decision = with_probabilities(decision, probability, tie, constants)
    joint = scores.jointly_significant
    if (
        may_name_jointly(decision, joint, (*_negative_controls(data), *_undetectable(scores)))
        and all(subset in gains for subset in _subsets(joint))
        and each_effect_improves(joint, gains)
    ):
        reason = "these effects explain the error together"
        decision = replace(decision, outcome="named", reason=reason, named=joint, tie=())
    return decision


def with_probabilities(
    decision: Decision, probability: Probabilities, tie: Sequence[str], constants: DecisionConstants
) -> Decision:
    """State probabilities in a decision, with the credible sets that follow from them."""
    return replace(
        decision,
        probabilities=probability,
        credible_set=credible_set(probability, tie, constants.set_level),
        credible_families=credible_families(probability, constants.family_level),
    )


def subsets_to_refit(
    data: DiagnosisInput, scores: Scores, verification: Verification, decision: Decision
) -> tuple[Ids, ...]:
    """Select the subsets of jointly significant effects that have to be refitted before these may be named.

    Parameters
    ----------
    data, scores, verification
        Input of the diagnosis, scores of all effects, and refits of single effects.
    decision
        Decision on single effects; none is returned where it excludes naming several.
    """
    joint = scores.jointly_significant
    if not may_name_jointly(decision, joint, (*_negative_controls(data), *_undetectable(scores))):
        return ()
    return tuple(subset for subset in _subsets(joint) if subset not in verification.refits)


def _subsets(ids: Ids) -> tuple[Ids, ...]:
    """List all subsets of effects but the empty one, in their order."""
    return tuple(subset for size in range(1, len(ids) + 1) for subset in combinations(ids, size))


def _negative_controls(data: DiagnosisInput) -> tuple[str, ...]:
    return tuple(id for id, effect in data.calibration_effects.items() if effect.negative_control)


def _undetectable(scores: Scores) -> tuple[str, ...]:
    """List effects that the recording could not show even at the largest size that is tried."""
    return tuple(id for id, score in scores.by_id.items() if not score.detectable)


def probabilities(
    evidence: Mapping[str, float], error_left: float, constants: DecisionConstants
) -> Probabilities:
    """Compute probabilities from evidence by temperature scaling.

    Parameters
    ----------
    evidence
        Evidence of each effect, nats.
    error_left
        Repeatable error of the model without any effect, relative to what is allowed; see `gates.Adequate`.
    constants
        Constants of the decision.
    """
    ids = list(evidence)
    logits = np.array([*(evidence[id] for id in ids), constants.offset]) / constants.temperature
    share = np.exp(logits - logsumexp(logits))
    unknown = float(expit(math.log(error_left) / constants.unknown_scale)) if error_left > 0.0 else 0.0
    no_effect = float(share[-1])
    return Probabilities(
        dict(zip(ids, share[:-1].tolist(), strict=True)), no_effect * (1.0 - unknown), no_effect * unknown
    )


def refused_evidence(evidence: Mapping[str, float], offset: float) -> dict[str, float]:
    """Limit the evidence of effects where a gate refuses the claim, without a change of their order.

    Evidence compares an effect with a model that is right without it. Where the strongest effect is refused,
    the model may be wrong in another way, and evidence grows with what is wrong. No effect is then to be more
    probable than no effect and an unknown cause together: e > 0 becomes o (1 - exp(-e / o)), which is e for a
    small one and less than ``offset`` o for any.

    Parameters
    ----------
    evidence
        Evidence of each effect, nats.
    offset
        Evidence at which an effect is as probable as none, nats.
    """
    limit = max(offset, 1e-9)
    return {id: -limit * math.expm1(-one / limit) if one > 0.0 else one for id, one in evidence.items()}


def probabilities_of_refused(
    evidence: Mapping[str, float], error_left: float, constants: DecisionConstants
) -> Probabilities:
    """Compute probabilities where a gate refuses the claim; parameters as of `probabilities`."""
    return probabilities(refused_evidence(evidence, constants.offset), error_left, constants)


def tie_of_strongest(scores: Scores) -> tuple[str, ...]:
    """Select the strongest effect and those that form a tie with it; see `tied_effects`."""
    strongest = next(iter(scores.evidence), None)
    if strongest is None:
        return ()
    return tied_effects(strongest, scores.compared, scores.distinguishability, scores.evidence)


def tied_effects(
    first: str,
    ids: Sequence[str],
    distances: Float[np.ndarray, "effect effect"],
    evidence: Mapping[str, float],
) -> tuple[str, ...]:
    """Select the effects that form a tie with the strongest: no two members can be distinguished.

    Parameters
    ----------
    first
        The strongest effect.
    ids
        Effects of the rows and columns of ``distances``.
    distances
        Squared distance of each effect (row) from the span of each other one (column).
    evidence
        Evidence of each effect, nats.
    """
    members = [first]
    for id in sorted(ids, key=lambda one: -evidence[one]):
        if id in members or evidence[first] - evidence[id] > TIE_EVIDENCE:
            continue
        places = [ids.index(member) for member in members]
        row = ids.index(id)
        if all(max(distances[row, place], distances[place, row]) < TIE_DISTANCE for place in places):
            members.append(id)
    return tuple(members)


def credible_set(probability: Probabilities, tie: Sequence[str], level: float) -> tuple[str, ...]:
    """Select the smallest set with a probability of at least ``level``.

    A tie is added as a whole. No effect and an unknown cause are one member, ``none_of_these``.
    """
    reached = set_levels(probability, tie)
    return tuple(id for ids, before in reached.items() if before < level for id in ids)


def set_levels(probability: Probabilities, tie: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Compute the level above which a credible set contains each of its possible members.

    The most probable first; see `credible_set`.
    """
    none_of_these = probability.none + probability.unknown
    classes = [(tuple(tie), sum(probability.effects[id] for id in tie))] if tie else []
    classes += [((id,), share) for id, share in probability.effects.items() if id not in tie]
    classes.append((("none_of_these",), none_of_these))
    levels: dict[tuple[str, ...], float] = {}
    total = 0.0
    for ids, share in sorted(classes, key=lambda one: -one[1]):
        levels[ids] = total
        total += share
    return levels


def credible_families(probability: Probabilities, level: float) -> tuple[str, ...]:
    """Select the smallest set of families with a probability of at least ``level``; see `credible_set`."""
    return tuple(id for id, before in family_levels(probability).items() if before < level)


def family_levels(probability: Probabilities) -> dict[str, float]:
    """Compute the level above which a credible set of families contains each of them, as in `set_levels`."""
    shares = family_probabilities(probability.effects)
    shares["none_of_these"] = probability.none + probability.unknown
    levels: dict[str, float] = {}
    total = 0.0
    for id, share in sorted(shares.items(), key=lambda one: -one[1]):
        levels[id] = total
        total += share
    return levels


def decide_on_single_effect(
    probability: Probabilities,
    evidence: Mapping[str, float],
    tie: Sequence[str],
    detection_threshold: float,
    negative_controls: Sequence[str],
    undetectable: Sequence[str] = (),
    gains: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> Decision:
    """Decide whether one effect is named, or a tie.

    Parameters
    ----------
    probability, evidence
        Probabilities, and evidence of each effect, nats.
    tie
        The strongest effect and those that cannot be distinguished from it.
    detection_threshold
        Evidence that has to be exceeded, nats.
    negative_controls
        Effects that cannot be present in such a recording: if one is the strongest, the cause is another.
    undetectable
        Effects that this recording could not show at any plausible size: none of them is named.
    gains
        Increase of the log likelihood of each left-out block of cycles by each refitted effect, nats.
    """
    first = tie[0] if tie else None
    of_tie = sum(probability.effects[id] for id in tie)
    significant = first is not None and evidence[first] > detection_threshold and of_tie >= MIN_PROBABILITY
    if significant and first in undetectable:
        return Decision(
            "unknown",
            f"{first} would explain most, but this recording could not show it if it were present",
        )
    if first is not None and significant:
        if first in negative_controls:
            reason = f"{first} would explain most, but cannot be present in such a recording"
            return Decision("unknown", f"{reason}: the cause is another")
        if not _improves(gains.get(first, ())):
            return Decision(
                "unknown", f"{first} would explain most, but does not reduce the error on held-out cycles"
            )
        if len(tie) == 1:
            return Decision("named", "one effect explains the error best", named=(first,))
        return Decision("tie", "this recording cannot tell these effects apart", tie=tuple(tie))
    if probability.unknown > probability.none:
        return Decision("unknown", "the model leaves more repeatable error than null replicates have")
    return Decision("none", "no effect has more evidence than null replicates show")


def may_name_jointly(decision: Decision, joint: Sequence[str], excluded: Sequence[str]) -> bool:
    """Return whether jointly significant effects may be named in place of the decision on single effects.

    Parameters
    ----------
    decision
        Decision on single effects. One effect may have hidden another, but a tie or an unknown cause is kept.
    joint
        Effects that are jointly significant.
    excluded
        Negative controls, and effects that this recording could not show.
    """
    if not joint or set(joint) & set(excluded):
        return False
    return decision.named[0] in joint if decision.named else decision.outcome == "none"


def each_effect_improves(joint: Ids, gains: Mapping[Ids, Sequence[float]]) -> bool:
    """Return whether each of several effects reduces the error on held-out cycles beside the others.

    Parameters
    ----------
    joint
        Identifiers of the effects.
    gains
        Increase of the log likelihood of each block of cycles by each refit, nats; empty for effects that
        unseen cycles do not test.
    """
    together = gains[tuple(joint)]
    for id in joint:
        if not len(gains[(id,)]):
            continue
        others = gains[tuple(other for other in joint if other != id)] or [0.0] * len(together)
        if not _improves([more - less for more, less in zip(together, others, strict=True)]):
            return False
    return True


def _improves(gains: Sequence[float]) -> bool:
    """Return whether the sum of gains is positive, and four of five blocks gain (six of eight)."""
    losses = sum(gain <= 0.0 for gain in gains)
    return not len(gains) or (sum(gains) > 0.0 and losses <= math.ceil(len(gains) / 5))


def describe_effect(
    evidence: float, detectability: float, detection_threshold: float, *, named: bool, refused: bool = False
) -> str:
    """Describe in words the decision on an effect, which may be named or part of a refused claim."""
    if named:
        return "explains the error best"
    if refused or evidence > detection_threshold:
        return "would explain error, but is not named"
    if detectability < MIN_DETECTABILITY:
        return "too weak to be seen with these data"
    if detectability < RELIABLE_DETECTABILITY:
        return "not seen; a weak one could be missed"
    return "not seen; one of expected size would be"
