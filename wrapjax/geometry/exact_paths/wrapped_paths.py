"""Paths of the exact engine as a function of wrap parameters, with barriers at their discontinuities.

A path's length is discontinuous where a path point enters a surface, where the contact leaves a cylinder's
end, and where the wrap angle exceeds half a turn. A path that loses contact with a wrap in all poses is not
discontinuous, but no longer depends on the wrap. The proximity of a path to these barriers is zero far from
all of them and infinite beyond one. A penalty on the proximity keeps a solver where paths are smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.exact_paths.engine import GEODESIC, ExactPaths, PosedPath, Wrapping
from wrapjax.geometry.exact_paths.wrapping import NOMINAL_PARAMETERS, StraightPath, WrappedPath
from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.surfaces.wrap_methods import CLOSED_FORMS

# Largest clearance beyond a barrier (m) at which its proximity is one; less where nominal paths have less.
_UNIT_CLEARANCE = 1e-3
# If a nominal path has a smaller clearance (m) in any frame of a cycle, it counts as beyond the discontinuity
# in that cycle. A nominal path with a shorter contact (m) counts as not touching the wrap.
_MIN_CLEARANCE = 1e-4
# Largest distance (m) of a barrier from its discontinuity, or half of the nominal path's clearance if that is
# less. It is a margin for other recordings, in which paths come a little nearer.
_BARRIER_DISTANCE = 1e-3
# Largest contact length (m) at which the proximity to loss of contact is one; less where nominal paths have
# less.
_UNIT_CONTACT = 2e-3
# Added to a sum of squares to keep the derivative of its root finite far from all barriers.
_TINY = 1e-24
# Relative deviation of paths from their linearization, because of kinks at lift-off.
_RESOLUTION = 1e-6
_Tree = TypeVar("_Tree")


class Barriers(eqx.Module):
    """Barriers of paths: smallest clearances from discontinuities, and contacts that must not be lost."""

    #: Smallest clearance (m), the same in all poses of a cycle.
    limit: Float[Array, "*muscle pose barrier"]
    #: Clearance beyond the limit at which the proximity is one (m).
    unit_clearance: Float[Array, "*muscle pose barrier"]
    #: Longest contact with each wrap over all poses at which the proximity is one (m); zero for a wrap that
    #: the nominal path does not touch.
    unit_contact: Float[Array, "*muscle wrap"]

    def proximity(
        self, clearances: Float[Array, "pose barrier"], on_surface: Float[Array, "pose wrap"]
    ) -> Float[Array, " pose"]:
        """Compute the proximity (dimensionless) of a path to its barriers in each pose.

        It is the root of the sum over barriers of ``(unit_clearance / (clearance - limit))**4``, and infinite
        beyond a barrier. In all poses the sum includes ``(unit_contact / longest contact)**4`` of each wrap.

        Parameters
        ----------
        clearances
            Distances from each discontinuity (m), from `WrappedPath`.
        on_surface
            Length of the contact with each wrap (m).
        """
        longest = jnp.broadcast_to(jnp.max(on_surface, axis=0), on_surface.shape)
        distance = jnp.append(clearances - self.limit, longest, axis=-1)
        unit = jnp.append(self.unit_clearance, jnp.broadcast_to(self.unit_contact, on_surface.shape), axis=-1)
        allowed = (distance > 0.0) | (unit == 0.0)
        inverse = unit / jnp.where(distance > 0.0, distance, 1.0)
        finite = jnp.sqrt(jnp.sum(inverse**4, axis=-1))
        return jnp.where(jnp.all(allowed, axis=-1), finite, jnp.inf)


def barriers_around(nominal: WrappedPath, frames: int) -> Barriers:
    """Compute the barriers of nominal paths over recorded cycles.

    In a cycle in which a nominal path is beyond a discontinuity, the barrier is beyond the path.

    Parameters
    ----------
    nominal
        Nominal paths; the first axes of all leaves are ``muscle pose``, poses by cycle and frame.
    frames
        Number of frames of a cycle.
    """
    muscles, poses, barriers = nominal.clearances.shape
    by_cycle = nominal.clearances.reshape(muscles, poses // frames, frames, barriers)
    least = jnp.repeat(jnp.min(by_cycle, axis=2), frames, axis=1)
    clear = least > _MIN_CLEARANCE
    limit = jnp.where(clear, jnp.minimum(0.5 * least, _BARRIER_DISTANCE), least - _UNIT_CLEARANCE)
    longest = jnp.max(nominal.on_surface, axis=1)
    return Barriers(
        limit=limit,
        unit_clearance=jnp.minimum(least - limit, _UNIT_CLEARANCE),
        unit_contact=jnp.where(longest > _MIN_CLEARANCE, jnp.minimum(longest, _UNIT_CONTACT), 0.0),
    )


def proximity_curvature(
    weights: Float[Array, "muscle trial frame"],
    proximity: Float[Array, "muscle trial frame"],
    derivatives: Float[Array, "muscle mode trial frame"],
) -> Float[Array, "muscle mode mode"]:
    """Approximate the weighted sum of second derivatives of the proximity from its first derivatives.

    The proximity to a single barrier is ``p = (unit / d)**2`` with a distance d. Where d is linear in the
    changes, the second derivatives of p are ``1.5 / p`` times the products of its first derivatives. A
    Gauss-Newton solver without this term takes too large steps towards barriers, and converges slowly.

    Parameters
    ----------
    weights, proximity
        Weight and proximity in each frame.
    derivatives
        First derivatives of the proximity by the changes of each muscle.
    """
    near = proximity > 0.0
    factor = 1.5 * weights * jnp.where(near, 1.0 / jnp.where(near, proximity, 1.0), 0.0)
    return jnp.einsum("mtf,mitf,mjtf->mij", factor, derivatives, derivatives)


def combined_proximity(proximity: Float[Array, "_ frame"], trials: int) -> Float[Array, "trial frame"]:
    """Add the proximity in further cycles to that in the first cycles, at constant sum of squares.

    Parameters
    ----------
    proximity
        Proximity in all cycles.
    trials
        Number of first cycles to return.
    """
    further = proximity[trials:]
    if not len(further):
        return proximity
    layers = jnp.pad(further, ((0, -len(further) % trials), (0, 0))).reshape(-1, trials, proximity.shape[1])
    squares = proximity[:trials] ** 2 + jnp.sum(layers**2, axis=0)
    finite = jnp.isfinite(squares)
    return jnp.where(finite, jnp.sqrt(jnp.where(finite, squares, 0.0) + _TINY), jnp.inf)


class _MuscleGroup(eqx.Module):
    """Muscles with the same numbers of wraps and path segments, which share compiled programs."""

    #: Numbers of the muscles.
    muscles: Int[np.ndarray, " muscle"]
    #: The first axes of all leaves are ``muscle pose``.
    posed: PosedPath
    barriers: Barriers


class WrappedPaths(AbstractPath):
    """Paths of the exact engine over recorded cycles, as a function of wrap parameters.

    The changes of a muscle are the differences of its wraps' parameters (the first ``per_wrap`` of
    `PARAMETERS`, in their units) from nominal, one wrap after the other in the order of its path.
    """

    nominal: PathState
    #: Muscles of which a wrap may change.
    groups: tuple[_MuscleGroup, ...]
    #: Rates of the engine's coordinates, rad/s.
    velocities: Float[Array, "trial coordinate frame"]
    #: Number of each moment arm's coordinate among the engine's; their count for one that the engine lacks.
    columns: Int[np.ndarray, " moment_coordinate"]
    #: Largest number of wraps of a muscle.
    wraps: int = eqx.field(static=True)
    #: Number of parameters of a wrap.
    per_wrap: int = eqx.field(static=True)
    wrapping: Wrapping = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """Largest number of changes of a muscle."""
        return self.wraps * self.per_wrap

    @property
    def resolution(self) -> float:
        """Relative deviation from the linearization to tolerate; paths have kinks at lift-off from a wrap."""
        return _RESOLUTION

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Compute all paths at given changes of wrap parameters."""
        state = self.nominal
        for group in self.groups:
            own = changes[group.muscles, : self._changes_count(group)]
            moved = jax.vmap(self._path)(group.posed, group.barriers, own)
            state = jax.tree.map(lambda leaf, part, rows=group.muscles: leaf.at[rows].set(part), state, moved)
        return state

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Compute all paths, and the derivatives of each path by its own changes in forward mode."""
        state, count = self.nominal, changes.shape[1]
        derivatives = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], count, *leaf.shape[1:])), state)
        for group in self.groups:
            rows, size = group.muscles, self._changes_count(group)
            moved, by_change = jax.vmap(self._linearized_path)(
                group.posed, group.barriers, changes[rows, :size]
            )
            state = jax.tree.map(lambda leaf, part, rows=rows: leaf.at[rows].set(part), state, moved)
            derivatives = jax.tree.map(
                lambda leaf, part, rows=rows, size=size: leaf.at[rows, :size].set(part),
                derivatives,
                by_change,
            )
        return state, derivatives

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Compute the weighted sum of the second derivatives of each path by its own changes.

        Of paths round several surfaces, an ellipsoid or a torus only the second derivatives of the proximity
        are included, and these are approximate (`proximity_curvature`), because programs of second
        derivatives take minutes to compile.
        """

        def of_muscle(
            posed: PosedPath, barriers: Barriers, changes: Float[Array, " mode"], weights: PathState
        ) -> Array:
            def total(at: Float[Array, " mode"]) -> Float[Array, ""]:
                products = jax.tree.map(
                    lambda one, weight: jnp.vdot(one, weight), self._path(posed, barriers, at), weights
                )
                return jax.tree.reduce(jnp.add, products)

            # Forward mode twice is as fast as forward over reverse mode, and compiles in a quarter of the
            # time.
            return jax.jacfwd(jax.jacfwd(total))(changes)

        count = changes.shape[1]
        curvature = jnp.zeros((changes.shape[0], count, count))
        for group in self.groups:
            rows, size = group.muscles, self._changes_count(group)
            own, state, derivatives = jax.tree.map(lambda leaf, rows=rows: leaf[rows], (weights, *expansion))
            if isinstance(group.posed.path, StraightPath) and set(group.posed.kinds) <= CLOSED_FORMS:
                found = jax.vmap(of_muscle)(group.posed, group.barriers, changes[rows, :size], own)
            else:
                found = proximity_curvature(own.proximity, state.proximity, derivatives.proximity[:, :size])
            curvature = curvature.at[rows, :size, :size].set(found)
        return curvature

    def _changes_count(self, group: _MuscleGroup) -> int:
        """Count the changes of each muscle of a group."""
        return self.per_wrap * group.posed.surfaces.radius.shape[1]

    def _path(self, posed: PosedPath, barriers: Barriers, changes: Float[Array, " mode"]) -> PathState:
        parameters = (
            changes.reshape(-1, self.per_wrap) + jnp.asarray(NOMINAL_PARAMETERS)[None, : self.per_wrap]
        )
        path = posed.wrapped(parameters, self.wrapping)
        return _over_cycles(path, barriers, self.velocities, self.columns)

    def _linearized_path(
        self, posed: PosedPath, barriers: Barriers, changes: Float[Array, " mode"]
    ) -> tuple[PathState, PathState]:
        def along(direction: Float[Array, " mode"]) -> tuple[PathState, PathState]:
            return jax.jvp(lambda at: self._path(posed, barriers, at), (changes,), (direction,))

        return jax.vmap(along, out_axes=(None, 0))(jnp.eye(changes.size))


def _over_cycles(
    path: WrappedPath,
    barriers: Barriers,
    velocities: Float[Array, "trial coordinate frame"],
    columns: Int[Array | np.ndarray, " moment_coordinate"],
) -> PathState:
    """Arrange one muscle's path by cycle and frame, and compute its rate and proximity.

    Only the proximity of cycles beyond those of ``velocities`` is used.
    """
    trials, coordinates, frames = velocities.shape
    arms = jnp.moveaxis(path.moment_arm.reshape(-1, frames, coordinates)[:trials], -1, 1)
    zeros = jnp.zeros((trials, 1, frames))
    proximity = barriers.proximity(path.clearances, path.on_surface).reshape(-1, frames)
    return PathState(
        length=path.length.reshape(-1, frames)[:trials],
        velocity=-jnp.sum(arms * velocities, axis=1),
        moment_arm=jnp.concatenate([arms, zeros], axis=1)[:, columns],
        proximity=combined_proximity(proximity, trials),
    )


def wrapped_paths(
    engine: ExactPaths,
    angles: Float[np.ndarray, "trial coordinate frame"],
    velocities: Float[np.ndarray, "trial coordinate frame"],
    moment_coordinates: Sequence[str],
    free: Sequence[str],
    wrapping: Wrapping = GEODESIC,
    barrier_angles: Float[np.ndarray, "other_trial coordinate frame"] | None = None,
) -> tuple[WrappedPaths, Bool[np.ndarray, "muscle wrap"]]:
    """Compute the engine's paths over recorded cycles, as a function of the parameters of some wraps.

    Parameters
    ----------
    engine
        Engine of the muscles.
    angles, velocities
        Values (rad) and rates (rad/s) of the engine's coordinates.
    moment_coordinates
        Coordinates of the moment arms, which are zero for coordinates that the engine lacks.
    free
        Names of the wraps that may change. Muscles with none of them have fixed paths.
    wrapping
        `GEODESIC` or `PARITY`.
    barrier_angles
        Angles (rad) of further cycles with the same number of frames, in which barriers apply too.

    Returns
    -------
    paths, touching
        The paths, and whether each muscle touches each of its wraps in at least one frame (False for wraps
        that it does not have).
    """
    all_angles = angles if barrier_angles is None else np.concatenate([angles, barrier_angles])
    poses = np.moveaxis(all_angles, 1, -1).reshape(-1, angles.shape[1])
    posed = engine.posed(poses)
    columns = np.array(
        [
            engine.coordinates.index(name) if name in engine.coordinates else len(engine.coordinates)
            for name in moment_coordinates
        ]
    )
    most = max((len(engine.wraps_of(name)) for name in engine.muscles), default=0)
    touching = np.zeros((len(engine.muscles), most), dtype=bool)
    order: list[int] = []
    states: list[PathState] = []
    groups = []
    for names in _same_shape(posed):
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(posed[name] for name in names))
        wrapped = _wrapped(stacked, wrapping)
        barriers = barriers_around(wrapped, angles.shape[2])
        rows = [engine.muscles.index(name) for name in names]
        touching[rows, : wrapped.touching.shape[-1]] = np.asarray(wrapped.touching).any(axis=1)
        order += rows
        states.append(_each_over_cycles(wrapped, barriers, jnp.asarray(velocities), columns))
        freed = np.flatnonzero([bool(set(engine.wraps_of(name)) & set(free)) for name in names])
        if freed.size:
            groups.append(_MuscleGroup(np.array(rows)[freed], *_rows_of((stacked, barriers), freed)))
    paths = WrappedPaths(
        nominal=jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[np.argsort(order)], *states),
        groups=tuple(groups),
        velocities=jnp.asarray(velocities),
        columns=columns,
        wraps=most,
        per_wrap=len(engine.parameters),
        wrapping=wrapping,
    )
    return paths, touching


@eqx.filter_jit
def _each_over_cycles(
    path: WrappedPath,
    barriers: Barriers,
    velocities: Float[Array, "trial coordinate frame"],
    columns: Int[Array | np.ndarray, " moment_coordinate"],
) -> PathState:
    """Apply `_over_cycles` to several muscles; the first axis of all leaves is ``muscle``."""
    return jax.vmap(_over_cycles, in_axes=(0, 0, None, None))(path, barriers, velocities, columns)


def _rows_of(tree: _Tree, rows: Int[np.ndarray, " row"]) -> _Tree:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _same_shape(posed: dict[str, PosedPath]) -> list[list[str]]:
    """Group muscles that share programs: by the number and kinds of wraps and, if several, of points."""
    names: dict[tuple[int | str, ...], list[str]] = {}
    for name, one in posed.items():
        points = () if isinstance(one.path, StraightPath) else one.path.position.shape[1:2]
        names.setdefault((one.surfaces.radius.size, *points, *one.kinds), []).append(name)
    return list(names.values())


@eqx.filter_jit
def _wrapped(posed: PosedPath, wrapping: Wrapping) -> WrappedPath:
    """Compute paths of several muscles round nominal wraps."""
    parameters = jnp.tile(jnp.asarray(NOMINAL_PARAMETERS), (posed.surfaces.radius.shape[1], 1))
    return jax.vmap(lambda one: one.wrapped(parameters, wrapping))(posed)
