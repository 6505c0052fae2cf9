"""A diagnosis from a calibrated model to its result: certificate, where, which, how far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from wrapjax.diagnosis.case import DiagnosisInput, Look, Scene
from wrapjax.diagnosis.conclusion import conclude, stopped
from wrapjax.diagnosis.cycle_noise import cycle_noise
from wrapjax.diagnosis.effects.catalogue import catalogue, effects_in
from wrapjax.diagnosis.effects.effect import Effect, Effects
from wrapjax.diagnosis.held_out import cross_fit
from wrapjax.diagnosis.linearization import LinearizedModel, linearized_model, phase_frames
from wrapjax.diagnosis.null import nulls
from wrapjax.diagnosis.null_replicates import NullModel, null_replicate_residuals
from wrapjax.diagnosis.place import InputMade, convergence_check_of, effect_size_weight, where
from wrapjax.diagnosis.projection import project
from wrapjax.diagnosis.refit import joint_problem
from wrapjax.diagnosis.result import DiagnosisResult
from wrapjax.diagnosis.score import score_projected
from wrapjax.diagnosis.together import standing_together
from wrapjax.diagnosis.verdict import DecisionConstants
from wrapjax.model.forward import Recording
from wrapjax.progress import Stopwatch

#: Fewest calibration cycles at any one speed.
FEWEST_CYCLES = 3


def look(case: DiagnosisInput, watch: Stopwatch) -> Look:
    """Fit the plain model to parts of the cycles, and say where the error is: no effect is asked for.

    Parameters
    ----------
    case
        With enough cycles: see `FEWEST_CYCLES`.
    watch
        Says what is going on.
    """
    plan, problem = case.plan, case.problem
    with watch.during("plain_model", "fitting the plain model to parts of the cycles"):
        start = joint_problem(problem, Effects(()), case.variables, np.zeros(0), 0.0)
        plain = cross_fit(start, case.variables, plan, case.speeds, case.predict(Effects(())), case.kept)
        residual = case.measured - plain.predicted
        frames = phase_frames(residual.shape[-1])
        spread = cycle_noise(residual[plan.calibration][..., frames], plan.speeds)
        place = where(residual, case.speeds, case.context.speeds, case.inputs, spread.independent_values)
        weight = effect_size_weight(spread, len(plan.calibration))
        convergence_check = convergence_check_of(case.outcomes, plain, place, problem, plan, weight)
    return Look(plain, place, convergence_check, weight)


def linearize_effects(
    case: DiagnosisInput, variables: Float[np.ndarray, " variable"]
) -> tuple[Recording, tuple[Effect, ...], LinearizedModel]:
    """Give the calibration cycles, the effects that they can show, and all straight lines at the variables.

    Parameters
    ----------
    case
        What is looked at.
    variables
        Of its problem.
    """
    chosen = case.plan.calibration
    known, cycles = case.context.select(chosen.tolist()), case.recording.select_trials(chosen)
    effects = effects_in(catalogue(known, case.withheld))
    gap = linearized_model(
        case.problem, jnp.asarray(variables), cycles, case.measured[chosen], known, effects
    )
    return cycles, effects, gap


def investigate(
    case: DiagnosisInput,
    *,
    constants: DecisionConstants,
    null_replicates: int,
    seed: int = 0,
    seen: Look | None = None,
    log: Callable[[str], None] = lambda line: None,
    seconds: dict[str, float] | None = None,
) -> tuple[DiagnosisResult, Look | None]:
    """Say where the error is, which effect explains it best, and how far it shrinks.

    Parameters
    ----------
    case
        What to look at.
    tuning
        Constants of the verdict.
    twins, seed
        How many people with nothing amiss are made, and from what.
    seen
        What an earlier investigation of this case, with another catalogue, gave beside its result; its
        twins are taken, too.
    tell
        Called with a line at each step.
    seconds
        Of what was done before.

    Returns
    -------
    result, seen
        The second is None where cycles are too few to look.
    """
    watch = Stopwatch(log, dict(seconds or {}))
    plan, problem = case.plan, case.problem
    fewest = int(plan.counts.min()) if len(plan.counts) else 0
    if fewest < FEWEST_CYCLES:
        reason = (
            f"{fewest} calibration cycles at one speed; {FEWEST_CYCLES} are the fewest that show what repeats"
        )
        return stopped(case, "insufficient_data", reason, watch.seconds), None
    seen = seen or look(case, watch)
    if not seen.convergence_check.holds:
        return stopped(case, "not_converged", seen.convergence_check.problems[0], watch.seconds, seen), seen
    with watch.during("signatures", "drawing the signature of every effect"):
        ended = seen.plain.full.calibrated
        inputs, effects, gap = linearize_effects(case, ended)
    left = case.measured - seen.plain.predicted
    made = InputMade(gap.input_variance, np.diag(gap.noise.between))
    place = where(left, case.speeds, case.context.speeds, case.inputs, gap.noise.independent_values, made)
    sizes = case.measured_sizes
    if seen.null_replicates is None:
        with watch.during("twins", f"making {null_replicates} people with nothing amiss"):
            world = NullModel(problem, ended, inputs, gap, gap.noise)
            seen = replace(seen, null_replicates=null_replicate_residuals(world, null_replicates, seed))
    assert seen.null_replicates is not None
    with watch.during("score", "scoring effects"):
        residuals = np.concatenate([gap.residual.reshape(1, -1), seen.null_replicates])
        projections = [project(residuals, null, gap.candidates) for null in nulls(gap, sizes)]
        first, *of_null = score_projected(projections, gap.candidates)
    scene = Scene(
        case=case,
        effects={effect.id: effect for effect in effects},
        gap=gap,
        sizes=sizes,
        look=replace(seen, place=place),
        scored=first,
        strongest_of_null=np.array(
            [max((one.evidence for one in null_replicate.scores), default=0.0) for null_replicate in of_null]
        ),
        constants=constants,
    )
    with watch.during("score", "scoring effects beside one another"):
        own = [replace(one, weight=one.weight[:1], slope=one.slope[:1]) for one in projections]
        scene = replace(
            scene, together=standing_together(own, gap.candidates, scene.scores, scene.detection_threshold)
        )
    return conclude(scene, watch), seen
