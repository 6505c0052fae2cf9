"""Four gates that a claim has to pass before it is made: adequate, plausible, stable, specific.

Evidence grows with the misfit of the model, so that the surest names are given where most is unexplained. A
claim is therefore examined for what evidence does not show: whether the model with the claimed effects is as
good as models of people with nothing else amiss, whether the effect sizes are those of people, whether parts
of the recording say the same, and whether the effect predicts unseen cycles better than a sham does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from wrapjax.diagnosis.claims.residual_fit import (
    ResidualModel,
    ScaledSignatures,
    UnseenCycles,
    repeatable_rms,
)
from wrapjax.diagnosis.claims.sham_effects import scaled_like, sham_effects
from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.evidence.score import Scores, concerns_single_cycles, effect_signatures
from wrapjax.diagnosis.evidence.score_test import Score, project, score_projected
from wrapjax.diagnosis.null_hypotheses.null_covariance import nulls

#: Quantile of null replicates, and of sham effects, beyond which a claim fails.
LEVEL = 0.95
#: Smallest share of the parts of a recording that have to agree with the claim.
AGREEMENT = 0.8
#: Largest effect size in prior standard deviations, and share of the limit at which a size counts as at it.
MOST_DEVIATIONS, AT_LIMIT = 3.0, 0.99
#: Accuracy of joint moments by inverse dynamics, relative to the standard deviation of the measured moments:
#: a smaller error says nothing of the model. A choice; what makes moments of gait uncertain is reviewed by
#: Camomilla et al. 2017, doi:10.1186/s12938-017-0396-x.
MOMENT_ACCURACY = 0.04
#: Evidence (nats) by which another effect has to lead a part of a recording to contradict a claim; strong
#: evidence by Kass & Raftery 1995 (doi:10.1080/01621459.1995.10476572).
CONTRADICTION = 3.0
# Cycles below which one at a time is left out; cycles of a part of the recording that can be scored.
_FEW_CYCLES, _FEWEST = 6, 3
# Nulls less plausible than the most plausible one by this many nats are omitted in parts of the recording.
_NEGLIGIBLE = 4.0


@dataclass(frozen=True)
class Adequate:
    """Whether the repeatable error that is left is within what null replicates leave.

    Parameters
    ----------
    left_rms
        Root mean square of the repeatable error with the claimed effects, N m.
    floor_rms
        95th percentile of that of null replicates, fitted with the same effects, times a factor that was
        found on people with nothing amiss (`DecisionConstants.adequacy_factor`), N m; not less than the
        accuracy of the measured moments (`moment_accuracy`).
    """

    left_rms: float
    floor_rms: float

    @property
    def relative(self) -> float:
        """Error that is left, relative to what is allowed."""
        return self.left_rms / self.floor_rms

    @property
    def passed(self) -> bool:
        """Whether the gate is passed."""
        return self.left_rms <= self.floor_rms


@dataclass(frozen=True)
class Plausible:
    """Whether all effect sizes are within their published ranges and three prior standard deviations.

    Parameters
    ----------
    name, value, limit, unit
        Effect size that is nearest to its limit or farthest beyond it, with that limit, in this unit.
    """

    name: str
    value: float
    limit: float
    unit: str = "1"

    @property
    def passed(self) -> bool:
        """Whether the gate is passed."""
        return abs(self.value) < AT_LIMIT * self.limit


@dataclass(frozen=True)
class Stable:
    """Whether parts of the recording put the same effect first, alone or in a tie.

    Parameters
    ----------
    agreement
        Share of the parts that do not contradict the claim.
    first
        Strongest claimed effect of each part that agrees, and strongest effect of each part that contradicts
        the claim, by the name of the part.
    """

    agreement: float
    first: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether the gate is passed."""
        return self.agreement >= AGREEMENT

    @property
    def leaders(self) -> tuple[str, ...]:
        """Strongest effects of the parts, the most frequent first."""
        return tuple(id for id, _ in Counter(self.first.values()).most_common())


@dataclass(frozen=True)
class Specific:
    """Whether the effect shrinks the error on unseen cycles more than sham effects do.

    Effects of single cycles cannot be predicted in unseen cycles, and are not held to this gate.

    Parameters
    ----------
    shrinkage
        Share of the mean square error on unseen cycles that the claimed effects remove, by linearised fits.
        The error is relative to its standard deviation, and contains the noise of those cycles.
    sham_shrinkage
        95th percentile of the same of sham effects.
    """

    shrinkage: float
    sham_shrinkage: float

    @property
    def passed(self) -> bool:
        """Whether the gate is passed."""
        return self.shrinkage > self.sham_shrinkage


@dataclass(frozen=True)
class Gates:
    """Figures of all gates; those that concern a claimed effect are None where none is claimed."""

    adequate: Adequate
    plausible: Plausible | None = None
    stable: Stable | None = None
    specific: Specific | None = None

    @property
    def of_claim(self) -> bool:
        """Whether an effect was claimed, and not the plain model alone examined."""
        return self.plausible is not None

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the gates that are not passed."""
        return tuple(name for name, gate in vars(self).items() if gate is not None and not gate.passed)


@dataclass(frozen=True)
class Claim:
    """Claim that is examined.

    Parameters
    ----------
    together
        Identifiers of the effects that are fitted together: all that are named; of a tie or a family, the
        strongest, since its members replace one another. Empty where nothing is claimed.
    any_of
        Effects of which one has to come first in parts of the recording: those named, or all members.
    sizes
        Name, value, limit and unit of each effect size of ``together``; the limit is the smaller one of the
        published range and three prior standard deviations.
    residual
        Residual at the prior mean of all parameters and without the effects, linearised about the fit of
        ``together``, N m; None to linearise about the baseline fit. An effect that is large is not linear.
    """

    together: tuple[str, ...] = ()
    any_of: tuple[str, ...] = ()
    sizes: tuple[tuple[str, float, float, str], ...] = ()
    residual: Float[np.ndarray, "cycle coordinate phase"] | None = None


@dataclass(frozen=True)
class Recorded:
    """Angles (rad), velocities (rad/s) and moments of the recording, and blocks of cycles to leave out."""

    angles: Float[np.ndarray, "cycle coordinate phase"]
    velocities: Float[np.ndarray, "cycle coordinate phase"]
    blocks: Sequence[Int[np.ndarray, " _"]]
    measured_moment_sd: Float[np.ndarray, " coordinate"]


def adequacy_of_plain_model(
    linearized: LinearizedModel,
    null_residuals: Float[np.ndarray, "replicate row"],
    measured_moment_sd: Float[np.ndarray, " coordinate"],
    factor: float,
) -> Adequate:
    """Compare the repeatable error that the model without any effect leaves with what is allowed.

    Parameters
    ----------
    linearized
        Linearised model.
    null_residuals
        Residuals of null replicates, N m.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate, N m.
    factor
        See `Adequate`.
    """
    none = np.zeros((0, *linearized.residual.shape))
    model, accuracy = ResidualModel.of(linearized), moment_accuracy(measured_moment_sd)
    return adequacy(model, linearized, null_residuals, none, factor, accuracy)


def examine(
    linearized: LinearizedModel,
    scores: Scores,
    null_residuals: Float[np.ndarray, "replicate row"],
    recorded: Recorded,
    claim: Claim,
    adequacy_factor: float,
) -> Gates:
    """Examine a claim of at least one effect.

    Parameters
    ----------
    linearized, scores
        Linearised model, and scores of all effects.
    null_residuals
        Residuals of null replicates, N m.
    recorded
        Angles, velocities and blocks of the cycles.
    claim
        What would be claimed.
    adequacy_factor
        See `Adequate`.
    """
    model = ResidualModel.of(linearized)
    signatures = np.concatenate([scaled_signatures(linearized, scores.by_id[id]) for id in claim.together])
    about_fit = linearized if claim.residual is None else replace(linearized, residual=claim.residual)
    accuracy = moment_accuracy(recorded.measured_moment_sd)
    adequate = adequacy(model, about_fit, null_residuals, signatures, adequacy_factor, accuracy)
    return Gates(
        adequate,
        plausibility(claim.sizes),
        stability(
            with_other_tasks(
                part_scores(linearized, recorded.measured_moment_sd), scores.added_by_other_tasks
            ),
            claim.any_of,
            scores.detection_threshold,
        ),
        specificity(model, linearized, recorded, signatures),
    )


def adequacy(
    model: ResidualModel,
    linearized: LinearizedModel,
    null_residuals: Float[np.ndarray, "replicate row"],
    signatures: ScaledSignatures,
    factor: float = 1.0,
    accuracy: float = 0.0,
) -> Adequate:
    """Compare the repeatable error that is left with that of null replicates, fitted in the same way.

    Parameters
    ----------
    model, linearized
        Model of the residual without effects, and the linearised model.
    null_residuals
        Residuals of null replicates, N m.
    signatures
        Signatures of one prior standard deviation of the claimed effects, N m.
    factor, accuracy
        See `Adequate`.
    """
    residuals = np.concatenate(
        [linearized.residual[None], null_residuals.reshape(-1, *linearized.residual.shape)]
    )
    own, *others = repeatable_rms(model.adding(signatures).fit(residuals), linearized.speeds)
    if not others:
        return Adequate(float(own), np.inf)
    return Adequate(float(own), max(factor * float(np.quantile(others, LEVEL)), accuracy))


def moment_accuracy(measured_moment_sd: Float[np.ndarray, " coordinate"]) -> float:
    """Compute the accuracy of the measured moments as a root mean square over coordinates, N m."""
    return MOMENT_ACCURACY * float(np.sqrt(np.mean(np.square(measured_moment_sd))))


def plausibility(sizes: Sequence[tuple[str, float, float, str]]) -> Plausible:
    """Find the effect size that is largest relative to its limit.

    Parameters
    ----------
    sizes
        Name, value and limit of each effect size, in its unit.
    """
    if not sizes:
        return Plausible("", 0.0, np.inf)
    return Plausible(*max(sizes, key=lambda one: abs(one[1]) / one[2]))


def part_scores(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]
) -> dict[str, tuple[Score, ...]]:
    """Score all effects again on parts of the recording, by the name of the part.

    Parts are odd and even cycles of each speed (all but one cycle, one after the other, where there are fewer
    than six), each speed, and all coordinates but one.

    Parameters
    ----------
    linearized
        Linearised model.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate, N m.
    """
    return {
        name: score_part(linearized.restricted(cycles, coordinates), measured_moment_sd[coordinates])
        for name, (cycles, coordinates) in recording_parts(linearized).items()
    }


def with_other_tasks(
    parts: Mapping[str, Sequence[Score]], added: Mapping[str, float]
) -> dict[str, tuple[Score, ...]]:
    """Add the evidence of other tasks to that of each part of the gait; these tasks are not divided."""
    return {
        name: tuple(replace(one, evidence=one.evidence + added.get(one.id, 0.0)) for one in scores)
        for name, scores in parts.items()
    }


def stability(
    parts: Mapping[str, Sequence[Score]], any_of: Sequence[str], detection_threshold: float
) -> Stable:
    """Compare the strongest effects of parts of a recording with a claim.

    A part agrees where a claimed effect has the strongest
    evidence, or less by no more than `CONTRADICTION`. It contradicts the claim where another effect leads by
    more and exceeds the detection threshold. Parts that could not show any of the claimed effects, and those
    that show no effect, say nothing and are left out.

    Parameters
    ----------
    parts
        Scores of all effects on each part.
    any_of
        Identifiers of the effects of which one has to come first.
    detection_threshold
        Evidence that few null replicates exceed, nats.
    """
    first = {}
    for name, scores in parts.items():
        claimed = [score for score in scores if score.id in any_of]
        if not any(score.detectable for score in claimed):
            continue
        leader, best = (max(some, key=lambda one: one.evidence) for some in (scores, claimed))
        if leader.evidence - best.evidence <= CONTRADICTION:
            first[name] = best.id
        elif leader.evidence > detection_threshold:
            first[name] = leader.id
    agreement = float(np.mean([id in any_of for id in first.values()])) if first else 0.0
    return Stable(agreement, first)


def recording_parts(
    linearized: LinearizedModel,
) -> dict[str, tuple[Int[np.ndarray, " cycle"], Int[np.ndarray, " coordinate"]]]:
    """List the cycles and coordinates of each part of a recording, by its name; see `part_scores`."""
    cycles, coordinates, _ = linearized.residual.shape
    all_cycles, all_coordinates = np.arange(cycles), np.arange(coordinates)
    speeds = linearized.speeds
    parts = {}
    if cycles < _FEW_CYCLES:
        for cycle in all_cycles:
            parts[f"without cycle {cycle + 1}"] = (np.delete(all_cycles, cycle), all_coordinates)
    else:
        turn = np.array([np.sum(speeds[:place] == speed) for place, speed in enumerate(speeds)])
        for name, rest in (("even cycles", 1), ("odd cycles", 0)):
            parts[name] = (np.flatnonzero(turn % 2 == rest), all_coordinates)
    known = np.unique(speeds)
    for number, speed in enumerate(known if len(known) > 1 else ()):
        if np.sum(speeds == speed) >= _FEWEST:
            parts[f"speed {number + 1}"] = (np.flatnonzero(speeds == speed), all_coordinates)
    for place in all_coordinates if coordinates > 1 else ():
        parts[f"without coordinate {place + 1}"] = (all_cycles, np.delete(all_coordinates, place))
    return parts


def score_part(
    linearized: LinearizedModel, measured_moment_sd: Float[np.ndarray, " coordinate"]
) -> tuple[Score, ...]:
    """Score all effects against the plausible nulls."""
    residual = linearized.residual.reshape(1, -1)
    weights = [project(residual, null, ()).weight[0] for null in nulls(linearized, measured_moment_sd)]
    projections = [
        project(residual, null, linearized.candidates)
        for weight, null in zip(weights, nulls(linearized, measured_moment_sd), strict=True)
        if weight > max(weights) - _NEGLIGIBLE
    ]
    (test,) = score_projected(projections, linearized.candidates)
    return test.scores


def specificity(
    model: ResidualModel,
    linearized: LinearizedModel,
    recorded: Recorded,
    signatures: ScaledSignatures,
) -> Specific | None:
    """Compare the shrinkage of the error on unseen cycles by an effect with that by sham effects.

    None for an effect each of whose parameters concerns a single cycle.

    Parameters
    ----------
    model, linearized
        Model of the residual without effects, and the linearised model.
    recorded
        Angles, velocities and blocks of the cycles.
    signatures
        Signatures of one prior standard deviation of the effect, N m.
    """
    if concerns_single_cycles(signatures):
        return None
    drawn = sham_effects(len(signatures), recorded.angles, recorded.velocities, linearized.muscle_errors.arms)
    shams = [model.whitened(scaled_like(one, signatures, model)) for one in drawn]
    cycles = UnseenCycles(model.columns, model.whitened(linearized.residual[None])[..., 0], recorded.blocks)
    nothing = np.zeros((*shams[0].shape[:2], 0))
    before, after, *of_shams = cycles.errors([nothing, model.whitened(signatures), *shams])
    return Specific(
        float((before - after) / before),
        float(np.quantile((before - np.array(of_shams)) / before, LEVEL)),
    )


def scaled_signatures(linearized: LinearizedModel, score: Score) -> ScaledSignatures:
    """Return the signatures of one prior standard deviation, N m; see `effect_signatures`."""
    candidate = next(one for one in linearized.candidates if one.id == score.id)
    sd = candidate.scaled_prior_sd(max(score.prior_factor, 1.0))[list(score.part)]
    return effect_signatures(linearized, score) * sd[:, None, None, None]
