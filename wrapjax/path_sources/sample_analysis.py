"""Computation of muscle paths at samples of wrap parameters, by the exact engine or by OpenSim."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from wrapjax.geometry.engine import (
    GEODESIC,
    ExactPaths,
    PosedPath,
    Wrapping,
    nominal_parameters,
    wrap_at_samples,
)
from wrapjax.geometry.training_samples import SampleSet
from wrapjax.geometry.wrapping import WrappedPath
from wrapjax.osim.placed_analysis import analyse_placements

Poses = Float[np.ndarray, "pose coordinate"]


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
    return np.concatenate([nominal_parameters(len(wraps))[None], samples.parameters(wraps)])
