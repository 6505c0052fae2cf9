"""Muscle paths of an OpenSim model as a library: lengths and moment arms, and their derivatives.

Neither EMG nor recordings are needed. `muscle_paths` reads a model; `MusclePaths.posed` computes all that
does not depend on wrap parameters, and `PosedMuscles` is a pure function of these, for `jax.jit`, `jax.grad`
and `jax.vmap`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.exact_paths.engine import GEODESIC, PARITY, ExactPaths, Wrapping
from wrapjax.geometry.exact_paths.muscle_batches import MuscleBatch, muscle_batches
from wrapjax.geometry.exact_paths.wrapping import (
    NOMINAL_PARAMETERS,
    PARAMETERS,
    StraightPath,
    WrappedPath,
)
from wrapjax.geometry.skeleton.model_description import ModelDescription
from wrapjax.jax_setup import require_float64
from wrapjax.osim.model import describe_model, unknown_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

#: Ways to wrap: the shortest path, and OpenSim 4.6's path.
MODES: dict[str, Wrapping] = {"geodesic": GEODESIC, "parity": PARITY}
# Step of central differences of points and bodies by coordinates, rad or m.
_STEP = 1e-4
# Poses in which points inside of wraps are looked for.
_LOOKED_AT = 20
# Most poses in one batch.
_BATCH = 512


class PathValues(eqx.Module):
    """Lengths and moment arms of muscles in poses."""

    #: m
    length: Float[Array | np.ndarray, "pose muscle"]
    #: -dL/dq, m (m/rad).
    moment_arm: Float[Array | np.ndarray, "pose coordinate muscle"]
    #: Whether a muscle touches any of its wraps.
    touching: Bool[Array | np.ndarray, "pose muscle"]
    #: Whether the path is at a distance from all discontinuities of its length: no point is inside a surface,
    #: no contact at a cylinder's end or above half a turn, and contacts with several surfaces converge.
    regular: Bool[Array | np.ndarray, "pose muscle"]


class PosedMuscles(eqx.Module):
    """Paths of muscles in given poses as a pure function of wrap parameters."""

    batches: tuple[MuscleBatch, ...]
    muscles: int = eqx.field(static=True)
    wraps: int = eqx.field(static=True)
    wrapping: Wrapping = eqx.field(static=True)

    def __call__(self, parameters: Float[Array, "wrap wrap_parameter"] | None = None) -> PathValues:
        """Compute all paths.

        Parameters
        ----------
        parameters
            Values of `PARAMETERS` of each wrap in the order of `MusclePaths.wraps`; by default nominal.
        """
        if parameters is None:
            parameters = jnp.tile(jnp.asarray(NOMINAL_PARAMETERS), (max(self.wraps, 1), 1))
        order = jnp.concatenate([jnp.asarray(batch.muscles) for batch in self.batches])
        values = []
        for batch in self.batches:
            own = parameters[batch.wraps]
            values.append(_values(_batch_paths(batch, own, self.wrapping)))
        place = jnp.argsort(order)
        joined = (jnp.concatenate(leaves)[place] for leaves in zip(*values, strict=True))
        return PathValues(*(jnp.moveaxis(leaf, 0, -1) for leaf in joined))


def _batch_paths(
    batch: MuscleBatch, parameters: Float[Array, "muscle wrap wrap_parameter"], wrapping: Wrapping
) -> WrappedPath:
    if isinstance(batch.posed.path, StraightPath):
        return jax.vmap(lambda posed, own: posed.wrapped(own, wrapping))(batch.posed, parameters)
    # One muscle after the other, so that only the methods of its own surfaces are evaluated.
    return jax.lax.map(lambda one: one[0].wrapped(one[1], wrapping), (batch.posed, parameters))


def _values(path: WrappedPath) -> tuple[Array, Array, Array, Array]:
    """Fields of `PathValues` of some muscles; the first axis of all is ``muscle``."""
    margins = jnp.stack([path.margins.inside, path.margins.off_end, path.margins.long_wrap])
    touching = jnp.any(path.on_surface != 0.0, axis=-1)
    return path.length, path.moment_arm, touching, jnp.all(margins > 0.0, axis=0)


@dataclass(frozen=True)
class MusclePaths:
    """Muscle paths of a model.

    Parameters
    ----------
    engine
        Engine of the muscles.
    mode
        ``geodesic`` or ``parity``.
    unsupported
        Reason why the path of a muscle cannot be computed, by the names of such muscles.
    """

    engine: ExactPaths
    mode: str
    unsupported: dict[str, str]

    @property
    def muscles(self) -> tuple[str, ...]:
        """Names of the muscles."""
        return self.engine.muscles

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of poses and moment arms."""
        return self.engine.coordinates

    @property
    def wraps(self) -> tuple[str, ...]:
        """Names of the wraps of all muscles."""
        names = (wrap for muscle in self.muscles for wrap in self.engine.wraps_of(muscle))
        return tuple(dict.fromkeys(names))

    @property
    def wrap_parameters(self) -> tuple[str, ...]:
        """Names of the parameters of each wrap, with their units; a surface depends on some of them."""
        return PARAMETERS

    @property
    def nominal(self) -> Float[np.ndarray, "wrap wrap_parameter"]:
        """Wrap parameters (`wrap_parameters`) as the model has them."""
        return np.tile(NOMINAL_PARAMETERS, (len(self.wraps), 1))

    def posed(self, poses: Float[np.ndarray, "pose coordinate"]) -> PosedMuscles:
        """Compute path points in poses, and return the paths as a function of wrap parameters.

        Parameters
        ----------
        poses
            Values of `coordinates`, rad or m.
        """
        found = self.engine.posed(self._checked(poses))
        wraps_of = {name: self.engine.wraps_of(name) for name in self.muscles}
        batches = muscle_batches(found, wraps_of, self.wraps)
        return PosedMuscles(batches, len(self.muscles), len(self.wraps), MODES[self.mode])

    def __call__(
        self,
        poses: Float[np.ndarray, "pose coordinate"],
        parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
    ) -> PathValues:
        """Compute lengths and moment arms in poses, in batches of a compiled program.

        Parameters
        ----------
        poses
            Values of `coordinates`, rad or m.
        parameters
            Wrap parameters (`wrap_parameters`) of `wraps`; by default nominal.

        Returns
        -------
        PathValues
            NumPy arrays.
        """
        poses = np.asarray(poses, dtype=float)
        parameters = self.nominal if parameters is None else parameters
        size = min(len(poses), _BATCH)
        parts = []
        for first in range(0, len(poses), size):
            part = poses[first : first + size]
            padded = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
            values = _evaluated(self.posed(padded), jnp.asarray(parameters))
            parts.append(jax.tree.map(np.asarray, values))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(poses)], *parts)

    def points_inside(self, poses: Float[np.ndarray, "pose coordinate"]) -> dict[str, dict[str, float]]:
        """Find wraps that a path point is inside of in every pose, so that OpenSim never uses them.

        Parameters
        ----------
        poses
            Values of `coordinates`, rad or m; 20 of them are looked at.

        Returns
        -------
        depth
            By muscle and wrap: the least depth of such a point in any pose, m.
        """
        some = np.unique(np.linspace(0, len(poses) - 1, _LOOKED_AT).round().astype(int))
        found = {}
        for name, posed in self.engine.posed(self._checked(poses)[some]).items():
            outside = np.asarray(posed.nearest_points()).max(axis=0, initial=-np.inf)
            own = zip(self.engine.wraps_of(name), outside.tolist(), strict=True)
            if inside := {wrap: -distance for wrap, distance in own if distance < 0.0}:
                found[name] = inside
        return found

    def to_dataset(
        self,
        poses: Float[np.ndarray, "pose coordinate"],
        parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
    ) -> Dataset:
        """Return lengths and moment arms as an `xarray.Dataset`; arguments as for calling the object."""
        from wrapjax.report.labelled.geometry import muscle_path_dataset

        poses = self._checked(poses)
        return muscle_path_dataset(self, poses, self(poses, parameters))

    def plot_modes(self, muscles: Sequence[str], poses: Float[np.ndarray, "pose coordinate"]) -> Figure:
        """Draw lengths and moment arms over a gait cycle by both modes, and their differences.

        Parameters
        ----------
        muscles
            Names of the muscles, a pair of rows each.
        poses
            Evenly spaced values of `coordinates` over a gait cycle, rad or m.

        Raises
        ------
        ValueError
            If there is no such muscle, or poses are not those of `coordinates`.
        """
        from wrapjax.report.paths.wrapping_modes import compare_wrapping_modes, wrapping_modes_figure

        self._check_muscles(muscles)
        poses, model = self._checked(poses), self.engine.model
        return wrapping_modes_figure(
            [compare_wrapping_modes(model, name, self.coordinates, poses) for name in muscles]
        )

    def plot_moved_wraps(
        self,
        muscle: str,
        pose: Float[np.ndarray, " coordinate"],
        parameters: Float[np.ndarray, "wrap wrap_parameter"],
    ) -> Figure:
        """Draw a muscle's shortest path round the nominal and round moved wraps, in a pose.

        Parameters
        ----------
        muscle
            Name of the muscle.
        pose, parameters
            As for calling the object.

        Raises
        ------
        ValueError
            If there is no such muscle, or the pose or the parameters have another shape.
        """
        from wrapjax.report.paths.moved_paths import path_round_moved_wraps
        from wrapjax.report.paths.path_views import path_view_figure

        self._check_muscles([muscle])
        (pose,) = self._checked(np.asarray(pose)[None])
        if np.shape(parameters) != self.nominal.shape:
            raise ValueError(
                f"expected {len(self.wraps)} x {len(PARAMETERS)} wrap parameters, "
                f"found {' x '.join(map(str, np.shape(parameters)))}"
            )
        own = np.asarray(parameters)[[self.wraps.index(wrap) for wrap in self.engine.wraps_of(muscle)]]
        return path_view_figure(
            [path_round_moved_wraps(self.engine.model, muscle, self.coordinates, pose, own)]
        )

    def _check_muscles(self, names: Sequence[str]) -> None:
        for name in names:
            if name not in self.muscles:
                raise ValueError(f"there is no muscle '{name}': {nearest_name(name, self.muscles)}")

    def _checked(self, poses: Float[np.ndarray, "pose _"]) -> Float[np.ndarray, "pose coordinate"]:
        """Return poses in double precision, if they have a column for each coordinate."""
        poses = np.asarray(poses, dtype=float)
        if poses.ndim != 2 or poses.shape[1] != len(self.coordinates):
            raise ValueError(
                f"expected poses with {len(self.coordinates)} columns ({', '.join(self.coordinates)}), "
                f"found shape {poses.shape}"
            )
        return poses

    def moment_arm_slopes(
        self,
        poses: Float[np.ndarray, "pose coordinate"],
        parameters: Float[np.ndarray, "wrap wrap_parameter"] | None = None,
    ) -> Float[np.ndarray, "pose coordinate coordinate muscle"]:
        """Compute derivatives of moment arms by coordinates (m/rad^2).

        The second axis is the coordinate to differentiate by. Derivatives of length are minus the moment
        arms: exactly for shortest paths.

        Parameters
        ----------
        poses, parameters
            As for calling the object.

        Notes
        -----
        Paths are differentiated exactly in forward mode, with the points of contact by the implicit function
        theorem. Only positions and velocities of points and bodies, smooth functions without wrapping, are
        differentiated by central differences of fourth order, to about 1e-11 m/rad^2. At kinks of moment
        arms, where a path begins to touch, the slope is that of one side. At an end of a conditional point's
        range there is no slope.
        """
        poses = np.asarray(poses, dtype=float)
        own = jnp.asarray(self.nominal if parameters is None else parameters)
        size = min(len(poses), _BATCH)
        parts = []
        for first in range(0, len(poses), size):
            part = poses[first : first + size]
            padded = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
            rates = [self._rates(padded, column) for column in range(poses.shape[1])]
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rates)
            slopes = _slopes(self.posed(padded), stacked, own)
            parts.append(np.moveaxis(np.asarray(slopes), 0, 1)[: len(part)])
        return np.concatenate(parts)

    def _rates(self, poses: Float[np.ndarray, "pose coordinate"], column: int) -> PosedMuscles:
        """Differentiate positions and velocities of points and bodies by a coordinate; others are None."""
        step = _STEP * np.eye(poses.shape[1])[column]
        ahead, behind, two_ahead, two_behind = (
            eqx.filter(self.posed(poses + steps * step), eqx.is_inexact_array) for steps in (1, -1, 2, -2)
        )

        def rate(one: Array, other: Array, two: Array, other_two: Array) -> Array:
            return (8.0 * (one - other) - (two - other_two)) / (12.0 * _STEP)

        return jax.tree.map(rate, ahead, behind, two_ahead, two_behind)


@eqx.filter_jit
def _slopes(
    posed: PosedMuscles, rates: PosedMuscles, parameters: Float[Array, "wrap wrap_parameter"]
) -> Float[Array, "other_coordinate pose coordinate muscle"]:
    """Differentiate moment arms along rates of points and bodies, of which the first axis is a coordinate."""
    moving, fixed = eqx.partition(posed, eqx.is_inexact_array)

    def along(rate: PosedMuscles) -> Array:
        def moment_arm(moving: PosedMuscles) -> Array:
            return eqx.combine(moving, fixed)(parameters).moment_arm

        return jax.jvp(moment_arm, (moving,), (rate,))[1]

    return jax.vmap(along)(rates)


@eqx.filter_jit
def _evaluated(posed: PosedMuscles, parameters: Float[Array, "wrap wrap_parameter"]) -> PathValues:
    return posed(parameters)


def muscle_paths(
    model_file: Path | str,
    *,
    mode: str = "geodesic",
    muscles: Sequence[str] | None = None,
    coordinates: Sequence[str] | None = None,
    skip_unsupported: bool = False,
) -> MusclePaths:
    """Read the muscle paths of an OpenSim model, to compute lengths and moment arms without OpenSim.

    Parameters
    ----------
    model_file
        OpenSim model (.osim).
    mode
        ``geodesic``, shortest paths, whose moment arms are exactly -dL/dq; or ``parity``, paths as OpenSim
        4.6 computes them, defects included.
    muscles
        Names of muscles; by default all.
    coordinates
        Names of coordinates of poses and moment arms; by default all that any of the muscles spans. Others
        stay at the model's defaults or follow their couplers.
    skip_unsupported
        Whether to leave out muscles whose path cannot be computed, instead of raising an error.

    Returns
    -------
    MusclePaths
        Called with poses it returns lengths (m) and moment arms (m, m/rad).

    Raises
    ------
    InputError
        If OpenSim cannot load the model, it has no such muscle or coordinate, or the path of a muscle cannot
        be computed and is not to be left out. All such muscles are named.
    ValueError
        If the mode is unknown.

    Examples
    --------
    >>> paths = wrapjax.muscle_paths("model.osim")  # doctest: +SKIP
    >>> values = paths(np.zeros((1, len(paths.coordinates))))  # doctest: +SKIP
    >>> posed = paths.posed(poses)  # doctest: +SKIP
    >>> misfit = lambda p: jnp.sum((posed(p).moment_arm - measured) ** 2)  # doctest: +SKIP
    >>> jax.jacfwd(misfit)(jnp.asarray(paths.nominal))  # doctest: +SKIP
    """
    require_float64()
    if mode not in MODES:
        raise ValueError(f"unknown mode '{mode}': expected one of {', '.join(MODES)}")
    model = describe_model(model_file)
    known = [muscle.name for muscle in model.muscles]
    problems = unknown_names(model_file, "muscle", muscles or (), known)
    known_coordinates = [coordinate.name for coordinate in model.coordinates]
    problems += unknown_names(model_file, "coordinate", coordinates or (), known_coordinates)
    if problems:
        raise InputError(problems)
    names = tuple(known if muscles is None else muscles)
    unsupported = {name: reason for name in names if (reason := unsupported_reason(model, name))}
    if unsupported and not (skip_unsupported and len(unsupported) < len(names)):
        raise InputError(
            [
                Problem(
                    str(model_file),
                    reason,
                    place=f"muscle {name}",
                    hint="leave it out with --skip-unsupported",
                )
                for name, reason in unsupported.items()
            ]
        )
    names = tuple(name for name in names if name not in unsupported)
    if coordinates is None:
        spanned = {coordinate for name in names for coordinate in model.spanned_by(name)}
        coordinates = [name for name in known_coordinates if name in spanned]
    return MusclePaths(ExactPaths(model, names, tuple(coordinates)), mode, unsupported)


def unsupported_reason(model: ModelDescription, muscle: str) -> str | None:
    """Say why a muscle's path cannot be computed; None if it can."""
    try:
        engine = ExactPaths(model, (muscle,), model.spanned_by(muscle))
        defaults = [model.coordinate(name).default_value for name in engine.coordinates]
        engine.posed(np.array([defaults]))
    except InputError as error:
        return "; ".join(problem.message for problem in error.problems)
    return None
