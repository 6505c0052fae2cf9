"""Input of a diagnosis: a calibrated model, all recorded cycles, and the catalogue for the subject."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.augmented_lagrangian import LagrangianState
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.effects.catalogue import available_effects, catalogue
from wrapjax.diagnosis.effects.effect import Effect, Effects, NotTestable
from wrapjax.diagnosis.fits.cross_validation import CrossValidationPlan, PredictMoments, cross_validation_plan
from wrapjax.diagnosis.fits.muscle_law import MuscleLawFit
from wrapjax.diagnosis.fits.prediction import predicted_moments
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.io.store import Store
from wrapjax.model.forward import Recording

#: Number of equally spaced phases of the gait cycle at which residuals are scored.
PHASES = 25


def speed_numbers(speeds: Float[np.ndarray, " cycle"]) -> Int[np.ndarray, " cycle"]:
    """Assign numbers from 0 to speeds (m/s), the slowest first; unknown speeds (NaN) count as one speed."""
    known = np.unique(speeds[np.isfinite(speeds)])
    return np.where(np.isfinite(speeds), np.searchsorted(known, speeds), len(known)).astype(int)


def phase_frames(frames: int) -> Int[np.ndarray, " phase"]:
    """Select equally spaced frames of a cycle, whose last frame has the phase of the first; none twice."""
    phases = min(PHASES, frames - 1)
    return np.round(np.arange(phases) * (frames - 1) / phases).astype(int)


@dataclass(frozen=True)
class DiagnosisInput:
    """A calibrated model and all recorded cycles.

    Parameters
    ----------
    problem, variables
        Objective of the calibration of one leg over its calibration cycles, in their order, with held paths
        and the person's muscle law held; and the variables at which it ended.
    law
        Fit of the muscle law.
    calibrated, solver_state
        Objective of the calibration as it was, free paths included, and the state at which it ended.
    outcomes
        Result of each start of the calibration.
    recording, context
        Inputs of the forward model and context of the effects, over all cycles.
    entries
        Catalogue for this subject over all cycles: each effect, or why it is not testable.
    withheld
        Ids of effects left out of the catalogue on request.
    recordings, uses, time
        Recording, use and time (s) of each cycle.
    measured
        Measured moments of all cycles, N m.
    inputs
        Recorded quantities that may drive differences between cycles, in any units.
    cache
        Earlier fits; None: no fit is kept.
    """

    problem: Objective
    law: MuscleLawFit
    calibrated: Objective
    solver_state: LagrangianState
    variables: Float[np.ndarray, " variable"]
    outcomes: Sequence[Outcome]
    recording: Recording
    context: Context
    entries: Sequence[Effect | NotTestable]
    withheld: tuple[str, ...]
    recordings: tuple[str, ...]
    uses: tuple[str, ...]
    time: Float[np.ndarray, "cycle frame"]
    measured: Float[np.ndarray, "cycle coordinate frame"]
    inputs: Float[np.ndarray, "cycle input frame"]
    cache: Store | None = None

    @property
    def speeds(self) -> Int[np.ndarray, " cycle"]:
        """Speed number of each cycle, counted from 0."""
        return speed_numbers(self.context.speeds)

    @cached_property
    def plan(self) -> CrossValidationPlan:
        """Calibration cycles, and the blocks of them that are left out together."""
        return cross_validation_plan(self.uses, self.speeds)

    @cached_property
    def calibration_context(self) -> Context:
        """Context of the calibration cycles."""
        return self.context.select(self.plan.calibration.tolist())

    @cached_property
    def calibration_effects(self) -> dict[str, Effect]:
        """Testable effects on the calibration cycles, by id."""
        return {
            effect.id: effect
            for effect in available_effects(catalogue(self.calibration_context, self.withheld))
        }

    @cached_property
    def calibration_recording(self) -> Recording:
        """Inputs of the forward model over the calibration cycles."""
        return self.recording.select_trials(self.plan.calibration)

    @property
    def effects(self) -> dict[str, Effect]:
        """Testable effects on all cycles, by id."""
        return {effect.id: effect for effect in available_effects(self.entries)}

    @property
    def measured_moment_sd(self) -> Float[np.ndarray, " coordinate"]:
        """Standard deviation of the measured moments of the calibration cycles, N m."""
        return self.measured[self.plan.calibration].std(axis=(0, 2))

    def prediction(self, effects: Effects) -> PredictMoments:
        """Return the function that predicts the moments of all cycles with these effects."""

        def predict(
            variables: Float[np.ndarray, " variable"], effect_sizes: Float[np.ndarray, " effect_size"]
        ) -> Float[np.ndarray, "cycle coordinate frame"]:
            parameters = self.problem.parameters(jnp.asarray(variables))
            moments = predicted_moments(
                self.problem.curves, parameters, self.recording, effects, jnp.asarray(effect_sizes)
            )
            return np.asarray(moments)

        return predict

    def without(self, effects: Sequence[str]) -> DiagnosisInput:
        """Return this input with a catalogue without these effects, by their ids.

        Raises
        ------
        InputError
            If an id is not in the catalogue.
        """
        return replace(self, entries=catalogue(self.context, effects), withheld=tuple(effects))
