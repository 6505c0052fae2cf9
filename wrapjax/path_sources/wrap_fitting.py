"""``fit_wraps``: learn how a subject's muscle paths follow the cylinders that they wrap round.

Learn one muscle's inner level from samples of its cylinders, and what they do to its path.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import InputError
from wrapjax.geometry.engine import GEODESIC, ExactPaths, PosedPath, nominal_parameters, wrap_at_samples
from wrapjax.geometry.feasibility import Feasibility, feasibility_quality, fit_feasibility
from wrapjax.geometry.physiological import DEFAULT_THRESHOLDS, PhysiologicalThresholds, measure_paths
from wrapjax.geometry.surrogate import PathSurrogate
from wrapjax.geometry.training_samples import SamplePlan, SampleSet, plan_samples
from wrapjax.geometry.two_level import MONOMIALS, InnerLevel, fit_inner_level
from wrapjax.geometry.wrap_bounds import translation_bounds, usable_for_all_muscles
from wrapjax.geometry.wrapping import NOMINAL, WrappedPath
from wrapjax.io.files import cache_folder, content_hash
from wrapjax.jax_setup import require_float64
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import WRAPPINGS
from wrapjax.path_sources.fit_poses import SMOOTH_POSES, fit_poses
from wrapjax.path_sources.polynomial_fit import Fit, PathError, read_fit
from wrapjax.path_sources.polynomial_paths import WrapFit, WrapQuality
from wrapjax.path_sources.sample_analysis import EngineAnalyzer, OpenSimAnalyzer, PathAnalyzer
from wrapjax.progress import print_progress, progress_bar
from wrapjax.subject.subject import Subject

#: Which of some poses are frames of one cycle, in order.
_CYCLES = {"training": SMOOTH_POSES, "validation": slice(0, 0)}

Labels = Bool[np.ndarray, " sample"]
UnseenLabels = Bool[np.ndarray, " unseen_sample"]


@dataclass(frozen=True)
class MuscleWrapFit:
    """What the samples of a muscle's cylinders gave.

    Parameters
    ----------
    inner
        How its coefficients follow them, m.
    half_range
        Of their boxes.
    error
        On unseen physiological samples, in unseen poses; None if none of them is physiological.
    verdicts
        By cylinder: which training and which validation samples of it leave the path physiological, the
        muscle's other cylinders being nominal.
    """

    inner: Float[np.ndarray, "wrap monomial term"]
    half_range: Float[np.ndarray, "wrap wrap_parameter"]
    error: PathError | None
    verdicts: dict[str, tuple[Labels, UnseenLabels]]


@dataclass(frozen=True)
class MuscleWrapFitter:
    """Where samples come from, and what they are held to."""

    surrogate: PathSurrogate
    source: PathAnalyzer
    training: SamplePlan
    validation: SamplePlan
    thresholds: PhysiologicalThresholds

    def learn(self, muscle: str, wraps: tuple[str, ...]) -> MuscleWrapFit:
        """Sample a muscle's cylinders.

        What is analysed is reduced at once: no more than one muscle's samples are held at a time.
        """
        inner, seen = self._inner_level(muscle, wraps)
        error, unseen = self._judged(muscle, wraps, inner)
        verdicts = {wrap: (seen, unseen) for wrap in wraps}
        if len(wraps) > 1:
            for wrap in wraps:
                alone = [plan.samples_for(muscle, wrap, wraps) for plan in (self.training, self.validation)]
                verdicts[wrap] = self._labels(muscle, alone[0]), self._unseen_labels(muscle, alone[1])
        return MuscleWrapFit(inner, self._half_range(wraps), error, verdicts)

    def _inner_level(
        self, muscle: str, wraps: tuple[str, ...]
    ) -> tuple[Float[np.ndarray, "wrap monomial term"], Labels]:
        samples = self.training.together
        found, nominal = self.source.paths(muscle, samples, "training")
        physiological = self._physiological(found, nominal, "training")
        # One factorisation serves all samples.
        design = self.surrogate.design(muscle, self.source.poses["training"])
        to_coefficients = np.linalg.pinv(design)
        change = self._rows(muscle, found) - self._rows(muscle, nominal)
        moved = samples.parameters(wraps) - NOMINAL
        coefficients = change @ to_coefficients.T
        half_range = self._half_range(wraps)
        inner = fit_inner_level(moved, half_range, coefficients, physiological, design.T @ design)
        return inner, physiological

    def _judged(
        self, muscle: str, wraps: tuple[str, ...], inner: Float[np.ndarray, "wrap monomial term"]
    ) -> tuple[PathError | None, Labels]:
        """Compare with samples and poses that the fit has not seen."""
        samples, row = self.validation.together, self.surrogate.muscles.index(muscle)
        found, nominal = self.source.paths(muscle, samples, "validation")
        physiological = self._labels(muscle, samples) & self._physiological(found, nominal, "validation")
        if not physiological.any():
            return None, physiological
        moved = samples.parameters(wraps) - NOMINAL
        level = InnerLevel(jnp.asarray(inner), jnp.asarray(self._half_range(wraps)))
        nominal_coefficients = np.asarray(self.surrogate.coefficients[row])[
            np.asarray(self.surrogate.used[row])
        ]
        changes = np.asarray(jax.vmap(level.of_one)(jnp.asarray(moved.reshape(len(moved), -1))))
        coefficients = nominal_coefficients + changes[physiological]
        predicted = coefficients @ self.surrogate.design(muscle, self.source.poses["validation"]).T
        error = predicted - self._rows(muscle, found)[physiological]
        poses = found.length.shape[1]
        pooled = PathError.of(
            error[:, :poses], error[:, poses:], wrapped=True, terms=len(nominal_coefficients)
        )
        return pooled, physiological

    def _unseen_labels(self, muscle: str, samples: SampleSet) -> Labels:
        paths = self.source.paths(muscle, samples, "validation")
        return self._labels(muscle, samples) & self._physiological(*paths, "validation")

    def _labels(self, muscle: str, samples: SampleSet) -> Labels:
        return self._physiological(*self.source.paths(muscle, samples, "training"), "training")

    def _physiological(self, found: WrappedPath, nominal: WrappedPath, poses: str) -> Labels:
        return measure_paths(found, nominal, _CYCLES[poses]).physiological(self.thresholds)

    def _rows(self, muscle: str, path: WrappedPath) -> Float[np.ndarray, "sample row"]:
        """Lengths, then moment arms, in the order of `PathSurrogate.design`."""
        arms = [path.moment_arm[:, :, slot] for slot in self.surrogate.slots(muscle)]
        return np.concatenate([path.length, *arms], axis=1)

    def _half_range(self, wraps: tuple[str, ...]) -> Float[np.ndarray, "wrap wrap_parameter"]:
        return np.array([0.5 * np.subtract(*self.training.boxes[wrap][::-1]) for wrap in wraps])


def stack_inner_levels(
    surrogate: PathSurrogate,
    learned: Mapping[str, MuscleWrapFit],
) -> InnerLevel:
    """Fill up to one shape; muscles without cylinders have zeros."""
    most = max((len(one.inner) for one in learned.values()), default=0)
    weights = np.zeros((len(surrogate.muscles), most, MONOMIALS, surrogate.used.shape[1]))
    half_range = np.ones((len(surrogate.muscles), most, len(NOMINAL)))
    for muscle, one in learned.items():
        row = surrogate.muscles.index(muscle)
        used = np.flatnonzero(np.asarray(surrogate.used[row]))
        weights[row, : len(one.inner), :, used] = np.moveaxis(one.inner, -1, 0)
        half_range[row, : len(one.inner)] = one.half_range
    return InnerLevel(jnp.asarray(weights), jnp.asarray(half_range))


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
            print_progress(f"the cached fit in {cached} cannot be read and is made again", quiet=quiet)
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
    print_progress(f"finding boxes for {len(wraps)} cylinders", quiet=quiet)
    near = engine.posed(poses.recorded[::_EVERY])
    translations = translation_bounds(engine, near, wraps)
    boxed = time.perf_counter()
    training, validation = plan_samples(wraps_of, translations, fit.seed)
    by_name = {"training": poses.training, "validation": poses.validation}
    posed = {name: engine.posed(own) for name, own in by_name.items()}
    by_engine = EngineAnalyzer(engine, by_name, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    source: PathAnalyzer = by_engine
    if fit.geometry == "opensim":
        source = OpenSimAnalyzer(subject.model_file, by_engine, by_name, processes, quiet)
    learner = MuscleWrapFitter(surrogate, source, training, validation, thresholds)
    learned: dict[str, MuscleWrapFit] = {}
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
        usable, also_usable = (usable_for_all_muscles(engine, near, wrap, own) for own in (samples, others))
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
