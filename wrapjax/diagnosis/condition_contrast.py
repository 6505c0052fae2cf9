"""What differs between two conditions of one person: a score test on the contrast of their residuals.

At each speed that both conditions have, the contrast is the mean residual of the cycles of the first
condition less that of the second. Errors of the model that are the same in both cancel in it: of the person's
parameters, of muscle forces in similar states, and any error that repeats in both. What is left is what
differs, and an effect of one condition alone changes the contrast by its mean signature there.

Under the null hypothesis that nothing differs, cycles of a speed are exchangeable between the conditions. The
detection threshold is therefore that of the strongest evidence for any effect in contrasts of randomly
reassigned cycles. Their deviations from the mean of their own condition are reassigned, so that a difference
that is present does not raise the threshold (Freedman & Lane 1983, doi:10.2307/1391660).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from wrapjax.diagnosis.effects.effect import Effect, NotTestable
from wrapjax.diagnosis.error_sources import Matrix, periodic_kernel
from wrapjax.diagnosis.linearization import Candidate, LinearizedModel
from wrapjax.diagnosis.null_covariance import (
    EXPECTED_FORCE_ERROR,
    EXPECTED_REPEATABLE_ERROR,
    FORCE_ERRORS,
    REPEATABLE_ERRORS,
    REPEATABLE_WIDTH,
    Null,
    fixed_covariance,
    muscle_covariance,
)
from wrapjax.diagnosis.score_test import Score, project, score_projected
from wrapjax.subject.subject import Subject

#: Share of reassignments whose strongest evidence exceeds the detection threshold.
FALSE_ALARM_RATE = 0.05
#: Smallest detection threshold, nats: odds of 20 to 1.
LEAST_THRESHOLD = 3.0
#: Number of random reassignments of cycles.
REASSIGNMENTS = 60
#: Correlation between the conditions of a smooth repeatable error without a name.
ACROSS_CONDITIONS = 0.95
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
    """

    difference: Float[np.ndarray, "speed coordinate phase"]
    scores: tuple[Score, ...]
    directions: tuple[Direction, ...]
    maxima: Float[np.ndarray, " reassignment"]
    threshold: float
    explained: float
    predicted: Float[np.ndarray, "speed coordinate phase"]
    noise: Float[np.ndarray, " coordinate"]


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
    covariances = _Covariances(linearized, speeds, measured_moment_sd)
    generator = np.random.default_rng(seed)
    rows = contrast_rows(speeds, is_first)
    candidates, directions = _candidates(linearized, rows, is_first)
    # As the calibration left them: the distance from the prior mean is a part of the null covariance.
    deviations = _deviations(linearized.fitted_residual, linearized.speeds)
    residuals = [_apply(rows, linearized.residual).ravel()]
    for _ in range(REASSIGNMENTS):
        assigned = contrast_rows(speeds, _reassigned(speeds, is_first, generator))
        residuals.append(_apply(assigned, deviations).ravel())
    projections = [project(np.array(residuals), null, candidates) for null in covariances.nulls(rows)]
    tests = score_projected(projections, candidates)
    test = tests[0].scores
    maxima = [max((one.evidence for one in other.scores), default=0.0) for other in tests[1:]]
    order = np.argsort([-one.evidence for one in test])
    scores = tuple(test[place] for place in order)
    kinds = tuple(directions[place] for place in order)
    threshold = max(LEAST_THRESHOLD, float(np.quantile(maxima, 1.0 - FALSE_ALARM_RATE)))
    difference = _apply(rows, linearized.fitted_residual)
    predicted = _signal(linearized, rows, is_first, scores[0], kinds[0])
    return Contrast(
        difference=difference,
        scores=scores,
        directions=kinds,
        maxima=np.array(maxima),
        threshold=threshold,
        explained=_explained_elsewhere(linearized, covariances, speeds, is_first, kinds[0], generator),
        predicted=predicted,
        noise=np.sqrt(_noise_variance(linearized, rows).mean(axis=(0, 2))),
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


def _apply(
    rows: Float[np.ndarray, "speed cycle"], values: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*contrast"]:
    """Compute the contrasts of values with the axes ``cycle coordinate phase`` last."""
    return np.asarray(np.einsum("sc,...ckp->...skp", rows, values))


class _Covariances:
    """Null covariances of all cycles, by the sizes of unexplained errors, from which contrasts follow."""

    def __init__(
        self,
        linearized: LinearizedModel,
        speeds: Int[np.ndarray, " cycle"],
        measured_moment_sd: Float[np.ndarray, " coordinate"],
    ):
        self.shape = linearized.residual.shape
        self.fixed = self._split(fixed_covariance(linearized))
        self.by_force = self._split(muscle_covariance(linearized.muscle_errors))
        # What is left of a repeatable error in a contrast, at one speed.
        share = 2.0 * (1.0 - ACROSS_CONDITIONS)
        sd = np.asarray(measured_moment_sd, dtype=float)
        kernel = np.kron(np.diag(sd**2), periodic_kernel(self.shape[2], REPEATABLE_WIDTH))
        self.repeatable = share * kernel

    def _split(self, covariance: Matrix) -> Float[np.ndarray, "cycle own cycle_2 own_2"]:
        cycles, coordinates, phases = self.shape
        own = coordinates * phases
        return covariance.reshape(cycles, own, cycles, own)

    def nulls(self, rows: Float[np.ndarray, "speed cycle"]) -> Iterator[Null]:
        """Compute the covariance of a contrast by each null hypothesis."""
        fixed, by_force = (
            np.einsum("sc,ckdl,td->sktl", rows, part, rows, optimize=True)
            for part in (self.fixed, self.by_force)
        )
        count, own = fixed.shape[:2]
        size = count * own
        repeatable = np.kron(np.eye(count), self.repeatable)
        for force, error in product(FORCE_ERRORS, REPEATABLE_ERRORS):
            log_prior = -force / EXPECTED_FORCE_ERROR - error / EXPECTED_REPEATABLE_ERROR
            total = fixed + force**2 * by_force
            covariance = total.reshape(size, size) + error**2 * repeatable
            # Rounding must not make it indefinite where little is left of the common errors.
            covariance = 0.5 * (covariance + covariance.T)
            covariance += 1e-9 * np.trace(covariance) / size * np.eye(size)
            yield Null(covariance, log_prior)


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
                own = _apply(rows, variant.reshape(-1, *shape) * mask)
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
    covariances: _Covariances,
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
        candidates, directions = _candidates(linearized, rows, is_first)
        if direction not in directions:
            continue
        chosen = candidates[directions.index(direction)]
        residual = _apply(rows, linearized.residual).reshape(1, -1)
        projections = [project(residual, null, (chosen,)) for null in covariances.nulls(rows)]
        (test,) = score_projected(projections, (chosen,))
        predicted = _signal(linearized, other, is_first, test.scores[0], direction)
        observed = _apply(other, linearized.fitted_residual)
        fitted = _apply(rows, linearized.fitted_residual)
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


def strongest(scores: Sequence[Score], threshold: float, within: float = 3.0) -> tuple[int, ...]:
    """Return the numbers of the scores above the threshold and within some nats of the strongest."""
    if not scores or scores[0].evidence <= threshold:
        return ()
    least = max(threshold, scores[0].evidence - within)
    return tuple(number for number, one in enumerate(scores) if one.evidence > least)


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
        """Effects above the threshold and within 3 nats of the strongest, the strongest first."""
        chosen = strongest(self.contrast.scores, self.contrast.threshold)
        return tuple((self.contrast.scores[place], self.contrast.directions[place]) for place in chosen)

    @property
    def outcome(self) -> str:
        """``none`` if no effect of one condition is above the threshold, ``named`` for one, else ``tie``."""
        names = {direction.id for _, direction in self.leading}
        return ("none", "named", "tie")[min(len(names), 2)]
