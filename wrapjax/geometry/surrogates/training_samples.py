"""Samples of poses and wrap parameters on which path surrogates are trained and validated.

As in Ao, Fregly et al., a sample of wrap parameters changes all wraps at once and is analyzed in many poses.
Such samples show the combined effect of two wraps on a muscle, but not which of the two makes its path
non-physiological. The wraps of muscles with several are therefore also changed one at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from wrapjax.geometry.exact_paths.engine import nominal_parameters
from wrapjax.geometry.exact_paths.wrapping import WRAP_PARAMETERS
from wrapjax.geometry.surrogates.wrap_bounds import CYLINDER, hammersley, parameter_box

#: Smallest range of a coordinate at a frame (rad). With a single recorded cycle the range would be zero, and
#: a polynomial fitted to one curve is undetermined elsewhere.
MINIMUM_ANGLE_RANGE = np.radians(5.0)

#: Numbers of samples of wrap parameters for training and for validation, after Ao, Fregly et al.
TRAINING_SAMPLES, VALIDATION_SAMPLES = 1000, 250

Samples = Float[np.ndarray, "sample wrap_parameter"]
#: Lower and upper bounds of wrap parameters.
Box = tuple[Float[np.ndarray, " wrap_parameter"], Float[np.ndarray, " wrap_parameter"]]


def angle_ranges(
    angles: Float[np.ndarray, "trial coordinate frame"],
) -> tuple[Float[np.ndarray, "coordinate frame"], Float[np.ndarray, "coordinate frame"]]:
    """Compute the lowest and highest angle of every coordinate at every frame over all cycles.

    Parameters
    ----------
    angles
        Recorded angles, rad.

    Returns
    -------
    lower, upper
        Ends of the ranges, rad, at least `MINIMUM_ANGLE_RANGE` apart.
    """
    lower, upper = angles.min(axis=0), angles.max(axis=0)
    missing = np.maximum(MINIMUM_ANGLE_RANGE - (upper - lower), 0.0)
    return lower - 0.5 * missing, upper + 0.5 * missing


def random_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], count: int, generator: np.random.Generator
) -> Float[np.ndarray, "pose coordinate"]:
    """Draw poses uniformly from the recorded angle ranges, the same number at every frame.

    The last frame of a cycle repeats the first (heel strike to heel strike) and is left out.

    Parameters
    ----------
    angles
        Recorded angles, rad.
    count
        Number of poses, distributed evenly over the frames.
    generator
        Source of random numbers.

    Returns
    -------
    Array
        Poses in the order of their frames, rad.
    """
    lower, upper = angle_ranges(angles)
    frames = angles.shape[-1] - 1
    frame = np.arange(count) * frames // count
    low, high = lower[:, frame].T, upper[:, frame].T
    return low + (high - low) * generator.random(low.shape)


def fastest_cycle_poses(
    angles: Float[np.ndarray, "trial coordinate frame"], duration: Float[np.ndarray, " trial"]
) -> Float[np.ndarray, "pose coordinate"]:
    """Select the recorded poses of the shortest cycle, without its repeated last frame.

    Parameters
    ----------
    angles
        Recorded angles, rad.
    duration
        Duration of each cycle, s.
    """
    return angles[int(np.argmin(duration)), :, :-1].T


@dataclass(frozen=True)
class SampleSet:
    """Samples of the parameters of some wraps; other wraps stay nominal.

    Parameters
    ----------
    muscles
        Names of the muscles whose paths are to be computed.
    moved
        Wrap parameters by wrap, the same number of samples for each.
    """

    muscles: tuple[str, ...]
    moved: dict[str, Samples]

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(next(iter(self.moved.values())))

    def parameters(self, wraps: tuple[str, ...]) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
        """Parameters of a muscle's wraps at every sample.

        Parameters
        ----------
        wraps
            Names of the muscle's wraps, in the order of its path.
        """
        own = next(iter(self.moved.values()))
        parameters = np.tile(nominal_parameters(len(wraps), own.shape[1]), (self.count, 1, 1))
        for place, wrap in enumerate(wraps):
            if wrap in self.moved:
                parameters[:, place] = self.moved[wrap]
        return parameters


@dataclass(frozen=True)
class SamplePlan:
    """All samples of wrap parameters for training or for validation.

    Parameters
    ----------
    together
        Samples that change all wraps at once.
    alone
        Samples of the wraps of muscles with several, in the smallest number of sets of which none changes two
        wraps of one muscle.
    boxes
        Lower and upper bounds of each wrap's parameters.
    """

    together: SampleSet
    alone: tuple[SampleSet, ...]
    boxes: dict[str, Box]

    def samples_for(self, muscle: str, wrap: str, wraps: tuple[str, ...]) -> SampleSet:
        """Select the samples that change one wrap of a muscle, but none of its other wraps.

        Parameters
        ----------
        muscle, wrap
            Names of the muscle and of the wrap.
        wraps
            Names of all wraps of the muscle.
        """
        if len(wraps) == 1:
            return self.together
        return next(samples for samples in self.alone if wrap in samples.moved and muscle in samples.muscles)


def plan_samples(
    wraps_of: Mapping[str, tuple[str, ...]],
    translations: Mapping[str, float],
    seed: int = 0,
    classes: Mapping[str, str] | None = None,
    names: Sequence[str] = WRAP_PARAMETERS,
) -> tuple[SamplePlan, SamplePlan]:
    """Draw samples of wrap parameters for training, and different ones for validation.

    Parameters
    ----------
    wraps_of
        Names of the wraps of every muscle that has any.
    translations
        Largest translation of each wrap along each axis, m.
    seed
        Seed of the random order in which samples of different wraps are combined.
    classes
        OpenSim's class of each wrap; by default all are cylinders.
    names
        Names of the wrap parameters.

    Returns
    -------
    training, validation
        Samples of both sets.
    """
    generator, count = np.random.default_rng(seed), len(names)
    boxes = {
        wrap: parameter_box(translation, CYLINDER if classes is None else classes[wrap], names)
        for wrap, translation in translations.items()
    }
    return (
        _plan(wraps_of, boxes, hammersley(TRAINING_SAMPLES, 0, count), generator),
        _plan(wraps_of, boxes, hammersley(VALIDATION_SAMPLES, TRAINING_SAMPLES, count), generator),
    )


def _plan(
    wraps_of: Mapping[str, tuple[str, ...]],
    boxes: dict[str, Box],
    unit: Samples,
    generator: np.random.Generator,
) -> SamplePlan:
    moved = {}
    for wrap, (lower, upper) in boxes.items():
        # In a random order for each wrap, so that the parameters of two wraps of one muscle are uncorrelated.
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
