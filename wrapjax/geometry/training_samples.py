"""Which poses a surrogate is trained and judged on.

Which placements of the cylinders a two-level surrogate is trained and judged on.

All cylinders move at once: a sample is one model, analysed in many poses, as in the paper. A muscle with
two cylinders then shows how their sum is best fitted. But which of the two made its path non-physiological
such samples cannot tell. So the cylinders of those muscles are also moved one at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.engine import nominal_parameters
from wrapjax.geometry.wrap_bounds import box, hammersley

#: Narrower belts are widened to this (rad): with a single recorded cycle a belt has no width at all,
#: and a polynomial fitted along one curve says nothing beside it.
MINIMUM_BELT_WIDTH = np.radians(5.0)


def walking_belt(
    angles: Float[np.ndarray, "trial coordinate frame"],
) -> tuple[Float[np.ndarray, "coordinate frame"], Float[np.ndarray, "coordinate frame"]]:
    """Find the lowest and highest angle of every coordinate at every frame, over all cycles.

    Parameters
    ----------
    angles
        In rad.

    Returns
    -------
    tuple of arrays
        Lower and upper edge in rad, at least `MINIMUM_BELT_WIDTH` apart.
    """
    lower, upper = angles.min(axis=0), angles.max(axis=0)
    missing = np.maximum(MINIMUM_BELT_WIDTH - (upper - lower), 0.0)
    return lower - 0.5 * missing, upper + 0.5 * missing


def random_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "pose coordinate"]:
    """Draw poses uniformly from the walking belt, the same number at every frame.

    The last frame repeats the first (heel strike to heel strike) and gets none.

    Parameters
    ----------
    angles
        In rad.
    count
        Number of poses; spread evenly over the frames.
    """
    lower, upper = walking_belt(angles)
    frames = angles.shape[-1] - 1
    frame = np.arange(count) * frames // count
    low, high = lower[:, frame].T, upper[:, frame].T
    return low + (high - low) * generator.random(low.shape)


def smooth_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], duration: Float[np.ndarray, " trial"]
) -> Float[np.ndarray, "pose coordinate"]:
    """Take the recorded poses of the shortest (fastest) cycle, its repeated last frame left out.

    Parameters
    ----------
    angles
        In rad.
    duration
        Of each cycle, in s.
    """
    return angles[int(np.argmin(duration)), :, :-1].T


#: Samples of each cylinder's box, for training and for validation: the paper's.
TRAINING_SAMPLES, VALIDATION_SAMPLES = 1000, 250

Samples = Float[np.ndarray, "sample wrap_parameter"]


@dataclass(frozen=True)
class SampleSet:
    """Placements of some cylinders; the others stay where the model has them.

    Parameters
    ----------
    muscles
        Whose paths are wanted.
    moved
        Wrap parameters by cylinder, all of as many samples.
    """

    muscles: tuple[str, ...]
    moved: dict[str, Samples]

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(next(iter(self.moved.values())))

    def parameters(self, wraps: tuple[str, ...]) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
        """Give the parameters of a muscle's cylinders at every sample."""
        nominal = np.tile(nominal_parameters(len(wraps)), (self.count, 1, 1))
        for place, wrap in enumerate(wraps):
            if wrap in self.moved:
                nominal[:, place] = self.moved[wrap]
        return nominal


@dataclass(frozen=True)
class SamplePlan:
    """All that is sampled, for training or for validation.

    Parameters
    ----------
    together
        All cylinders at once.
    alone
        The cylinders of muscles with several, in as few sets as move no two cylinders of one muscle.
    boxes
        Lower and upper ends of each cylinder's parameters.
    """

    together: SampleSet
    alone: tuple[SampleSet, ...]
    boxes: dict[str, tuple[Float[np.ndarray, " wrap_parameter"], Float[np.ndarray, " wrap_parameter"]]]

    def set_for(self, muscle: str, wrap: str, wraps: tuple[str, ...]) -> SampleSet:
        """Find the samples that show what a cylinder alone does to a muscle."""
        if len(wraps) == 1:
            return self.together
        return next(one for one in self.alone if wrap in one.moved and muscle in one.muscles)


def plan_samples(
    wraps_of: Mapping[str, tuple[str, ...]], translations: Mapping[str, float], seed: int = 0
) -> tuple[SamplePlan, SamplePlan]:
    """Plan the samples for training, and other ones for validation.

    Parameters
    ----------
    wraps_of
        The cylinders of every muscle that has any.
    translations
        Half width of each cylinder's box along its axes, m.
    seed
        Decides which samples of one cylinder meet which of another.
    """
    generator = np.random.default_rng(seed)
    return (
        _plan(wraps_of, translations, hammersley(TRAINING_SAMPLES), generator),
        _plan(wraps_of, translations, hammersley(VALIDATION_SAMPLES, TRAINING_SAMPLES), generator),
    )


def _plan(
    wraps_of: Mapping[str, tuple[str, ...]],
    translations: Mapping[str, float],
    unit: Samples,
    generator: np.random.Generator,
) -> SamplePlan:
    moved, boxes = {}, {wrap: box(translation) for wrap, translation in translations.items()}
    for wrap, (lower, upper) in boxes.items():
        # In an order of its own: two cylinders of one muscle must not move in step.
        moved[wrap] = (lower + (upper - lower) * unit)[generator.permutation(len(unit))]
    several = {muscle: wraps for muscle, wraps in wraps_of.items() if len(wraps) > 1}
    groups: list[set[str]] = []
    for wrap in dict.fromkeys(wrap for wraps in several.values() for wrap in wraps):
        partners = {other for wraps in several.values() if wrap in wraps for other in wraps}
        group = next((one for one in groups if not one & partners), None)
        if group is None:
            groups.append({wrap})
        else:
            group.add(wrap)
    alone = [
        SampleSet(
            muscles=tuple(muscle for muscle, wraps in several.items() if group & set(wraps)),
            moved={wrap: moved[wrap] for wrap in sorted(group)},
        )
        for group in groups
    ]
    return SamplePlan(SampleSet(tuple(wraps_of), moved), tuple(alone), boxes)
