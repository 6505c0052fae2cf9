"""``fit_wraps``: learn how a subject's muscle paths follow the cylinders that they wrap round."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from wrapjax.api.paths.exact import WRAPPINGS
from wrapjax.api.paths.fit_result import Fit, read_fit
from wrapjax.api.paths.fitting import fit_poses
from wrapjax.api.paths.muscle_learning import LearnedMuscle, MuscleLearner, stack_inner_levels
from wrapjax.api.paths.wrap_fit import WrapFit, WrapQuality
from wrapjax.api.paths.wrap_sources import EngineSource, OpenSimSource, PathSource
from wrapjax.errors import InputError
from wrapjax.files import cache_folder, content_hash
from wrapjax.geometry import Feasibility, feasibility_quality, fit_feasibility
from wrapjax.geometry.engine import GEODESIC, ExactPaths, PosedPath, nominal_parameters, wrap_at_samples
from wrapjax.geometry.physiological import DEFAULT_THRESHOLDS, PhysiologicalThresholds
from wrapjax.geometry.wrap_boxes import translation_bounds, usable_by_all
from wrapjax.geometry.wrap_samples import plan_samples
from wrapjax.osim import describe_model
from wrapjax.precision import require_float64
from wrapjax.progress import progress_bar, say
from wrapjax.subject import Subject

# Poses that boxes are found in: every so many recorded frames.
_EVERY = 4
# Raise when the same fit would get another inner level.
_FORMAT = 4


def fit_wraps(
    subject: Subject,
    fit: Fit,
    *,
    thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS,
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Sample all cylinders of a fit's muscles and learn what PGA needs of them.

    1000 placements, within a box for each cylinder, are analysed in the fit's 500 training poses. Those
    that leave a path physiological show how its coefficients follow its cylinders; all of them, where in
    its box each cylinder is physiological. 250 other placements, in those and 500 other poses, judge both.

    Parameters
    ----------
    subject, fit
        A fit of this subject. Its geometry is sampled; what jumps and touches the exact engine says.
    thresholds
        What counts as physiological.
    processes
        Worker processes for OpenSim, and threads of scikit-learn; by default one a core or more.
    quiet
        Print no progress.

    Returns
    -------
    Fit
        The same, with ``wraps``, and with the errors of wrapped muscles on unseen placements. Also kept
        in the user's cache. Analyses by OpenSim take long, and are kept as they come: interrupted
        work goes on where it stopped.

    Raises
    ------
    InputError
        If a muscle's path has something that the exact engine does not know.
    """
    require_float64()
    cached = cache_folder("fit_wraps") / content_hash(fit.key, repr(thresholds), _FORMAT)
    if (cached / "fit.json").exists():
        try:
            return read_fit(cached)
        except (InputError, OSError):
            say(f"the cached fit in {cached} cannot be read and is made again", quiet=quiet)
    result = _fit_wraps(subject, fit, thresholds, processes, quiet)
    result.keep(cached)
    return result


def _fit_wraps(
    subject: Subject, fit: Fit, thresholds: PhysiologicalThresholds, processes: int | None, quiet: bool
) -> Fit:
    began = time.perf_counter()
    model, surrogate = describe_model(subject.model_file), fit.surrogate
    wrapped = [name for name in surrogate.muscles if model.muscle(name).wraps]
    engine = ExactPaths(model, wrapped, surrogate.coordinates)
    wraps_of = {name: own for name in wrapped if (own := engine.wraps_of(name))}
    wraps = sorted({wrap for own in wraps_of.values() for wrap in own})
    poses = fit_poses(subject, surrogate.coordinates, fit.seed)
    recorded = engine.posed(poses.recorded)
    touched = {
        wrap
        for name, own in wraps_of.items()
        for wrap, touches in zip(own, _touching(recorded[name]), strict=True)
        if touches
    }
    say(f"finding boxes for {len(wraps)} cylinders", quiet=quiet)
    near = engine.posed(poses.recorded[::_EVERY])
    translations = translation_bounds(engine, near, wraps)
    boxed = time.perf_counter()
    training, validation = plan_samples(wraps_of, translations, fit.seed)
    by_name = {"training": poses.training, "validation": poses.validation}
    posed = {name: engine.posed(own) for name, own in by_name.items()}
    by_engine = EngineSource(engine, by_name, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    source: PathSource = by_engine
    if fit.geometry == "opensim":
        source = OpenSimSource(subject.model_file, by_engine, by_name, processes, quiet)
    learner = MuscleLearner(surrogate, source, training, validation, thresholds)
    learned: dict[str, LearnedMuscle] = {}
    with progress_bar("sampling cylinders, muscles", len(wraps_of), quiet=quiet) as advance:
        for name, own in wraps_of.items():
            learned[name] = learner.learn(name, own)
            advance(len(learned))
    sampled = time.perf_counter()
    feasibility: dict[str, Feasibility | None] = {}
    quality: dict[str, WrapQuality] = {}
    for wrap in wraps:
        users = [learned[name].verdicts[wrap] for name, own in wraps_of.items() if wrap in own]
        seen, unseen = (np.all(labels, axis=0) for labels in zip(*users, strict=True))
        samples, others = (plan.together.moved[wrap] for plan in (training, validation))
        usable, also_usable = (usable_by_all(engine, near, wrap, own) for own in (samples, others))
        feasibility[wrap] = fit_feasibility(
            samples, seen, *training.boxes[wrap], usable=usable, seed=fit.seed, threads=processes
        )
        judged = feasibility_quality(feasibility[wrap], others, unseen, also_usable)
        alone = feasibility_quality(feasibility[wrap], others, unseen)
        quality[wrap] = WrapQuality(
            physiological_share=float(unseen.mean()),
            **vars(judged),
            learned_balanced_accuracy=alone.balanced_accuracy,
            learned_false_physiological=alone.false_physiological,
        )
    return replace(
        fit,
        # A muscle that no placement leaves physiological keeps its errors with the model's own cylinders.
        errors=fit.errors | {name: one.error for name, one in learned.items() if one.error is not None},
        wraps=WrapFit(
            wraps_of={name: wraps_of.get(name, ()) for name in surrogate.muscles},
            translations=translations,
            touched=tuple(wrap for wrap in wraps if wrap in touched),
            inner=stack_inner_levels(surrogate, learned),
            feasibility=feasibility,
            quality=quality,
            thresholds=thresholds,
        ),
        seconds=fit.seconds
        | {
            "boxes": boxed - began,
            "sampling": sampled - boxed,
            "feasibility": time.perf_counter() - sampled,
        },
    )


def _touching(posed: PosedPath) -> Bool[np.ndarray, " wrap"]:
    """Say on which of its cylinders a muscle lies in some pose, wrapped the shortest way."""
    nominal = nominal_parameters(posed.surfaces.radius.shape[0])
    return np.asarray(wrap_at_samples(posed, nominal[None]).touching.any(axis=(0, 1)))
