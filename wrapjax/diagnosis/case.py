"""What an investigation looks at, and what is known once effects are scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from wrapjax.calibration.objective import Objective
from wrapjax.calibration.solvers.checkpoints import SolveCache
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.diagnosis.context import Context
from wrapjax.diagnosis.effects.effect import Effect, Effects, NotTestable
from wrapjax.diagnosis.held_out import CrossFit, Plan, Predict, plan_of
from wrapjax.diagnosis.linearization import LinearizedModel, speed_numbers
from wrapjax.diagnosis.place import Where
from wrapjax.diagnosis.prediction import predicted_moments
from wrapjax.diagnosis.projection import Candidate
from wrapjax.diagnosis.result import ConvergenceCheck
from wrapjax.diagnosis.score import Score, Scored
from wrapjax.diagnosis.verdict import DecisionConstants
from wrapjax.model.forward import Recording

#: Share of people with nothing amiss whose strongest evidence is above the alarm level.
FALSE_ALARM_RATE = 0.025


@dataclass(frozen=True)
class DiagnosisInput:
    """A calibrated model and all that was recorded.

    Parameters
    ----------
    problem, variables
        The calibration of one leg, with held paths, over its calibration cycles in their order, and where
        it ended.
    outcomes
        Where each start led.
    recording, context
        Over all cycles.
    entries
        The catalogue for this subject.
    withheld
        Ids that were left out of it.
    recordings, uses, time
        Of all cycles; the first names the recording that each is from.
    measured
        Their moments, N m.
    inputs
        What may drive differences between cycles, any units.
    kept
        Fits that were done before; without it none is kept.
    """

    problem: Objective
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
    kept: SolveCache | None = None

    @property
    def speeds(self) -> Int[np.ndarray, " cycle"]:
        """Of all cycles, counted from 0."""
        return speed_numbers(self.context.speeds)

    @property
    def plan(self) -> Plan:
        """Which cycles are left out together."""
        return plan_of(self.uses, self.speeds)

    @property
    def measured_sizes(self) -> Float[np.ndarray, " coordinate"]:
        """Standard deviations of the calibration cycles' measured moments, N m."""
        return self.measured[self.plan.calibration].std(axis=(0, 2))

    def predict(self, effects: Effects) -> Predict:
        """Give what predicts all cycles with these effects."""

        def predicted(
            variables: Float[np.ndarray, " variable"], effect_sizes: Float[np.ndarray, " amount"]
        ) -> Float[np.ndarray, "cycle coordinate frame"]:
            parameters = self.problem.parameters(jnp.asarray(variables))
            found = predicted_moments(
                self.problem.curves, parameters, self.recording, effects, jnp.asarray(effect_sizes)
            )
            return np.asarray(found)

        return predicted


@dataclass(frozen=True)
class Look:
    """What the plain model leaves of the moments, before any effect is thought of.

    Parameters
    ----------
    plain
        Its fits to parts of the cycles.
    place
        Where the error is that they leave.
    certificate
        Whether they are good enough.
    amount_weight
        What a squared prior standard deviation of an effect's amount costs in a refit.
    twins
        Residuals of people with nothing amiss (see `null_replicate_residuals`); None until they are made.
    """

    plain: CrossFit
    place: Where
    convergence_check: ConvergenceCheck
    effect_size_weight: float
    null_replicates: Float[np.ndarray, "twin row"] | None = None


@dataclass(frozen=True)
class Scene:
    """What is known once effects are scored.

    Parameters
    ----------
    case
        What is looked at.
    effects
        By id, over the calibration cycles.
    gap, sizes
        Straight lines, and standard deviations of measured moments (N m).
    look
        What the plain model leaves.
    scored, strongest_of_twins
        Of the subject, and the strongest evidence in each person with nothing amiss.
    tuning
        Constants of the verdict.
    together
        Effects that each stand out beside the others (see `standing_together`).
    """

    case: DiagnosisInput
    effects: dict[str, Effect]
    gap: LinearizedModel
    sizes: Float[np.ndarray, " coordinate"]
    look: Look
    scored: Scored
    strongest_of_null: Float[np.ndarray, " twin"]
    constants: DecisionConstants
    together: tuple[str, ...] = ()

    @property
    def detection_threshold(self) -> float:
        """Evidence (nats) that has to be exceeded: rarely seen where nothing is amiss, here or elsewhere."""
        null_replicates = self.strongest_of_null
        own = float(np.quantile(null_replicates, 1.0 - FALSE_ALARM_RATE)) if len(null_replicates) else 0.0
        return max(self.constants.detection_threshold, own)

    @property
    def candidates(self) -> dict[str, Candidate]:
        """By id."""
        return {candidate.id: candidate for candidate in self.gap.candidates}

    @property
    def scores(self) -> dict[str, Score]:
        """By id, the strongest evidence first."""
        return {one.id: one for one in sorted(self.scored.scores, key=lambda one: -one.evidence)}
