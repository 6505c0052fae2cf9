"""A diagnosis from a calibrated model to its result: certificate, where, which, how far."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from wrapjax.calibrate import Objective, Outcome
from wrapjax.gap.catalogue import catalogue, effects_in
from wrapjax.gap.conclusion import conclude, stopped
from wrapjax.gap.context import Context
from wrapjax.gap.cycle_noise import cycle_noise
from wrapjax.gap.effect import Effect, Effects, NotTestable
from wrapjax.gap.held_out import Plan, Predict, cross_fit, plan_of
from wrapjax.gap.linearized import linear_gap, phase_frames, speed_numbers
from wrapjax.gap.null import nulls
from wrapjax.gap.prediction import predicted_moments
from wrapjax.gap.refit import joint_problem
from wrapjax.gap.result import GapResult
from wrapjax.gap.scene import Scene
from wrapjax.gap.score import score_each
from wrapjax.gap.twins import TwinWorld, twin_residuals
from wrapjax.gap.verdict import Tuning
from wrapjax.gap.where import amount_weight, certificate_of, where
from wrapjax.model import Recording

#: Fewest calibration cycles at any one speed.
FEWEST_CYCLES = 3


@dataclass(frozen=True)
class Investigation:
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

    @property
    def speeds(self) -> Int[np.ndarray, " cycle"]:
        """Of all cycles, counted from 0."""
        return speed_numbers(self.context.speeds)

    @property
    def plan(self) -> Plan:
        """Which cycles are left out together."""
        return plan_of(self.uses, self.speeds)

    def predict(self, effects: Effects) -> Predict:
        """Give what predicts all cycles with these effects."""

        def predicted(
            variables: Float[np.ndarray, " variable"], amounts: Float[np.ndarray, " amount"]
        ) -> Float[np.ndarray, "cycle coordinate frame"]:
            parameters = self.problem.parameters(jnp.asarray(variables))
            found = predicted_moments(
                self.problem.curves, parameters, self.recording, effects, jnp.asarray(amounts)
            )
            return np.asarray(found)

        return predicted


@dataclass
class Watch:
    """Says what is going on, and how long it took."""

    tell: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def during(self, part: str, line: str) -> Iterator[None]:
        """Add the time of what is done within to a part of the work."""
        self.tell(line)
        began = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began


def investigate(
    case: Investigation,
    *,
    tuning: Tuning,
    twins: int,
    seed: int = 0,
    tell: Callable[[str], None] = lambda line: None,
    seconds: dict[str, float] | None = None,
) -> GapResult:
    """Say where the error is, which effect explains it best, and how far it shrinks.

    Parameters
    ----------
    case
        What to look at.
    tuning
        Constants of the verdict.
    twins, seed
        How many people with nothing amiss are made, and from what.
    tell
        Called with a line at each step.
    seconds
        Of what was done before.
    """
    watch = Watch(tell, dict(seconds or {}))
    plan, problem = case.plan, case.problem
    fewest = int(plan.counts.min()) if len(plan.counts) else 0
    if fewest < FEWEST_CYCLES:
        reason = (
            f"{fewest} calibration cycles at one speed; {FEWEST_CYCLES} are the fewest that show what repeats"
        )
        return stopped(case, "insufficient_data", reason, watch.seconds)
    nothing = Effects(())
    with watch.during("plain_model", "fitting the plain model to parts of the cycles"):
        start = joint_problem(problem, nothing, case.variables, np.zeros(0), 0.0)
        plain = cross_fit(start, case.variables, plan, case.speeds, case.predict(nothing))
    residual = case.measured - plain.predicted
    frames = phase_frames(residual.shape[-1])
    spread = cycle_noise(residual[plan.calibration][..., frames], plan.speeds)
    place = where(residual, case.speeds, case.context.speeds, case.inputs)
    weight = amount_weight(spread, residual[plan.calibration].shape[:2])
    certificate = certificate_of(case.outcomes, plain, place, problem, plan, weight)
    if not certificate.holds:
        return stopped(
            case, "not_converged", certificate.problems[0], watch.seconds, plain.predicted, place, certificate
        )
    with watch.during("signatures", "drawing the signature of every effect"):
        seen = case.context.select(plan.calibration.tolist())
        inputs = case.recording.of_trials(plan.calibration)
        effects = effects_in(catalogue(seen, case.withheld))
        ended = plain.full.calibrated
        gap = linear_gap(
            problem,
            jnp.asarray(ended),
            inputs,
            case.measured[plan.calibration],
            seen,
            effects,
            tuning.background,
        )
    sizes = case.measured[plan.calibration].std(axis=(0, 2))
    with watch.during("twins", f"making {twins} people with nothing amiss"):
        world = TwinWorld(problem, ended, inputs, gap, cycle_noise(gap.fitted, gap.speeds))
        others = twin_residuals(world, twins, seed)
    with watch.during("score", "scoring effects"):
        residuals = np.concatenate([gap.residual.reshape(1, -1), others])
        first, *of_twins = score_each(residuals, nulls(gap, sizes), gap.candidates)
    scene = Scene(
        case=case,
        effects={effect.id: effect for effect in effects},
        gap=gap,
        sizes=sizes,
        plain=plain,
        place=place,
        certificate=certificate,
        amount_weight=weight,
        scored=first,
        strongest_of_twins=np.array(
            [max((one.evidence for one in twin.scores), default=0.0) for twin in of_twins]
        ),
        tuning=tuning,
    )
    return conclude(scene, watch)
