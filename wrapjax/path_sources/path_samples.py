"""Poses and samples of wrap parameters at which muscle paths are computed for a fit, and figures of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.exact_paths.engine import (
    GEODESIC,
    ExactPaths,
    PosedPath,
    Wrapping,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.geometry.exact_paths.wrapping import WrappedPath
from wrapjax.geometry.surrogates.physiological import PhysiologicalThresholds, measure_paths
from wrapjax.geometry.surrogates.training_samples import (
    SampleSet,
    fastest_cycle_poses,
    plan_samples,
    random_poses,
)
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_placements
from wrapjax.path_sources.exact import WRAPPINGS
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.report.paths.fit_wraps import SampledPath

Poses = Float[np.ndarray, "pose coordinate"]
#: Number of random training poses near the recorded ones, in addition to the frames of one smooth cycle.
TRAINING_POSES = 400
#: Training poses that are the frames of one cycle, in order.
SMOOTH_POSES = slice(TRAINING_POSES, None)
#: Number of poses for validation.
VALIDATION_POSES = 500
#: Number of samples for a single figure, and for each figure of a report.
_SAMPLES, REPORTED_SAMPLES = 250, 150


@runtime_checkable
class PathAnalyzer(Protocol):
    """Interface for the computation of paths at samples of the parameters of their wraps."""

    @property
    def poses(self) -> dict[str, Poses]:
        """Poses by name."""
        ...

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """Compute the path of one muscle for all samples and for nominal wraps.

        Parameters
        ----------
        muscle
            Name of the muscle.
        samples
            Samples of the wrap parameters.
        poses
            Name of the poses.

        Returns
        -------
        sampled, nominal
            Paths; leading axes are ``sample pose``, with one sample for the nominal path.
        """
        ...


@dataclass(frozen=True)
class EngineAnalyzer:
    """Computation by the exact engine, millions of paths per second."""

    engine: ExactPaths
    poses: dict[str, Poses]
    #: Paths in given poses, by the name of the poses and by muscle.
    posed: dict[str, dict[str, PosedPath]]
    wrapping: Wrapping = GEODESIC

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """Compute the path of one muscle; see `PathAnalyzer`."""
        parameters = _with_nominal_first(samples, self.engine.wraps_of(muscle))
        found = wrap_at_samples(self.posed[poses][muscle], parameters, self.wrapping)
        return jax.tree.map(lambda leaf: leaf[1:], found), jax.tree.map(lambda leaf: leaf[:1], found)


@dataclass(frozen=True)
class OpenSimAnalyzer:
    """Computation of lengths and moment arms by OpenSim; contact and discontinuities are from the engine.

    Every sample of a set is analysed once for all its muscles, and stored on disk.
    """

    model_file: Path
    flags: EngineAnalyzer
    poses: dict[str, Poses]
    processes: int | None
    quiet: bool

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """Compute the path of one muscle; see `PathAnalyzer`."""
        engine = self.flags.engine
        moved = samples.moved
        placements = [{}, *({wrap: own[n] for wrap, own in moved.items()} for n in range(samples.count))]
        analysed = analyse_placements(
            self.model_file,
            samples.muscles,
            engine.coordinates,
            self.poses[poses],
            placements,
            processes=self.processes,
            quiet=self.quiet,
        )
        length_and_arms = analysed.of(muscle)
        sampled, nominal = self.flags.paths(muscle, samples, poses)
        return (
            _replace_geometry(sampled, *(part[1:] for part in length_and_arms)),
            _replace_geometry(nominal, *(part[:1] for part in length_and_arms)),
        )


def _replace_geometry(
    path: WrappedPath,
    length: Float[np.ndarray, "sample pose"],
    moment_arm: Float[np.ndarray, "sample pose coordinate"],
) -> WrappedPath:
    return eqx.tree_at(lambda path: (path.length, path.moment_arm), path, (length, moment_arm))


def _with_nominal_first(
    samples: SampleSet, wraps: tuple[str, ...]
) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
    # In one array: another number of samples would require another compilation.
    parameters = samples.parameters(wraps)
    return np.concatenate([nominal_parameters(*parameters.shape[1:])[None], parameters])


class FitPoses(NamedTuple):
    """Training and validation poses of a fit, and the recorded poses (rad or m)."""

    training: Float[np.ndarray, "pose coordinate"]
    validation: Float[np.ndarray, "pose coordinate"]
    recorded: Float[np.ndarray, "pose coordinate"]


def fit_poses(subject: Subject, coordinates: Sequence[str], seed: int) -> FitPoses:
    """Draw the poses of a fit; they are determined by the seed.

    Parameters
    ----------
    subject
        Subject with recorded cycles.
    coordinates
        Names of the coordinates.
    seed
        Seed of the random poses.
    """
    trials = subject.trials
    angles = trials.angles[:, [trials.coordinates.index(name) for name in coordinates]]
    durations = trials.time[:, -1] - trials.time[:, 0]
    if trials.is_gait.any():
        durations = np.where(trials.is_gait, durations, np.inf)
    generator = np.random.default_rng(seed)
    training = np.concatenate(
        [
            random_poses(angles, TRAINING_POSES, generator),
            fastest_cycle_poses(angles, durations),
        ]
    )
    validation = random_poses(angles, VALIDATION_POSES, generator)
    return FitPoses(training, validation, np.moveaxis(angles, 1, 2).reshape(-1, len(coordinates)))


def physiological_picture(
    subject: Subject,
    fit: Fit,
    muscle: str,
    thresholds: PhysiologicalThresholds | None = None,
) -> str:
    """Draw sampled paths of a muscle: which were accepted as physiological, and why others were rejected.

    Parameters
    ----------
    subject
        Subject of the fit.
    fit
        Fit with samples of the wrap parameters, from `wrapjax.fit_wraps`.
    muscle
        Name of the muscle.
    thresholds
        Definition of physiological paths, by default that of the fit. Other thresholds can be inspected here
        before a fit with them.

    Returns
    -------
    str
        Figure as SVG.

    Raises
    ------
    InputError
        If the muscle has no samples of wrap parameters.
    """
    from wrapjax.report.paths.fit_wraps import physiological_figure
    from wrapjax.report.style import to_svg

    (path,) = sampled_paths(subject, fit, [muscle], thresholds)
    return to_svg(physiological_figure(path))


def sampled_paths(
    subject: Subject,
    fit: Fit,
    muscles: Sequence[str],
    thresholds: PhysiologicalThresholds | None = None,
    *,
    count: int = _SAMPLES,
) -> Iterator[SampledPath]:
    """Compute the paths of muscles for the first samples of their wrap parameters, muscle by muscle.

    Samples are classified in all training poses, as in the fit; the returned curves are those of the cycle
    among these poses.

    Parameters
    ----------
    subject, fit, thresholds
        See `physiological_picture`.
    muscles
        Names of the muscles.
    count
        Number of samples.

    Yields
    ------
    SampledPath
        Curves and reasons for rejection of one muscle.
    """
    from wrapjax.report.paths.fit_wraps import SampledPath

    wraps_of = {} if fit.wraps is None else {name: own for name, own in fit.wraps.wraps_of.items() if own}
    for muscle in muscles:
        if muscle not in wraps_of:
            raise InputError(Problem(str(subject.folder), "has no sampled wraps to draw", place=muscle))
    if fit.wraps is None or not muscles:
        return
    training, _ = plan_samples(
        wraps_of, fit.wraps.translations, fit.seed, fit.wraps.classes, fit.wraps.parameters
    )
    moved = training.together.moved
    samples = replace(training.together, moved={wrap: own[:count] for wrap, own in moved.items()})
    # All muscles and poses, as in the fit, so that compiled functions are reused.
    engine = ExactPaths(describe_model(subject.model_file), list(wraps_of), fit.surrogate.coordinates)
    poses = {"training": fit_poses(subject, engine.coordinates, fit.seed).training}
    posed = {name: engine.posed(own) for name, own in poses.items()}
    source = EngineAnalyzer(engine, poses, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    for muscle in muscles:
        found, nominal = source.paths(muscle, samples, "training")
        length, moment_arm = (np.asarray(part)[:, SMOOTH_POSES] for part in (found.length, found.moment_arm))
        nominal_arm = np.asarray(nominal.moment_arm)[0, SMOOTH_POSES]
        spanned = {engine.coordinates[slot]: slot for slot in fit.surrogate.slots(muscle)}
        yield SampledPath(
            muscle=muscle,
            nominal=np.asarray(nominal.length)[0, SMOOTH_POSES],
            nominal_arms={name: nominal_arm[:, slot] for name, slot in spanned.items()},
            length=length,
            moment_arms={name: moment_arm[:, :, slot] for name, slot in spanned.items()},
            faults=measure_paths(found, nominal, SMOOTH_POSES).failed_criteria(
                thresholds or fit.wraps.thresholds
            ),
        )
