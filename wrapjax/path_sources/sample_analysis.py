"""Where the paths of sampled cylinders come from: the exact engine, or OpenSim."""

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
    """Analyses paths at samples of their cylinders."""

    @property
    def poses(self) -> dict[str, Poses]:
        """Poses by name."""
        ...

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """Analyse one muscle at all samples and with nominal cylinders, in the poses of this name.

        Leaves lead with ``sample pose``, with one sample for the nominal path.
        """
        ...


@dataclass(frozen=True)
class EngineAnalyzer:
    """The exact engine: millions of paths a second."""

    engine: ExactPaths
    poses: dict[str, Poses]
    #: By name of the poses, then by muscle.
    posed: dict[str, dict[str, PosedPath]]
    wrapping: Wrapping = GEODESIC

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """See `PathAnalyzer`."""
        parameters = _with_nominal_first(samples, self.engine.wraps_of(muscle))
        found = wrap_at_samples(self.posed[poses][muscle], parameters, self.wrapping)
        return jax.tree.map(lambda leaf: leaf[1:], found), jax.tree.map(lambda leaf: leaf[:1], found)


@dataclass(frozen=True)
class OpenSimAnalyzer:
    """OpenSim: the judge of lengths and moment arms; what jumps and touches the engine says.

    Every sample of a set is analysed once for all its muscles, and kept on disk.
    """

    model_file: Path
    flags: EngineAnalyzer
    poses: dict[str, Poses]
    processes: int | None
    quiet: bool

    def paths(self, muscle: str, samples: SampleSet, poses: str) -> tuple[WrappedPath, WrappedPath]:
        """See `PathAnalyzer`."""
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
        judged = analysed.of(muscle)
        found, nominal = self.flags.paths(muscle, samples, poses)
        return (
            _with(found, *(part[1:] for part in judged)),
            _with(nominal, *(part[:1] for part in judged)),
        )


def _with(
    path: WrappedPath,
    length: Float[np.ndarray, "sample pose"],
    moment_arm: Float[np.ndarray, "sample pose coordinate"],
) -> WrappedPath:
    return eqx.tree_at(lambda path: (path.length, path.moment_arm), path, (length, moment_arm))


def _with_nominal_first(
    samples: SampleSet, wraps: tuple[str, ...]
) -> Float[np.ndarray, "sample wrap wrap_parameter"]:
    # Not on their own: another number of samples would be another program to compile.
    return np.concatenate([nominal_parameters(len(wraps))[None], samples.parameters(wraps)])
