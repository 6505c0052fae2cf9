"""What differs between two conditions of one person: a score test on the contrast of their residuals.

At each speed that both conditions have, the contrast is the mean residual of the cycles of the first
condition less that of the second. Errors of the model that are the same in both cancel in it: of the person's
parameters, of muscle forces in similar states, and any error that repeats in both. What is left is what
differs, and an effect of one condition alone changes the contrast by its mean signature there.

The test is given the mean of both conditions, see `wrapjax.diagnosis.conditions.contrast_nulls`.

Under the null hypothesis that nothing differs, cycles of a speed are exchangeable between the conditions. The
detection threshold is therefore that of the strongest evidence for any effect in contrasts of randomly
reassigned cycles. Their deviations from the mean of their own condition are reassigned, so that a difference
that is present does not raise the threshold (Freedman & Lane 1983, doi:10.2307/1391660). The same contrasts
say how much an effect that explains the difference may leave of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.conditions.contrast_nulls import (
    ContrastNulls,
    remaining_after,
    weighted_sums,
    with_means,
)
from wrapjax.diagnosis.effects.effect import Effect, NotTestable
from wrapjax.diagnosis.evidence.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.evidence.score_test import Score
from wrapjax.subject.subject import Subject

#: Share of reassignments whose strongest evidence exceeds the detection threshold.
FALSE_ALARM_RATE = 0.05
#: Smallest detection threshold, nats: odds of 20 to 1.
LEAST_THRESHOLD = 3.0
#: Number of random reassignments of cycles.
REASSIGNMENTS = 60
#: Relative error of the form of an effect. Effects explain a difference about as well as the strongest if
#: they have less evidence by at most `TIE` nats more than such an error of the strongest leaves unexplained,
#: which is twice its square times the evidence.
FORM_ERROR, TIE = 0.3, 3.0
#: Least share of the difference that a named effect explains on cycles that its size was not determined on.
LEAST_EXPLAINED = 0.25
#: Least power of the difference, in standard deviations by noise of independent phases, for a share of it.
LEAST_POWER = 3.0
#: Parts into which the cycles of each condition are divided, to predict each part from the others.
FOLDS = 4


@dataclass(frozen=True)
class Direction:
    """One hypothesis of a contrast: the effect is present in one condition alone.

    Parameters
    ----------
    id
        Identifier of the effect.
    first
        Whether the effect is present in the first condition, not in the second. Always so for effects that
        have no sign.
    """

    id: str
    first: bool


@dataclass(frozen=True)
class Contrast:
    """Difference of two conditions, and the evidence for each effect of one of them alone.

    Parameters
    ----------
    difference
        Mean residual of the first condition less that of the second at each common speed, as the calibration
        of both together left it, N m.
    scores
        Score of each effect in each condition alone, the strongest evidence first.
    directions
        Which effect and condition each score is of.
    maxima
        Strongest evidence in each reassignment of the cycles, nats.
    threshold
        Detection threshold, nats.
    explained
        Share of the difference above noise that the strongest effect explains on cycles that its size was not
        determined on; NaN where the difference does not exceed noise.
    predicted
        Contribution of the strongest effect to the difference, N m.
    noise
        Standard deviation of the difference by cycle noise alone, N m.
    remaining, allowed_remaining
        Mean square of the difference without the strongest effect, or with it if no effect is above the
        threshold, in variances of the null hypothesis; and the largest of a reassignment of the cycles.
    """

    difference: Float[np.ndarray, "speed coordinate phase"]
    scores: tuple[Score, ...]
    directions: tuple[Direction, ...]
    maxima: Float[np.ndarray, " reassignment"]
    threshold: float
    explained: float
    predicted: Float[np.ndarray, "speed coordinate phase"]
    noise: Float[np.ndarray, " coordinate"]
    remaining: float
    allowed_remaining: float

    @property
    def strongest(self) -> tuple[int, ...]:
        """Numbers of the scores above the threshold that are not clearly weaker than the strongest."""
        if not self.scores or self.scores[0].evidence <= self.threshold:
            return ()
        most = self.scores[0].evidence
        least = max(self.threshold, most - TIE - 2.0 * FORM_ERROR**2 * most)
        return tuple(number for number, one in enumerate(self.scores) if one.evidence > least)

    @property
    def adequate(self) -> bool:
        """Whether chance explains what is left, and the strongest effect, if any, holds on other cycles."""
        confirmed = not self.strongest or self.explained >= LEAST_EXPLAINED
        return self.remaining <= self.allowed_remaining and confirmed


def compute_contrast(
    linearized: LinearizedModel,
    speeds: Int[np.ndarray, " cycle"],
    is_first: Bool[np.ndarray, " cycle"],
    measured_moment_sd: Float[np.ndarray, " coordinate"],
    seed: int = 0,
) -> Contrast:
    """Test every effect in one condition alone on the contrast of both.

    Parameters
    ----------
    linearized
        Linearised model over the cycles of both conditions, whose groups are speeds within conditions.
    speeds
        Speed number of each cycle.
    is_first
        Whether each cycle is of the first condition.
    measured_moment_sd
        Standard deviation of the measured moment of each coordinate, N m.
    seed
        Seed of the reassignments and of the division of cycles.
    """
    nulls = ContrastNulls(linearized, measured_moment_sd)
    generator = np.random.default_rng(seed)
    rows = contrast_rows(speeds, is_first)
    both = with_means(rows)
    candidates, directions = _candidates(linearized, both, is_first)
    # Within conditions: their means do not tell chance from effects.
    deviations = _deviations(linearized.fitted_residual, linearized.speeds)
    reassigned = [
        weighted_sums(contrast_rows(speeds, _reassigned(speeds, is_first, generator)), deviations).ravel()
        for _ in range(REASSIGNMENTS)
    ]
    residual = weighted_sums(both, linearized.residual).ravel()
    tests, given = nulls.score(rows, residual, np.array(reassigned), candidates)
    test = tests[0].scores
    maxima = [max((one.evidence for one in other.scores), default=0.0) for other in tests[1:]]
    order = np.argsort([-one.evidence for one in test])
    scores = tuple(test[place] for place in order)
    kinds = tuple(directions[place] for place in order)
    threshold = max(LEAST_THRESHOLD, float(np.quantile(maxima, 1.0 - FALSE_ALARM_RATE)))
    explaining = scores[0] if scores[0].evidence > threshold else None
    remaining = remaining_after(given, int(order[0]), explaining)
    difference = weighted_sums(rows, linearized.fitted_residual)
    predicted = _signal(linearized, rows, is_first, scores[0], kinds[0])
    return Contrast(
        difference=difference,
        scores=scores,
        directions=kinds,
        maxima=np.array(maxima),
        threshold=threshold,
        explained=_explained_elsewhere(linearized, nulls, speeds, is_first, kinds[0], generator),
        predicted=predicted,
        noise=np.sqrt(_noise_variance(linearized, rows).mean(axis=(0, 2))),
        remaining=float(remaining[0]),
        allowed_remaining=float(np.max(remaining[1:])),
    )


def contrast_rows(
    speeds: Int[np.ndarray, " cycle"], is_first: Bool[np.ndarray, " cycle"]
) -> Float[np.ndarray, "speed cycle"]:
    """Compute the weights of the cycles in the contrast at each speed that both conditions have."""
    rows = []
    for speed in np.unique(speeds):
        first, second = (speeds == speed) & is_first, (speeds == speed) & ~is_first
        if first.any() and second.any():
            rows.append(first / first.sum() - second / second.sum())
    return np.array(rows).reshape(len(rows), len(speeds))


def _candidates(
    linearized: LinearizedModel,
    rows: Float[np.ndarray, "speed cycle"],
    is_first: Bool[np.ndarray, " cycle"],
) -> tuple[tuple[Candidate, ...], tuple[Direction, ...]]:
    """Build the candidates of a contrast: each effect in the first condition alone, or in the second."""
    shape = linearized.residual.shape
    candidates, directions = [], []
    for candidate in linearized.candidates:
        # Without a sign, an effect in one condition is its opposite in the other.
        for first in (True, False) if candidate.one_sided.any() else (True,):
            mask = (is_first if first else ~is_first)[:, None, None]
            variants = []
            for variant in candidate.variants:
                own = weighted_sums(rows, variant.reshape(-1, *shape) * mask)
                variants.append(own.reshape(len(variant), -1))
            kept = tuple(one for one in variants if np.abs(one).max(initial=0.0) > 0.0)
            if kept:
                candidates.append(replace(candidate, variants=kept))
                directions.append(Direction(candidate.id, first))
    return tuple(candidates), tuple(directions)


def _reassigned(
    speeds: Int[np.ndarray, " cycle"], is_first: Bool[np.ndarray, " cycle"], generator: np.random.Generator
) -> Bool[np.ndarray, " cycle"]:
    """Assign the cycles of each speed to the conditions at random, as many to each as before."""
    assigned = is_first.copy()
    for speed in np.unique(speeds):
        own = np.flatnonzero(speeds == speed)
        assigned[own] = generator.permutation(is_first[own])
    return assigned


def _signal(
    linearized: LinearizedModel,
    rows: Float[np.ndarray, "speed cycle"],
    is_first: Bool[np.ndarray, " cycle"],
    score: Score,
    direction: Direction,
) -> Float[np.ndarray, "speed coordinate phase"]:
    """Compute the change of a contrast by an effect at its most plausible sizes, N m."""
    candidates, directions = _candidates(linearized, rows, is_first)
    own = candidates[directions.index(direction)]
    variant = own.variants[score.variant]
    return (score.effect_sizes @ variant).reshape(len(rows), *linearized.residual.shape[1:])


def _deviations(
    residual: Float[np.ndarray, "cycle coordinate phase"], groups: Int[np.ndarray, " cycle"]
) -> Float[np.ndarray, "cycle coordinate phase"]:
    """Compute deviations from the mean of each group, enlarged to the variance about the true mean, N m."""
    deviation = np.zeros(residual.shape)
    for group in np.unique(groups):
        own = groups == group
        count = int(own.sum())
        deviation[own] = np.sqrt(count / max(count - 1, 1)) * (residual[own] - residual[own].mean(axis=0))
    return deviation


def _noise_variance(
    linearized: LinearizedModel, rows: Float[np.ndarray, "speed cycle"]
) -> Float[np.ndarray, "speed coordinate phase"]:
    """Compute the variance of a contrast by cycle noise, from deviations within groups, (N m)^2."""
    variance = np.mean(_deviations(linearized.fitted_residual, linearized.speeds) ** 2, axis=0)
    return np.einsum("sc,kp->skp", rows**2, variance)


def _explained_elsewhere(
    linearized: LinearizedModel,
    nulls: ContrastNulls,
    speeds: Int[np.ndarray, " cycle"],
    is_first: Bool[np.ndarray, " cycle"],
    direction: Direction,
    generator: np.random.Generator,
) -> float:
    """Compute the share of the difference that the effect explains on cycles left out of its fit."""
    part = _parts(speeds, is_first, generator)
    removed = common = noise = 0.0
    for fold in np.unique(part):
        train, held = part != fold, part == fold
        rows, other = (_rows_of(speeds, is_first, keep) for keep in (train, held))
        if not len(rows) or len(rows) != len(other):
            continue
        both = with_means(rows)
        candidates, directions = _candidates(linearized, both, is_first)
        if direction not in directions:
            continue
        chosen = candidates[directions.index(direction)]
        residual = weighted_sums(both, linearized.residual).ravel()
        nothing = np.zeros((0, len(residual) // 2))
        ((test,), _) = nulls.score(rows, residual, nothing, (chosen,))
        predicted = _signal(linearized, other, is_first, test.scores[0], direction)
        observed = weighted_sums(other, linearized.fitted_residual)
        fitted = weighted_sums(rows, linearized.fitted_residual)
        removed += float(np.sum(observed**2) - np.sum((observed - predicted) ** 2))
        # Noise of the two parts is independent, so that their product is the power of the difference alone.
        common += float(np.sum(observed * fitted))
        variances = _noise_variance(linearized, other) * _noise_variance(linearized, rows)
        noise += float(np.sqrt(np.sum(variances)))
    return removed / common if common > LEAST_POWER * noise else float("nan")


def _parts(
    speeds: Int[np.ndarray, " cycle"], is_first: Bool[np.ndarray, " cycle"], generator: np.random.Generator
) -> Int[np.ndarray, " cycle"]:
    """Divide the cycles of each condition and speed into as many parts as the smallest group allows."""
    groups = [
        np.flatnonzero((speeds == speed) & (is_first == first))
        for speed in np.unique(speeds)
        for first in (True, False)
    ]
    folds = min(FOLDS, min(len(own) for own in groups if len(own)))
    part = np.zeros(len(speeds), dtype=int)
    for own in groups:
        part[own] = generator.permutation(np.arange(len(own)) % max(folds, 1))
    return part


def _rows_of(
    speeds: Int[np.ndarray, " cycle"], is_first: Bool[np.ndarray, " cycle"], keep: Bool[np.ndarray, " cycle"]
) -> Float[np.ndarray, "speed cycle"]:
    """Compute the weights of a contrast of some cycles, zero for the others."""
    chosen = np.flatnonzero(keep)
    own = contrast_rows(speeds[chosen], is_first[chosen])
    rows = np.zeros((len(own), len(speeds)))
    rows[:, chosen] = own
    return rows


@dataclass(frozen=True)
class DifferenceResult:
    """What differs between two conditions of one person.

    Parameters
    ----------
    subject
        Subject with the trials of both conditions.
    conditions
        Names of the condition that is compared, and of the one that it is compared with.
    cycles
        Number of calibration cycles of each condition at the speeds that both have.
    coordinates
        Names of the coordinates.
    speeds
        Speeds that both conditions have, m/s; NaN where unknown.
    measured_difference
        Mean measured moment of the first condition less that of the second, N m.
    contrast
        Difference of the residuals, and the evidence for each effect of one condition alone.
    effects
        Effects by id.
    not_testable
        Effects that cannot be tested, with reasons.
    """

    subject: Subject
    conditions: tuple[str, str]
    cycles: tuple[int, int]
    coordinates: tuple[str, ...]
    speeds: Float[np.ndarray, " speed"]
    measured_difference: Float[np.ndarray, "speed coordinate phase"]
    contrast: Contrast
    effects: dict[str, Effect]
    not_testable: tuple[NotTestable, ...]

    @property
    def leading(self) -> tuple[tuple[Score, Direction], ...]:
        """Effects that explain the difference about as well as the strongest does, the strongest first."""
        chosen = self.contrast.strongest
        return tuple((self.contrast.scores[place], self.contrast.directions[place]) for place in chosen)

    @property
    def outcome(self) -> str:
        """``named`` for one effect of one condition, ``tie`` for several.

        ``none`` where chance alone explains the difference; ``unknown`` where something differs and no effect
        explains it: more of it is left than chance explains, or the effect does not hold on other cycles.
        """
        if not self.contrast.adequate:
            return "unknown"
        names = {direction.id for _, direction in self.leading}
        return ("none", "named", "tie")[min(len(names), 2)]
