"""Verification of refits: the error that they remove on held-out cycles, and whether speeds agree."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.objective import MOMENT_ERROR
from wrapjax.diagnosis.evidence.linearization import LinearizedModel
from wrapjax.diagnosis.fits.baseline import BaselineFit
from wrapjax.diagnosis.fits.cross_validation import CrossFit
from wrapjax.diagnosis.fits.joint_fit import effect_size_covariance
from wrapjax.diagnosis.fits.refit import Ids, Refit
from wrapjax.diagnosis.inputs.input import DiagnosisInput
from wrapjax.diagnosis.localization import Localization
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate, NoiseFloor, cycle_errors, shrinkage


@dataclass(frozen=True)
class ReleasedParameter:
    """A calibrated parameter before and after a refit with an effect.

    Parameters
    ----------
    label
        Label of the parameter: ``soleus_l.emg_scale``.
    before, after, sd
        Values without and with the effect, and prior standard deviation, in solver units.
    at_bound
        Whether it was at a bound before.
    """

    label: str
    before: float
    after: float
    sd: float
    at_bound: bool


@dataclass(frozen=True)
class VerifiedRefit:
    """Refit of one effect, or of several together, with its performance on held-out cycles.

    Parameters
    ----------
    ids
        Identifiers of the effects.
    predicted
        Joint moments, N m; every cycle from a fit that did not use it.
    held_out_cycles, held_out_speed
        Shrinkage on held-out cycles, and at a held-out speed.
    gains
        Increase of the log likelihood of each left-out block of cycles, nats; empty where such cycles do not
        test the effect.
    speed_conflict
        Squared difference of the effect sizes fitted to each speed, in squared standard deviations; a wrong
        mechanism usually needs different sizes. None with one speed.
    released
        Calibrated parameters before and after.
    """

    ids: Ids
    predicted: Float[np.ndarray, "cycle coordinate frame"]
    held_out_cycles: Estimate
    held_out_speed: Estimate
    gains: tuple[float, ...]
    speed_conflict: float | None
    released: tuple[ReleasedParameter, ...]


@dataclass(frozen=True)
class Verification:
    """Verified refits by the identifiers of their effects."""

    refits: dict[Ids, VerifiedRefit]

    @property
    def gains(self) -> dict[Ids, tuple[float, ...]]:
        """Increase of the log likelihood of each left-out block by each refit, nats."""
        return {ids: one.gains for ids, one in self.refits.items()}

    def joined(self, other: Verification) -> Verification:
        """Return the refits of both."""
        return Verification(self.refits | other.refits)


def verify(
    data: DiagnosisInput,
    baseline: BaselineFit,
    linearized: LinearizedModel,
    localization: Localization,
    refits: Mapping[Ids, Refit],
    of_single_cycles: Collection[str],
) -> Verification:
    """Compare refits with the baseline fit on held-out cycles.

    Parameters
    ----------
    data, baseline, linearized, localization
        Results of the earlier steps.
    refits
        Refits by the identifiers of their effects.
    of_single_cycles
        Effects that unseen cycles do not test; see `Scores.of_single_cycles`.
    """
    return Verification(
        {
            ids: _verify(
                data, baseline, linearized, localization.noise_floor, one, set(ids) <= set(of_single_cycles)
            )
            for ids, one in refits.items()
        }
    )


def _verify(
    data: DiagnosisInput,
    baseline: BaselineFit,
    linearized: LinearizedModel,
    floor: NoiseFloor,
    refit: Refit,
    of_single_cycles: bool,
) -> VerifiedRefit:
    plan, speeds, fit = data.plan, data.speeds, refit.cross_fit
    before, after = cycle_errors(baseline.residual), cycle_errors(data.measured - fit.predicted)
    validation = np.array([use != "calibration" for use in data.uses]) & ~plan.new_speed
    # With few validation cycles, the calibration cycles that were left out one by one count as well.
    enough = len(plan.counts) and validation.sum() >= 2 * len(plan.counts)
    counted = validation if enough else ~plan.new_speed
    if of_single_cycles:
        reason = "each effect size concerns one cycle alone, and other cycles do not test it"
        held_out_cycles = held_out_speed = Estimate.unknown(reason)
        gains: tuple[float, ...] = ()
    else:
        held_out_cycles = shrinkage(before[counted], after[counted], floor.of(counted), speeds[counted])
        held_out_speed = _shrinkage_at_other_speed(data, baseline.fit, fit, floor)
        gains = _gains(data, baseline, before - after)
    return VerifiedRefit(
        ids=refit.ids,
        predicted=fit.predicted,
        held_out_cycles=held_out_cycles,
        held_out_speed=held_out_speed,
        gains=gains,
        speed_conflict=speed_conflict(fit, baseline.effect_size_weight),
        released=_released_parameters(data, baseline, linearized, fit),
    )


def _gains(
    data: DiagnosisInput, baseline: BaselineFit, decrease: Float[np.ndarray, " cycle"]
) -> tuple[float, ...]:
    """Convert decreases of the mean squared error, block by block, to nats; see `effect_size_weight`."""
    plan = data.plan
    scale = MOMENT_ERROR**2 * baseline.effect_size_weight * len(plan.calibration)
    by_cycle = 0.5 * decrease / scale
    return tuple(float(np.sum(by_cycle[plan.calibration[block]])) for block in plan.blocks)


def _shrinkage_at_other_speed(
    data: DiagnosisInput, baseline: CrossFit, fit: CrossFit, floor: NoiseFloor
) -> Estimate:
    if baseline.at_other_speed is None or fit.at_other_speed is None:
        return Estimate.unknown("one speed was recorded")
    new_speed = data.plan.new_speed
    counted = new_speed if new_speed.any() else np.ones(len(data.uses), dtype=bool)
    before, after = (
        cycle_errors(data.measured - np.asarray(one.at_other_speed))[counted] for one in (baseline, fit)
    )
    return shrinkage(before, after, floor.of(counted), data.speeds[counted])


def _released_parameters(
    data: DiagnosisInput, baseline: BaselineFit, linearized: LinearizedModel, fit: CrossFit
) -> tuple[ReleasedParameter, ...]:
    """Compare calibrated parameters without and with the effects, which release them from compensating.

    The linearised model gives their prior standard deviations.
    """
    problem, before = data.problem, baseline.variables
    at_bound = (before <= np.asarray(problem.lower)) | (before >= np.asarray(problem.upper))
    rows = zip(
        problem.variables.labels,
        before,
        fit.full.calibrated,
        # The parameters of the muscle law, which fits hold, come last.
        linearized.parameter_sd[: len(before)],
        at_bound,
        strict=True,
    )
    return tuple(
        ReleasedParameter(label, float(old), float(new), float(sd), bool(held))
        for label, old, new, sd, held in rows
    )


def speed_conflict(fit: CrossFit, effect_size_weight: float) -> float | None:
    """Compute the squared difference of effect sizes fitted to two speeds, in squared standard deviations.

    It is the mean over effect sizes, and the largest of all pairs of speeds; None with one speed or without
    effects.
    """
    count = len(fit.full.problem.effect_size_sd)
    if len(fit.of_speeds) < 2 or not count:
        return None
    by_speed = [
        (of_speed.effect_sizes, effect_size_covariance(of_speed, effect_size_weight))
        for of_speed in fit.of_speeds
    ]
    largest = 0.0
    for number, (effect_sizes, covariance) in enumerate(by_speed):
        for other_sizes, other_covariance in by_speed[:number]:
            difference = effect_sizes - other_sizes
            distance = difference @ np.linalg.solve(covariance + other_covariance, difference)
            largest = max(largest, float(distance) / count)
    return largest


def shapley_values(members: Sequence[str], removed: Callable[[Ids], float]) -> dict[str, float]:
    """Distribute what several effects remove together: mean over the orders in which they can be added.

    Parameters
    ----------
    members
        Identifiers of the effects.
    removed
        Function that returns what a subset removes, in the order of the members; also called for none.
    """
    count = len(members)
    worth = {part: removed(part) for size in range(count + 1) for part in combinations(members, size)}
    shares = {}
    for member in members:
        total = 0.0
        for part, value in worth.items():
            if member not in part:
                joined = tuple(name for name in members if name in part or name == member)
                weight = factorial(len(part)) * factorial(count - len(part) - 1) / factorial(count)
                total += weight * (worth[joined] - value)
        shares[member] = total
    return shares
