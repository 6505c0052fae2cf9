"""Learn one muscle's inner level from samples of its cylinders, and what they do to its path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from wrapjax.api.paths.fit_result import PathError
from wrapjax.api.paths.fitting import SMOOTH_POSES
from wrapjax.api.paths.wrap_sources import PathSource
from wrapjax.geometry import InnerLevel, PathSurrogate, fit_inner_level
from wrapjax.geometry.inner_level import MONOMIALS
from wrapjax.geometry.physiological import PhysiologicalThresholds, measure_paths
from wrapjax.geometry.surfaces import NOMINAL
from wrapjax.geometry.wrap_samples import SamplePlan, SampleSet
from wrapjax.geometry.wrapping import WrappedPath

#: Which of some poses are frames of one cycle, in order.
_CYCLES = {"training": SMOOTH_POSES, "validation": slice(0, 0)}

Labels = Bool[np.ndarray, " sample"]
UnseenLabels = Bool[np.ndarray, " unseen_sample"]


@dataclass(frozen=True)
class LearnedMuscle:
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
class MuscleLearner:
    """Where samples come from, and what they are held to."""

    surrogate: PathSurrogate
    source: PathSource
    training: SamplePlan
    validation: SamplePlan
    thresholds: PhysiologicalThresholds

    def learn(self, muscle: str, wraps: tuple[str, ...]) -> LearnedMuscle:
        """Sample a muscle's cylinders.

        What is analysed is reduced at once: no more than one muscle's samples are held at a time.
        """
        inner, seen = self._inner_level(muscle, wraps)
        error, unseen = self._judged(muscle, wraps, inner)
        verdicts = {wrap: (seen, unseen) for wrap in wraps}
        if len(wraps) > 1:
            for wrap in wraps:
                alone = [plan.set_for(muscle, wrap, wraps) for plan in (self.training, self.validation)]
                verdicts[wrap] = self._labels(muscle, alone[0]), self._unseen_labels(muscle, alone[1])
        return LearnedMuscle(inner, self._half_range(wraps), error, verdicts)

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
    learned: Mapping[str, LearnedMuscle],
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
