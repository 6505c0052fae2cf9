"""A diagnosis from a calibrated model to its result: certificate, where, which, how far."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from wrapjax.gap.catalogue import catalogue, effects_in
from wrapjax.gap.conclude.conclusion import conclude, stopped
from wrapjax.gap.conclude.verdict import Tuning
from wrapjax.gap.effect import Effects
from wrapjax.gap.evidence.cycle_noise import cycle_noise
from wrapjax.gap.evidence.linearized import linear_gap, phase_frames
from wrapjax.gap.evidence.null import nulls
from wrapjax.gap.evidence.score import score_each
from wrapjax.gap.evidence.twins import TwinWorld, twin_residuals
from wrapjax.gap.fits.held_out import cross_fit
from wrapjax.gap.fits.refit import joint_problem
from wrapjax.gap.result import GapResult
from wrapjax.gap.scene import Investigation, Scene
from wrapjax.gap.stopwatch import Stopwatch
from wrapjax.gap.where.place import amount_weight, certificate_of, where

#: Fewest calibration cycles at any one speed.
FEWEST_CYCLES = 3


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
    watch = Stopwatch(tell, dict(seconds or {}))
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
    place = where(residual, case.speeds, case.context.speeds, case.inputs, gap.input_variance)
    sizes = case.measured[plan.calibration].std(axis=(0, 2))
    with watch.during("twins", f"making {twins} people with nothing amiss"):
        world = TwinWorld(problem, ended, inputs, gap, gap.noise)
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
