"""From evidence to probabilities, ties and an outcome, with constants tuned where the truth was known."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.special import expit, logsumexp

#: Below this both ways, in squared standard deviations, two effects cannot be told apart.
TIE = 9.0
#: Within so many nats of the first, an effect that cannot be told from it is as good as it.
LEVEL_WITH = 5.0
#: Of what is named, or of a tie, together.
LEAST_PROBABILITY = 0.5
#: In standard deviations, of an effect of expected size.
UNSEEN, WEAK = 2.0, 5.0


@dataclass(frozen=True)
class DecisionConstants:
    """Constants from cases with known truth, of a simulator that shares nothing with the model.

    Parameters
    ----------
    bank, sha256
        Which one.
    temperature
        Nats by which evidence is too bold.
    offset
        Evidence, in nats, at which an effect is as probable as none.
    alarm
        Evidence that is rarely exceeded where nothing is amiss.
    structured_offset, structured_scale
        Evidence (nats) for structured error at which something unknown is as probable as nothing, and over
        which that changes.
    set_level
        Probability that a credible set holds, so that it covers 90 %.
    """

    bank: str
    sha256: str
    temperature: float
    offset: float
    detection_threshold: float
    structured_offset: float
    structured_scale: float
    set_level: float

    @classmethod
    def shipped(cls) -> DecisionConstants:
        """Read the constants that come with the package."""
        text = (
            resources.files("wrapjax.diagnosis")
            .joinpath("decision_constants.json")
            .read_text(encoding="utf-8")
        )
        return cls(**json.loads(text))


@dataclass(frozen=True)
class Probabilities:
    """Of each effect, of nothing amiss, and of what is not in the catalogue: their sum is 1."""

    effects: dict[str, float]
    none: float
    unknown: float


def probabilities(
    evidence: Mapping[str, float], structured: float, constants: DecisionConstants
) -> Probabilities:
    """Temper evidence.

    Parameters
    ----------
    evidence
        In nats, by effect.
    structured
        Evidence for errors that no effect is known for.
    tuning
        How bold evidence is.
    """
    names = list(evidence)
    logits = np.array([*(evidence[name] for name in names), constants.offset]) / constants.temperature
    share = np.exp(logits - logsumexp(logits))
    unknown = float(expit((structured - constants.structured_offset) / constants.structured_scale))
    silent = float(share[-1])
    return Probabilities(
        dict(zip(names, share[:-1].tolist(), strict=True)), silent * (1.0 - unknown), silent * unknown
    )


def tie_of(
    first: str,
    names: Sequence[str],
    apart: Float[np.ndarray, "effect effect"],
    evidence: Mapping[str, float],
) -> tuple[str, ...]:
    """Gather what cannot be told from the first: every pair of members is tied, for a chain is no tie.

    Parameters
    ----------
    first
        The most probable effect.
    names
        Of rows and columns.
    apart
        How much of each effect (row) each other one (column) cannot imitate.
    evidence
        In nats.
    """
    members = [first]
    for name in sorted(names, key=lambda one: -evidence[one]):
        if name in members or evidence[first] - evidence[name] > LEVEL_WITH:
            continue
        places = [names.index(member) for member in members]
        own = names.index(name)
        if all(max(apart[own, place], apart[place, own]) < TIE for place in places):
            members.append(name)
    return tuple(members)


def credible_set(found: Probabilities, tie: Sequence[str], level: float) -> tuple[str, ...]:
    """Gather the fewest that hold this probability; a tie comes as one, and silence as ``none_of_these``."""
    silent = found.none + found.unknown
    classes = [(tuple(tie), sum(found.effects[name] for name in tie))] if tie else []
    classes += [((name,), share) for name, share in found.effects.items() if name not in tie]
    classes.append((("none_of_these",), silent))
    members: list[str] = []
    held = 0.0
    for names, share in sorted(classes, key=lambda one: -one[1]):
        if held >= level:
            break
        members += names
        held += share
    return tuple(members)


@dataclass(frozen=True)
class Verdict:
    """What is said in the end; see `OUTCOMES`."""

    outcome: str
    reason: str
    named: tuple[str, ...] = ()
    tie: tuple[str, ...] = ()


def judge(
    found: Probabilities,
    evidence: Mapping[str, float],
    tie: Sequence[str],
    detection_threshold: float,
    controls: Sequence[str],
    unseen: Sequence[str] = (),
    gains: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> Verdict:
    """Say it, or say nothing.

    Parameters
    ----------
    found, evidence
        By effect.
    tie
        The most probable effect, and what cannot be told from it.
    alarm
        Evidence that has to be exceeded, nats.
    controls
        Ids that cannot be at work in such a recording: if one leads, something else is.
    unseen
        Ids that this recording could not show if they were as large as they may be: none of them is named.
    gains
        By effect that was fitted, what each block of cycles that its fit has not seen says for it, in nats.
        What is there helps in four of five: of blocks that are single cycles two of eight may say nothing.
    """
    first = tie[0] if tie else None
    together = sum(found.effects[name] for name in tie)
    stands_out = first is not None and evidence[first] > detection_threshold and together >= LEAST_PROBABILITY
    if stands_out and first in unseen:
        return Verdict(
            "unknown",
            f"{first} would explain most, but this recording could not show it if it were there",
        )
    if first is not None and stands_out:
        if first in controls:
            return Verdict(
                "unknown",
                f"what looks like {first} cannot be at work in such a recording: something else is amiss",
            )
        if not _helps(gains.get(first, ())):
            return Verdict("unknown", f"{first} would explain most, but does not help with cycles kept back")
        if len(tie) == 1:
            return Verdict("named", "one effect explains the error best", named=(first,))
        return Verdict("tie", "this recording cannot tell these effects apart", tie=tuple(tie))
    if found.unknown > found.none:
        return Verdict("unknown", "there is structured error that no effect of the catalogue explains")
    return Verdict("none", "nothing stands out against what is left where nothing is amiss")


def may_be_several(verdict: Verdict, together: Sequence[str], excluded: Sequence[str]) -> bool:
    """Say whether effects that stand together may be named in place of what was said of single ones.

    Parameters
    ----------
    verdict
        Of single effects.
    together
        From `standing_together`.
    excluded
        Controls, and what this recording could not show.
    """
    if not together or set(together) & set(excluded):
        return False
    # One may have hidden the other; but what was said of a tie or of a control stays said.
    return verdict.named[0] in together if verdict.named else verdict.outcome == "none"


def each_helps(together: Sequence[str], gains: Mapping[tuple[str, ...], Sequence[float]]) -> bool:
    """Say whether each of several effects helps with cycles kept back, beside the others.

    Parameters
    ----------
    together
        Ids.
    gains
        By ids that were fitted together, in that order: what each block of cycles says for them, in nats.
    """
    whole = gains[tuple(together)]
    for one in together:
        others = tuple(id for id in together if id != one)
        if not _helps([more - less for more, less in zip(whole, gains[others], strict=True)]):
            return False
    return True


def several(together: Sequence[str]) -> Verdict:
    """Name several effects."""
    return Verdict("named", "these effects explain the error together", named=tuple(together))


def _helps(gains: Sequence[float]) -> bool:
    """Say whether an effect helps with cycles kept back: in the sum, and in four blocks of five."""
    against = sum(gain <= 0.0 for gain in gains)
    return not len(gains) or (sum(gains) > 0.0 and against <= math.ceil(len(gains) / 5))


def decision(evidence: float, detectability: float, detection_threshold: float, named: bool) -> str:
    """Put into words what to make of one effect."""
    if named:
        return "explains the error best"
    if detectability < UNSEEN:
        return "not testable with these data"
    if evidence > detection_threshold:
        return "would explain error, but others do better"
    if detectability < WEAK:
        return "not seen; a weak one could be missed"
    return "not seen; one of expected size would be"
