"""A calibrated model, its residuals and all that may explain them, as straight lines.

A score test looks at the model where calibration left it: how the prediction would change with what was
calibrated, with as much of each effect as is expected, and with errors of what was recorded. Residuals are
taken back to where calibrated parameters were expected, since their give is part of the null hypothesis.

Lines are drawn along EMG in the mean of the cycles of a speed. Along the recorded EMG they would hold its
noise, which residuals hold as well: what is like the bursts of a noisy envelope would then be found in
everyone (as in any regression on what is measured with error; Fuller 1987, doi:10.1002/9780470316665).
Residuals are taken back along the same lines. Along others, the difference of both would be left in them: a
little noise, times the long way to where parameters were expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.calibrate import Objective
from wrapjax.gap.context import Context
from wrapjax.gap.effect import Effect, Effects
from wrapjax.gap.evidence.covariance import InputErrors, MuscleErrors
from wrapjax.gap.evidence.cycle_noise import CycleNoise, cycle_noise
from wrapjax.gap.evidence.error_signatures import angle_errors, emg_errors, muscle_errors
from wrapjax.gap.evidence.expectations import expectations
from wrapjax.gap.evidence.projection import Candidate
from wrapjax.gap.prediction import secants
from wrapjax.model import ModelParameters, Recording, joint_moments, muscle_states
from wrapjax.muscle import EmgSpline

#: Phases of a gait cycle that are looked at: residuals change little between them.
PHASES = 25


@dataclass(frozen=True)
class LinearGap:
    """What a score test takes in; signatures lead with what they are by, then ``cycle coordinate phase``.

    Parameters
    ----------
    residual
        Measured less predicted moments, N m, at the expected values of what was calibrated.
    fitted
        The same as calibration left it.
    slopes
        By each calibrated variable, in solver units.
    spread, away
        What is expected of these variables: see `expectations`.
    nuisances
        By each amount of the effects that are always allowed for, one prior standard deviation of it.
    candidates
        The effects that may be named.
    input_errors
        Of EMG and of angles.
    muscle_errors
        At one unit of normalised force.
    speeds
        Which speed each cycle was walked at, counted from 0 for the slowest.
    """

    residual: Float[np.ndarray, "cycle coordinate phase"]
    fitted: Float[np.ndarray, "cycle coordinate phase"]
    slopes: Float[np.ndarray, "variable cycle coordinate phase"]
    spread: Float[np.ndarray, "variable sum"]
    away: Float[np.ndarray, " variable"]
    nuisances: Float[np.ndarray, "amount cycle coordinate phase"]
    candidates: tuple[Candidate, ...]
    input_errors: tuple[InputErrors, ...]
    muscle_errors: MuscleErrors
    speeds: Int[np.ndarray, " cycle"]

    @cached_property
    def noise(self) -> CycleNoise:
        """What is new in each cycle, and how large errors of inputs are."""
        return cycle_noise(self.fitted, self.speeds, self.input_errors)

    @property
    def input_variance(self) -> Float[np.ndarray, "coordinate phase"]:
        """What errors of EMG and of angles make of the moments, in the mean of cycles, (N m)^2."""
        total = np.zeros(self.fitted.shape[1:])
        for share, errors in zip(self.noise.input_shares, self.input_errors, strict=True):
            total += share**2 * np.sum(errors.signatures**2, axis=0).mean(axis=0)
        return total

    @property
    def calibrated(self) -> Float[np.ndarray, "sum cycle coordinate phase"]:
        """By independent sums of calibrated variables, one prior standard deviation of each."""
        return np.tensordot(self.spread.T, self.slopes, axes=1)


def linear_gap(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    measured: Float[np.ndarray, "trial coordinate frame"],
    context: Context,
    effects: Sequence[Effect],
) -> LinearGap:
    """Draw all straight lines at a calibrated model.

    Parameters
    ----------
    problem, variables
        What was calibrated, and where it ended. Only what is variable, and its priors, count here.
    recording, measured, context
        Of the cycles that are looked at, which need not be those of the problem.
    effects
        Those that this recording can show.
    """
    parameters = problem.parameters(variables)
    frames = phase_frames(measured.shape[-1])
    curves = problem.curves

    def at_phases(values: Float[Array | np.ndarray, "*any frame"]) -> Float[np.ndarray, "*any phase"]:
        return np.asarray(values)[..., frames]

    speeds = speed_numbers(context.speeds)
    quiet = replace(recording, emg=in_the_mean(recording.emg, speeds))
    states = muscle_states(curves, parameters, quiet)
    by_variable = moment_slopes(problem, variables, quiet, frames)
    expected, away = expectations(problem, variables)
    fitted = at_phases(measured - np.asarray(joint_moments(curves, parameters, recording)))
    candidates, nuisances = [], [np.zeros((0, *fitted.shape))]
    for effect in effects:
        own = _candidate(effect, problem, parameters, quiet, frames)
        if effect.nuisance:
            nuisances += [
                (variant * own.prior_sd[:, None]).reshape(-1, *fitted.shape) for variant in own.variants
            ]
        else:
            candidates.append(own)
    return LinearGap(
        residual=fitted + np.tensordot(away, by_variable, axes=1),
        fitted=fitted,
        slopes=by_variable,
        spread=expected,
        away=away,
        nuisances=np.concatenate(nuisances),
        candidates=tuple(candidates),
        input_errors=(
            emg_errors(problem, variables, by_variable, context),
            *angle_errors(problem, parameters, quiet, context, frames),
        ),
        muscle_errors=muscle_errors(states, parameters, frames),
        speeds=speeds,
    )


def in_the_mean(emg: EmgSpline, speeds: Int[np.ndarray, " cycle"]) -> EmgSpline:
    """Take the mean of every envelope over the cycles of each speed, at the same part of the cycle."""
    alike = jnp.asarray(speeds[:, None] == speeds[None], dtype=float)
    mean = jnp.einsum("ct,mtpi->mcpi", alike / alike.sum(axis=1, keepdims=True), emg.coefficients)
    return replace(emg, coefficients=mean)


def phase_frames(frames: int) -> Int[np.ndarray, " phase"]:
    """Pick frames at equal distances round the cycle, whose last frame is its first; no frame twice."""
    phases = min(PHASES, frames - 1)
    return np.round(np.arange(phases) * (frames - 1) / phases).astype(int)


def speed_numbers(speeds: Float[np.ndarray, " cycle"]) -> Int[np.ndarray, " cycle"]:
    """Number speeds from the slowest; cycles of unknown speed count as of one."""
    known = np.unique(speeds[np.isfinite(speeds)])
    return np.where(np.isfinite(speeds), np.searchsorted(known, speeds), len(known)).astype(int)


def moment_slopes(
    problem: Objective,
    variables: Float[Array, " variable"],
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Float[np.ndarray, "variable cycle coordinate phase"]:
    """Differentiate predicted moments by the variables, muscle by muscle, over this recording (N m)."""
    shape = recording.path.nominal.moment_arm.shape[1:]
    own = Objective(
        curves=problem.curves,
        recording=recording,
        measured=jnp.zeros(shape),
        variables=problem.variables,
        penalties=(),
        limits=(),
        # Rows are then moments in N m.
        moment_error=np.array(1.0 / np.sqrt(np.prod(shape))),
    )
    return np.asarray(jax.jit(Objective.moment_jacobian)(own, variables)).T.reshape(-1, *shape)[..., frames]


def _candidate(
    effect: Effect,
    problem: Objective,
    parameters: ModelParameters,
    recording: Recording,
    frames: Int[np.ndarray, " phase"],
) -> Candidate:
    variants = []
    for number in range(len(effect.variants)):
        found = secants(problem.curves, parameters, recording, Effects((effect,), (number,)))
        variants.append(np.asarray(found)[..., frames].reshape(len(effect.parameters), -1))
    return Candidate(
        effect.id,
        tuple(variants),
        np.array([entry.prior_sd for entry in effect.parameters]),
        np.array([entry.sign == 1 for entry in effect.parameters]),
        effect.parts,
        np.array([entry.limit for entry in effect.parameters]),
    )
