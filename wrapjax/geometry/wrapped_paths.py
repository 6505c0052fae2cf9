"""Walls that a path must not get over: jumps to the other side of a cylinder, and losing touch with it.

How close a path comes to them is the root of a sum of squares, zero far from all of them and infinite beyond
one: a penalty on it keeps a solver where paths are smooth.

Paths that follow their cylinders: the exact engine as a source of adjustable paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from wrapjax.geometry.engine import GEODESIC, ExactPaths, PosedPath, Wrapping
from wrapjax.geometry.paths import AbstractPath, PathState
from wrapjax.geometry.wrapping import NOMINAL, WRAP_PARAMETERS, StraightPath, WrappedPath

# Clearance (m) that makes closeness one, where nominal paths have so much. Where they have less than
# the second figure in any frame of a cycle, they are taken to cross in that cycle anyway.
_ROOM, _CROSSED = 1e-3, 1e-4
# Walls stand so far (m) before a jump, or half as far as nominal paths are from it if that is less: other
# walking comes a little nearer.
_KEPT = 1e-3
# Longest stretch on a cylinder (m) that makes closeness one, where nominal paths have so much.
_GRIP = 2e-3
# Keeps the root's slope finite for paths that no wall is near to.
_TINY = 1e-24


class Walls(eqx.Module):
    """What a path must not get over: clearances to keep, and cylinders to stay in touch with (m)."""

    #: The same in all poses of a cycle.
    limit: Float[Array, "*muscle pose wall"]
    #: Clearance beyond the limit at which closeness is one.
    room: Float[Array, "*muscle pose wall"]
    #: Longest stretch on each cylinder, over all poses, at which closeness is one; zero for one that the
    #: nominal path does not touch.
    grip: Float[Array, "*muscle wrap"]

    def proximity(
        self, clearances: Float[Array, "pose wall"], on_surface: Float[Array, "pose wrap"]
    ) -> Float[Array, " pose"]:
        """Root of the sum over walls of ``(room / clearance)**4``; infinite beyond a wall.

        To touch a cylinder in no pose is a wall to all of them.
        """
        longest = jnp.broadcast_to(jnp.max(on_surface, axis=0), on_surface.shape)
        left = jnp.append(clearances - self.limit, longest, axis=-1)
        room = jnp.append(self.room, jnp.broadcast_to(self.grip, on_surface.shape), axis=-1)
        open_to = (left > 0.0) | (room == 0.0)
        inverse = room / jnp.where(left > 0.0, left, 1.0)
        within = jnp.sqrt(jnp.sum(inverse**4, axis=-1))
        return jnp.where(jnp.all(open_to, axis=-1), within, jnp.inf)


def walls_before(nominal: WrappedPath, frames: int) -> Walls:
    """Set up walls where nominal paths leave room; in cycles where they cross one, a little further on."""
    muscles, poses, barriers = nominal.clearances.shape
    by_cycle = nominal.clearances.reshape(muscles, poses // frames, frames, barriers)
    least = jnp.repeat(jnp.min(by_cycle, axis=2), frames, axis=1)
    free = least > _CROSSED
    limit = jnp.where(free, jnp.minimum(0.5 * least, _KEPT), least - _ROOM)
    longest = jnp.max(nominal.on_surface, axis=1)
    return Walls(
        limit=limit,
        room=jnp.minimum(least - limit, _ROOM),
        grip=jnp.where(longest > _CROSSED, jnp.minimum(longest, _GRIP), 0.0),
    )


def bent_by_walls(
    weights: Float[Array, "muscle trial frame"],
    proximity: Float[Array, "muscle trial frame"],
    slopes: Float[Array, "muscle mode trial frame"],
) -> Float[Array, "muscle mode mode"]:
    """Differentiate closeness twice as if one wall stood in each frame, which its slopes tell all of.

    As ``(room / clearance)**2`` it bends by 1.5 times its squared slope over itself, apart from how the
    clearance bends. Near a wall that is more than slopes alone show a solver of least squares, which would
    step too far and zigzag along it.
    """
    near = proximity > 0.0
    factor = 1.5 * weights * jnp.where(near, 1.0 / jnp.where(near, proximity, 1.0), 0.0)
    return jnp.einsum("mtf,mitf,mjtf->mij", factor, slopes, slopes)


def folded(proximity: Float[Array, "_ frame"], trials: int) -> Float[Array, "trial frame"]:
    """Lay the closeness of cycles beside over that of the first so many: squares add up to the same sum."""
    beside = proximity[trials:]
    if not len(beside):
        return proximity
    layers = jnp.pad(beside, ((0, -len(beside) % trials), (0, 0))).reshape(-1, trials, proximity.shape[1])
    squares = proximity[:trials] ** 2 + jnp.sum(layers**2, axis=0)
    within = jnp.isfinite(squares)
    return jnp.where(within, jnp.sqrt(jnp.where(within, squares, 0.0) + _TINY), jnp.inf)


_PER_WRAP = len(WRAP_PARAMETERS)
_RESOLUTION = 1e-6
_Tree = TypeVar("_Tree")


class _Alike(eqx.Module):
    """Muscles with as many cylinders and as many pieces of path, so that one program serves all."""

    muscles: Int[np.ndarray, " muscle"]
    #: Leaves lead with ``muscle pose``.
    posed: PosedPath
    barriers: Walls


class WrappedPaths(AbstractPath):
    """Paths over recorded cycles that change with their cylinders' parameters.

    The changes of a muscle are what its cylinders' parameters (`WRAP_PARAMETERS`, in their units) differ
    from nominal by, one cylinder after the other in the order of its path.
    """

    nominal: PathState
    alike: tuple[_Alike, ...]
    #: Of the engine's coordinates, rad/s.
    velocities: Float[Array, "trial coordinate frame"]
    #: Where each moment's coordinate is among the engine's; past the last one where it is not.
    columns: Int[np.ndarray, " moment_coordinate"]
    #: Most cylinders that a muscle has.
    wraps: int = eqx.field(static=True)
    wrapping: Wrapping = eqx.field(static=True)

    @property
    def modes_count(self) -> int:
        """How many changes a muscle has at most."""
        return self.wraps * _PER_WRAP

    @property
    def resolution(self) -> float:
        """Paths have kinks where they come to touch a cylinder, in one frame or another."""
        return _RESOLUTION

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths round their cylinders where these changes put them."""
        state = self.nominal
        for group in self.alike:
            own = changes[group.muscles, : _changes_of(group)]
            moved = jax.vmap(self._path)(group.posed, group.barriers, own)
            state = jax.tree.map(
                lambda whole, part, rows=group.muscles: whole.at[rows].set(part), state, moved
            )
        return state

    def linearized(self, changes: Float[Array, "muscle mode"]) -> tuple[PathState, PathState]:
        """Give all paths, and differentiate each by its own changes in forward mode."""
        state, count = self.nominal, changes.shape[1]
        slopes = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], count, *leaf.shape[1:])), state)
        for group in self.alike:
            rows, size = group.muscles, _changes_of(group)
            moved, by_change = jax.vmap(self._linearized_path)(
                group.posed, group.barriers, changes[rows, :size]
            )
            state = jax.tree.map(lambda whole, part, rows=rows: whole.at[rows].set(part), state, moved)
            slopes = jax.tree.map(
                lambda whole, part, rows=rows, size=size: whole.at[rows, :size].set(part), slopes, by_change
            )
        return state, slopes

    def curvature(
        self,
        changes: Float[Array, "muscle mode"],
        weights: PathState,
        expansion: tuple[PathState, PathState],
    ) -> Float[Array, "muscle mode mode"]:
        """Differentiate paths round one cylinder twice by its parameters, and sum with these weights.

        Of paths round several only how walls bend is told: to compile their second derivatives takes minutes.
        """

        def of_one(
            posed: PosedPath, barriers: Walls, changes: Float[Array, " mode"], weights: PathState
        ) -> Array:
            def total(at: Float[Array, " mode"]) -> Float[Array, ""]:
                products = jax.tree.map(
                    lambda one, weight: jnp.vdot(one, weight), self._path(posed, barriers, at), weights
                )
                return jax.tree.reduce(jnp.add, products)

            # Forward twice: as quick as the usual reverse first, and compiled in a quarter of the time.
            return jax.jacfwd(jax.jacfwd(total))(changes)

        count = changes.shape[1]
        curvature = jnp.zeros((changes.shape[0], count, count))
        for group in self.alike:
            rows, size = group.muscles, _changes_of(group)
            own, state, slopes = jax.tree.map(lambda leaf, rows=rows: leaf[rows], (weights, *expansion))
            if isinstance(group.posed.path, StraightPath):
                found = jax.vmap(of_one)(group.posed, group.barriers, changes[rows, :size], own)
            else:
                found = bent_by_walls(own.proximity, state.proximity, slopes.proximity[:, :size])
            curvature = curvature.at[rows, :size, :size].set(found)
        return curvature

    def _path(self, posed: PosedPath, barriers: Walls, changes: Float[Array, " mode"]) -> PathState:
        parameters = changes.reshape(-1, _PER_WRAP) + jnp.asarray(NOMINAL)[None]
        path = posed.wrapped(parameters, self.wrapping)
        return _over_cycles(path, barriers, self.velocities, self.columns)

    def _linearized_path(
        self, posed: PosedPath, barriers: Walls, changes: Float[Array, " mode"]
    ) -> tuple[PathState, PathState]:
        def along(direction: Float[Array, " mode"]) -> tuple[PathState, PathState]:
            return jax.jvp(lambda at: self._path(posed, barriers, at), (changes,), (direction,))

        return jax.vmap(along, out_axes=(None, 0))(jnp.eye(changes.size))


def _changes_of(group: _Alike) -> int:
    return _PER_WRAP * group.posed.surfaces.radius.shape[1]


def _over_cycles(
    path: WrappedPath,
    barriers: Walls,
    velocities: Float[Array, "trial coordinate frame"],
    columns: Int[Array | np.ndarray, " moment_coordinate"],
) -> PathState:
    """Arrange a path's poses by cycle and frame, and add its rate; of cycles beside take the closeness."""
    trials, coordinates, frames = velocities.shape
    arms = jnp.moveaxis(path.moment_arm.reshape(-1, frames, coordinates)[:trials], -1, 1)
    nothing = jnp.zeros((trials, 1, frames))
    proximity = barriers.proximity(path.clearances, path.on_surface).reshape(-1, frames)
    return PathState(
        length=path.length.reshape(-1, frames)[:trials],
        velocity=-jnp.sum(arms * velocities, axis=1),
        moment_arm=jnp.concatenate([arms, nothing], axis=1)[:, columns],
        proximity=folded(proximity, trials),
    )


def wrapped_paths(
    engine: ExactPaths,
    angles: Float[np.ndarray, "trial coordinate frame"],
    velocities: Float[np.ndarray, "trial coordinate frame"],
    moment_coordinates: Sequence[str],
    free: Sequence[str],
    wrapping: Wrapping = GEODESIC,
    beside: Float[np.ndarray, "other_trial coordinate frame"] | None = None,
) -> tuple[WrappedPaths, Bool[np.ndarray, "muscle wrap"]]:
    """Lay the engine's paths through recorded cycles.

    Parameters
    ----------
    engine
        Of the muscles, in the order wanted.
    angles, velocities
        Of the engine's coordinates: rad and rad/s.
    moment_coordinates
        What moment arms are wanted about.
    free
        Cylinders that may move. Paths that run by none of them stay as they are.
    wrapping
        `GEODESIC` or `PARITY`.
    beside
        Angles of other cycles, of as many frames, that paths must get over no wall in either.

    Returns
    -------
    paths, touching
        The paths, and which of its cylinders each muscle lies on in at least one frame (False where it
        has fewer).
    """
    every = angles if beside is None else np.concatenate([angles, beside])
    poses = np.moveaxis(every, 1, -1).reshape(-1, angles.shape[1])
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
    movable = []
    for kind in _kinds(posed):
        posed_alike = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(posed[name] for name in kind))
        wrapped = _wrapped(posed_alike, wrapping)
        barriers = walls_before(wrapped, angles.shape[2])
        rows = [engine.muscles.index(name) for name in kind]
        touching[rows, : wrapped.touching.shape[-1]] = np.asarray(wrapped.touching).any(axis=1)
        order += rows
        states.append(_each_over_cycles(wrapped, barriers, jnp.asarray(velocities), columns))
        own = np.flatnonzero([bool(set(engine.wraps_of(name)) & set(free)) for name in kind])
        if own.size:
            movable.append(_Alike(np.array(rows)[own], *_rows_of((posed_alike, barriers), own)))
    paths = WrappedPaths(
        nominal=jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[np.argsort(order)], *states),
        alike=tuple(movable),
        velocities=jnp.asarray(velocities),
        columns=columns,
        wraps=most,
        wrapping=wrapping,
    )
    return paths, touching


@eqx.filter_jit
def _each_over_cycles(
    path: WrappedPath,
    barriers: Walls,
    velocities: Float[Array, "trial coordinate frame"],
    columns: Int[Array | np.ndarray, " moment_coordinate"],
) -> PathState:
    """Arrange many muscles' paths; leaves lead with ``muscle``."""
    return jax.vmap(_over_cycles, in_axes=(0, 0, None, None))(path, barriers, velocities, columns)


def _rows_of(tree: _Tree, rows: Int[np.ndarray, " row"]) -> _Tree:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _kinds(posed: dict[str, PosedPath]) -> list[list[str]]:
    """Sort muscles by what needs a program of its own: how many cylinders, and points if several."""
    kinds: dict[tuple[int, ...], list[str]] = {}
    for name, one in posed.items():
        points = () if isinstance(one.path, StraightPath) else one.path.position.shape[1:2]
        kinds.setdefault((one.surfaces.radius.size, *points), []).append(name)
    return list(kinds.values())


@eqx.filter_jit
def _wrapped(posed: PosedPath, wrapping: Wrapping) -> WrappedPath:
    """Wrap many muscles' paths round their nominal cylinders."""
    parameters = jnp.tile(jnp.asarray(NOMINAL), (posed.surfaces.radius.shape[1], 1))
    return jax.vmap(lambda one: one.wrapped(parameters, wrapping))(posed)
