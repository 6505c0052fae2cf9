"""Claim of a diagnosis: a decision on effects, held to the four gates.

A claim that fails a gate becomes a tie, a family or ``unknown``; never another name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.claims.decision import (
    MIN_PROBABILITY,
    Decision,
    DecisionConstants,
    probabilities_of_refused,
    tie_of_strongest,
    with_probabilities,
)
from wrapjax.diagnosis.claims.gates import (
    MOST_DEVIATIONS,
    Adequate,
    Claim,
    Gates,
    Recorded,
    examine,
)
from wrapjax.diagnosis.effects.catalogue import family_of, family_probabilities, same_family
from wrapjax.diagnosis.evidence.linearization import LinearizedModel, parameter_prior
from wrapjax.diagnosis.evidence.score import Scores, effect_signatures
from wrapjax.diagnosis.fits.refit import Ids, Refit
from wrapjax.diagnosis.inputs.input import DiagnosisInput, phase_frames

#: Largest number of effects that a claim which parts of the recording contradict can list as a tie.
MOST_IN_TIE = 3


def examine_claim(
    data: DiagnosisInput,
    linearized: LinearizedModel,
    scores: Scores,
    null_residuals: Float[np.ndarray, "replicate row"],
    refits: Mapping[Ids, Refit],
    decision: Decision,
    constants: DecisionConstants,
    plain: Adequate,
) -> Decision:
    """Examine the claim of a decision, and return the decision that the gates allow.

    Parameters
    ----------
    data, linearized, scores, refits
        Results of the earlier steps.
    null_residuals
        Residuals of null replicates, N m.
    decision
        Decision by evidence.
    constants
        Constants of the decision.
    plain
        Whether the model without any effect leaves an error that is allowed.
    """
    decision = with_family(decision, scores.evidence, scores.detection_threshold)
    together, any_of = claimed_effects(decision, scores.evidence)
    if not together:
        return apply_gates(decision, Gates(plain), ())
    claim = Claim(
        together,
        any_of,
        _sizes(data, scores, refits, together),
        _residual_about_refit(data, linearized, scores, refits[together]) if together in refits else None,
    )
    gates = examine(linearized, scores, null_residuals, recorded_of(data), claim, constants.adequacy_factor)
    decision = apply_gates(decision, gates, decision.accepted or together)
    if not gates.failed:
        return decision
    stated = probabilities_of_refused(scores.evidence, plain.relative, constants)
    return with_probabilities(decision, stated, tie_of_strongest(scores), constants)


def recorded_of(data: DiagnosisInput) -> Recorded:
    """Select what the gates need of the recording."""
    frames, context = phase_frames(data.measured.shape[-1]), data.calibration_context
    return Recorded(
        np.asarray(context.angles)[..., frames],
        np.asarray(context.velocities)[..., frames],
        data.plan.blocks,
        data.measured_moment_sd,
    )


def with_family(decision: Decision, evidence: Mapping[str, float], detection_threshold: float) -> Decision:
    """Claim a family where no effect is named, but its effects together are probable and one is significant.

    Parameters
    ----------
    decision
        Decision by evidence.
    evidence, detection_threshold
        Evidence of each effect, and that which has to be exceeded, nats.
    """
    if decision.accepted or decision.probabilities is None:
        return decision
    shares = family_probabilities(decision.probabilities.effects)
    family = max(shares, key=lambda id: shares[id], default="")
    strongest = next(iter(evidence), None)
    if strongest is None or evidence[strongest] <= detection_threshold or shares[family] < MIN_PROBABILITY:
        return decision
    if family_of(strongest) != family or decision.outcome == "unknown":
        # The decision has found a reason against the strongest effect.
        return decision
    reason = "effects of one family explain the error; the recording does not tell which of them"
    return replace(decision, outcome="family", reason=reason, family=family)


def claimed_effects(
    decision: Decision, evidence: Mapping[str, float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """List the effects of a claim that are fitted together, and those of which one has to come first.

    See `gates.Claim`; both are empty where nothing is claimed.
    """
    if decision.named:
        return decision.named, decision.named
    members = decision.tie or tuple(
        id for id in evidence if decision.family and family_of(id) == decision.family
    )
    strongest = max(members, key=lambda id: evidence[id], default=None)
    return (() if strongest is None else (strongest,)), members


def apply_gates(decision: Decision, gates: Gates, claimed: Sequence[str]) -> Decision:
    """Return what the gates leave of a decision.

    Parameters
    ----------
    decision
        Decision by evidence, or the claim of a family.
    gates
        Examined gates.
    claimed
        Effects whose claim was examined; empty where none was.
    """
    decision = replace(decision, gates=gates)
    if not claimed:
        if decision.outcome == "none" and not gates.adequate.passed:
            return replace(
                decision,
                outcome="unknown",
                reason="the model leaves more repeatable error than null replicates have",
            )
        return decision
    failed = gates.failed
    names = ", ".join(claimed)
    if "adequate" in failed:
        reason = (
            f"with {names} in the model, a repeatable error of {gates.adequate.left_rms:.1f} N m is left; "
            f"up to {gates.adequate.floor_rms:.1f} N m is allowed"
        )
        return _unknown(decision, claimed, reason)
    if gates.plausible is not None and "plausible" in failed:
        size = gates.plausible
        unit = "" if size.unit == "1" else f" {size.unit}"
        named = size.name.replace(" ", ": ", 1)
        reason = f"{named} would have to be {size.value:.3g}{unit}; up to {size.limit:.3g}{unit} is plausible"
        return _unknown(decision, claimed, reason)
    if gates.specific is not None and "specific" in failed:
        reason = f"{names} predicts unseen cycles no better than effects without a mechanism do"
        return _unknown(decision, claimed, reason)
    if gates.stable is not None and "stable" in failed:
        return _contradicted(decision, tuple(dict.fromkeys((*claimed, *gates.stable.leaders))), claimed)
    return decision


def _contradicted(decision: Decision, leaders: tuple[str, ...], claimed: Sequence[str]) -> Decision:
    """Claim what all parts of the recording have in common."""
    if same_family(leaders):
        reason = "parts of the recording put different effects of one family first"
        family = family_of(leaders[0])
        return replace(decision, outcome="family", reason=reason, named=(), tie=(), family=family)
    if decision.named and len(leaders) <= MOST_IN_TIE:
        reason = "parts of the recording put one or another of these effects first"
        return replace(decision, outcome="tie", reason=reason, named=(), tie=leaders, family="")
    return _unknown(decision, claimed, "parts of the recording put different effects first")


def _unknown(decision: Decision, claimed: Sequence[str], reason: str) -> Decision:
    return replace(
        decision,
        outcome="unknown",
        reason=reason,
        named=(),
        tie=(),
        family="",
        best_partial=tuple(claimed),
    )


def _residual_about_refit(
    data: DiagnosisInput, linearized: LinearizedModel, scores: Scores, refit: Refit
) -> Float[np.ndarray, "cycle coordinate phase"]:
    """Compute the residual at the prior mean and without the effects, linearised about a refit, N m."""
    frames = phase_frames(data.measured.shape[-1])
    variables = data.law.with_free_law(refit.fit.calibrated)
    _, from_prior_mean = parameter_prior(data.law.free, variables)
    signatures = np.concatenate([effect_signatures(linearized, scores.by_id[id]) for id in refit.ids])
    return (
        refit.residual[..., frames]
        + np.tensordot(from_prior_mean, linearized.slopes, axes=1)
        + np.tensordot(refit.fit.effect_sizes, signatures, axes=1)
    )


def _sizes(
    data: DiagnosisInput,
    scores: Scores,
    refits: Mapping[Ids, Refit],
    together: Ids,
) -> tuple[tuple[str, float, float, str], ...]:
    """List name, value, limit and unit of the sizes of effects fitted together; see `gates.Claim`."""
    refit = refits.get(together)
    sizes: list[tuple[str, float, float, str]] = []
    place = 0
    for id in together:
        score = scores.by_id[id]
        part = list(score.part)
        values = score.effect_sizes[part]
        if refit is not None:
            values = refit.fit.effect_sizes[place : place + len(part)]
            place += len(part)
        parameters = [data.calibration_effects[id].parameters[number] for number in part]
        sizes += [
            (
                f"{id} {one.name}",
                float(value),
                float(min(one.limit, MOST_DEVIATIONS * one.prior_sd)),
                one.unit,
            )
            for one, value in zip(parameters, values, strict=True)
        ]
    return tuple(sizes)
