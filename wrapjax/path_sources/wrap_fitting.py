"""Dependence of a subject's polynomial paths on wrap parameters, fitted to sampled wraps (``fit_wraps``)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.geometry.exact_paths.engine import (
    GEODESIC,
    ExactPaths,
    PosedPath,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, WRAP_PARAMETERS, WrappedPath
from wrapjax.geometry.surrogates.feasibility import Feasibility, feasibility_quality, fit_feasibility
from wrapjax.geometry.surrogates.physiological import (
    DEFAULT_THRESHOLDS,
    PhysiologicalThresholds,
    measure_paths,
)
from wrapjax.geometry.surrogates.surrogate import PathSurrogate
from wrapjax.geometry.surrogates.training_samples import SamplePlan, SampleSet, plan_samples
from wrapjax.geometry.surrogates.two_level import InnerLevel, fit_inner_level, wrap_exponents
from wrapjax.geometry.surrogates.wrap_bounds import translation_bounds, usable_for_all_muscles
from wrapjax.io.store import Store, fingerprint
from wrapjax.jax_setup import require_float64
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import WRAPPINGS
from wrapjax.path_sources.near_bones import NearBones, find_near_bones
from wrapjax.path_sources.path_samples import (
    SMOOTH_POSES,
    EngineAnalyzer,
    OpenSimAnalyzer,
    PathAnalyzer,
    fit_poses,
)
from wrapjax.path_sources.polynomial_fit import Fit, PathError, read_fit
from wrapjax.path_sources.polynomial_paths import WrapFit, WrapQuality
from wrapjax.progress import print_progress, progress_bar
from wrapjax.subject.subject import Subject

#: Poses, by their name, that are the frames of one cycle in order.
_CYCLES = {"training": SMOOTH_POSES, "validation": slice(0, 0)}

Labels = Bool[np.ndarray, " sample"]
ValidationLabels = Bool[np.ndarray, " unseen_sample"]


@dataclass(frozen=True)
class MuscleWrapFit:
    """Inner level of one muscle, fitted to samples of the parameters of its wraps.

    Parameters
    ----------
    inner
        Coefficients of the inner level, m.
    half_range
        Half widths of the bounds of the wrap parameters, in their units.
    error
        Error on physiological validation samples in validation poses; None if no sample is physiological.
    labels
        By wrap: which training and which validation samples of it give a physiological path, with the other
        wraps of the muscle nominal.
    """

    inner: Float[np.ndarray, "wrap monomial term"]
    half_range: Float[np.ndarray, "wrap wrap_parameter"]
    error: PathError | None
    labels: dict[str, tuple[Labels, ValidationLabels]]


@dataclass(frozen=True)
class MuscleWrapFitter:
    """Fitting of the inner level of muscles to samples of wrap parameters.

    Parameters
    ----------
    surrogate
        Polynomials with nominal wraps (outer level).
    source
        Computation of the sampled paths.
    training, validation
        Samples of the wrap parameters.
    thresholds
        Definition of physiological paths.
    """

    surrogate: PathSurrogate
    source: PathAnalyzer
    training: SamplePlan
    validation: SamplePlan
    thresholds: PhysiologicalThresholds

    def fit(self, muscle: str, wraps: tuple[str, ...]) -> MuscleWrapFit:
        """Fit the inner level of one muscle, and classify the samples of its wraps.

        Paths of one muscle at a time are in memory.

        Parameters
        ----------
        muscle
            Name of the muscle.
        wraps
            Names of its wraps, in the order of its path.
        """
        inner, training_labels = self._inner_level(muscle, wraps)
        error, validation_labels = self._validate(muscle, wraps, inner)
        labels = {wrap: (training_labels, validation_labels) for wrap in wraps}
        if len(wraps) > 1:
            for wrap in wraps:
                alone = [plan.samples_for(muscle, wrap, wraps) for plan in (self.training, self.validation)]
                labels[wrap] = self._labels(muscle, alone[0]), self._validation_labels(muscle, alone[1])
        return MuscleWrapFit(inner, self._half_range(wraps), error, labels)

    def _inner_level(
        self, muscle: str, wraps: tuple[str, ...]
    ) -> tuple[Float[np.ndarray, "wrap monomial term"], Labels]:
        samples = self.training.together
        paths, nominal = self.source.paths(muscle, samples, "training")
        physiological = self._physiological(paths, nominal, "training")
        # One pseudoinverse serves all samples.
        design = self.surrogate.design(muscle, self.source.poses["training"])
        to_coefficients = np.linalg.pinv(design)
        change = self._rows(muscle, paths) - self._rows(muscle, nominal)
        moved = _changes(samples, wraps)
        coefficients = change @ to_coefficients.T
        half_range = self._half_range(wraps)
        inner = fit_inner_level(moved, half_range, coefficients, physiological, design.T @ design)
        return inner, physiological

    def _validate(
        self, muscle: str, wraps: tuple[str, ...], inner: Float[np.ndarray, "wrap monomial term"]
    ) -> tuple[PathError | None, Labels]:
        """Evaluate the inner level on validation samples and poses."""
        samples, row = self.validation.together, self.surrogate.muscles.index(muscle)
        paths, nominal = self.source.paths(muscle, samples, "validation")
        physiological = self._labels(muscle, samples) & self._physiological(paths, nominal, "validation")
        if not physiological.any():
            return None, physiological
        moved = _changes(samples, wraps)
        level = InnerLevel(jnp.asarray(inner), jnp.asarray(self._half_range(wraps)))
        nominal_coefficients = np.asarray(self.surrogate.coefficients[row])[
            np.asarray(self.surrogate.used[row])
        ]
        changes = np.asarray(jax.vmap(level.for_one_muscle)(jnp.asarray(moved.reshape(len(moved), -1))))
        coefficients = nominal_coefficients + changes[physiological]
        predicted = coefficients @ self.surrogate.design(muscle, self.source.poses["validation"]).T
        error = predicted - self._rows(muscle, paths)[physiological]
        poses = paths.length.shape[1]
        pooled = PathError.of(
            error[:, :poses], error[:, poses:], wrapped=True, terms=len(nominal_coefficients)
        )
        return pooled, physiological

    def _validation_labels(self, muscle: str, samples: SampleSet) -> Labels:
        paths = self.source.paths(muscle, samples, "validation")
        return self._labels(muscle, samples) & self._physiological(*paths, "validation")

    def _labels(self, muscle: str, samples: SampleSet) -> Labels:
        return self._physiological(*self.source.paths(muscle, samples, "training"), "training")

    def _physiological(self, paths: WrappedPath, nominal: WrappedPath, poses: str) -> Labels:
        return measure_paths(paths, nominal, _CYCLES[poses]).physiological(self.thresholds)

    def _rows(self, muscle: str, path: WrappedPath) -> Float[np.ndarray, "sample row"]:
        """Concatenate lengths and moment arms in the order of `PathSurrogate.design`, m."""
        arms = [path.moment_arm[:, :, slot] for slot in self.surrogate.slots(muscle)]
        return np.concatenate([path.length, *arms], axis=1)

    def _half_range(self, wraps: tuple[str, ...]) -> Float[np.ndarray, "wrap wrap_parameter"]:
        half = np.array([0.5 * np.subtract(*self.training.boxes[wrap][::-1]) for wrap in wraps])
        # Parameters that are held never change.
        return np.where(half > 0.0, half, 1.0)


def _changes(samples: SampleSet, wraps: tuple[str, ...]) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
    parameters = samples.parameters(wraps)
    return parameters - NOMINAL_PARAMETERS[: parameters.shape[-1]]


def stack_inner_levels(
    surrogate: PathSurrogate,
    fitted: Mapping[str, MuscleWrapFit],
    parameters: int = len(WRAP_PARAMETERS),
) -> InnerLevel:
    """Combine the inner levels of all muscles into arrays, padded with zeros.

    The number of parameters is that of one wrap.
    """
    most = max((len(one.inner) for one in fitted.values()), default=0)
    weights = np.zeros(
        (len(surrogate.muscles), most, len(wrap_exponents(parameters)), surrogate.used.shape[1])
    )
    half_range = np.ones((len(surrogate.muscles), most, parameters))
    for muscle, one in fitted.items():
        row = surrogate.muscles.index(muscle)
        used = np.flatnonzero(np.asarray(surrogate.used[row]))
        weights[row, : len(one.inner), :, used] = np.moveaxis(one.inner, -1, 0)
        half_range[row, : len(one.inner)] = one.half_range
    return InnerLevel(jnp.asarray(weights), jnp.asarray(half_range))


# Step of the recorded frames in which bounds on translations are determined.
_FRAME_STEP = 4


def fit_wraps(
    subject: Subject,
    fit: Fit,
    *,
    thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS,
    bone_folders: Sequence[Path] = (),
    processes: int | None = None,
    quiet: bool = True,
) -> Fit:
    """Fit the dependence of polynomial paths on wrap parameters, which PGA requires.

    Paths are computed for 1000 samples of the wrap parameters, within bounds for each wrap, in the 500
    training poses of the fit. The samples with physiological paths determine how the coefficients of the
    polynomials depend on the wrap parameters (inner level); all samples determine a classifier of feasible
    parameters for each wrap. Both are validated with 250 other samples, in these and in 500 other poses.

    Parameters
    ----------
    subject
        Subject of the fit.
    fit
        Fit from `wrapjax.fit`. Its source of lengths and moment arms is used; contacts and discontinuities
        are always those of the exact engine.
    thresholds
        Definition of physiological paths.
    bone_folders
        Folders with the surfaces of bones (``.vtp``) that the model names. Where they are given, feasible
        wraps are near the bones of their body, too. Bones without a file do not count.
    processes
        Number of worker processes for OpenSim and of threads for scikit-learn; by default one per core or
        more.
    quiet
        Print no progress.

    Returns
    -------
    Fit
        The same fit with ``wraps``, and with the errors (mm) of wrapped muscles on validation samples. It is
        also stored in the user's cache. Analyses by OpenSim take hours and are stored one by one, so that an
        interrupted fit is continued.

    Raises
    ------
    InputError
        If a muscle's path has an element that the exact engine does not support; or if folders of bones are
        given that have none of the model's wrapped bodies, or a damaged one.

    Examples
    --------
    >>> fitted = fit_wraps(subject, fit(subject, "engine"))  # doctest: +SKIP
    >>> calibrate(subject, "PGA", fitted)  # doctest: +SKIP
    """
    require_float64()
    bones = None
    if bone_folders:
        bones = find_near_bones(subject.model_file, bone_folders, thresholds.bone_distance)
    store = Store.of_user("fit_wraps")
    vertices = bones.vertices if bones else {}
    name = fingerprint(fit.key, repr(thresholds), *vertices, *vertices.values(), module=__name__)
    if (known := store.read(name, read_fit)) is not None:
        return known
    result = _fit_wraps(subject, fit, thresholds, bones, processes, quiet)
    result.write_to_cache(store.place(name))
    return result


def _fit_wraps(
    subject: Subject,
    fit: Fit,
    thresholds: PhysiologicalThresholds,
    bones: NearBones | None,
    processes: int | None,
    quiet: bool,
) -> Fit:
    started = time.perf_counter()
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
        for wrap, touches in zip(own, _touched_wraps(recorded[name]), strict=True)
        if touches
    }
    print_progress(f"determining bounds of {len(wraps)} wraps", quiet=quiet)
    coarse = engine.posed(poses.recorded[::_FRAME_STEP])
    translations = translation_bounds(engine, coarse, wraps)
    boxed = time.perf_counter()
    training, validation = plan_samples(
        wraps_of, translations, fit.seed, engine.wrap_classes, engine.parameters
    )
    by_name = {"training": poses.training, "validation": poses.validation}
    posed = {name: engine.posed(own) for name, own in by_name.items()}
    by_engine = EngineAnalyzer(engine, by_name, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    source: PathAnalyzer = by_engine
    if fit.geometry == "opensim":
        source = OpenSimAnalyzer(subject.model_file, by_engine, by_name, processes, quiet)
    fitter = MuscleWrapFitter(surrogate, source, training, validation, thresholds)
    fitted: dict[str, MuscleWrapFit] = {}
    with progress_bar("sampling wraps, muscles", len(wraps_of), quiet=quiet) as advance:
        for name, own in wraps_of.items():
            fitted[name] = fitter.fit(name, own)
            advance(len(fitted))
    sampled = time.perf_counter()
    feasibility: dict[str, Feasibility | None] = {}
    quality: dict[str, WrapQuality] = {}
    for wrap in wraps:
        users = [fitted[name].labels[wrap] for name, own in wraps_of.items() if wrap in own]
        training_labels, validation_labels = (np.all(labels, axis=0) for labels in zip(*users, strict=True))
        samples, others = (plan.together.moved[wrap] for plan in (training, validation))
        near_bone_share = None
        if bones and model.wrap(wrap).body in bones.vertices:
            near_bone, others_near_bone = (bones.identify(model.wrap(wrap), own) for own in (samples, others))
            training_labels, validation_labels = (
                training_labels & near_bone,
                validation_labels & others_near_bone,
            )
            near_bone_share = float(others_near_bone.mean())
        usable, others_usable = (
            usable_for_all_muscles(engine, coarse, wrap, own) for own in (samples, others)
        )
        feasibility[wrap] = fit_feasibility(
            samples, training_labels, *training.boxes[wrap], usable=usable, seed=fit.seed, threads=processes
        )
        combined = feasibility_quality(feasibility[wrap], others, validation_labels, others_usable)
        alone = feasibility_quality(feasibility[wrap], others, validation_labels)
        quality[wrap] = WrapQuality(
            physiological_share=float(validation_labels.mean()),
            **vars(combined),
            learned_balanced_accuracy=alone.balanced_accuracy,
            learned_false_physiological=alone.false_physiological,
            near_bone_share=near_bone_share,
        )
    return replace(
        fit,
        # A muscle without physiological samples keeps its errors with nominal wraps.
        errors=fit.errors | {name: one.error for name, one in fitted.items() if one.error is not None},
        wraps=WrapFit(
            wraps_of={name: wraps_of.get(name, ()) for name in surrogate.muscles},
            translations=translations,
            classes={wrap: engine.wrap_classes[wrap] for wrap in wraps},
            touched=tuple(wrap for wrap in wraps if wrap in touched),
            inner=stack_inner_levels(surrogate, fitted, len(engine.parameters)),
            feasibility=feasibility,
            quality=quality,
            thresholds=thresholds,
        ),
        seconds=fit.seconds
        | {
            "boxes": boxed - started,
            "sampling": sampled - boxed,
            "feasibility": time.perf_counter() - sampled,
        },
    )


def _touched_wraps(posed: PosedPath) -> Bool[np.ndarray, " wrap"]:
    """Determine which nominal wraps a muscle touches in some pose, with shortest paths."""
    nominal = nominal_parameters(posed.surfaces.radius.shape[0])
    return np.asarray(wrap_at_samples(posed, nominal[None]).touching.any(axis=(0, 1)))
