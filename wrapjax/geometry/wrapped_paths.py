"""Paths that follow their cylinders: the exact engine as a source of adjustable paths."""

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
from wrapjax.geometry.surfaces import NOMINAL, WRAP_PARAMETERS
from wrapjax.geometry.wrapping import StraightPath, WrappedPath

_PER_WRAP = len(WRAP_PARAMETERS)
_Tree = TypeVar("_Tree")


class _Alike(eqx.Module):
    """Muscles with as many cylinders and as many pieces of path, so that one program serves all."""

    muscles: Int[np.ndarray, " muscle"]
    #: Leaves lead with ``muscle pose``.
    posed: PosedPath


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

    def at(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Give all paths round their cylinders where these changes put them."""
        state = self.nominal
        for group in self.alike:
            own = changes[group.muscles, : _changes_of(group)]
            moved = jax.vmap(self._path)(group.posed, own)
            state = jax.tree.map(
                lambda whole, part, rows=group.muscles: whole.at[rows].set(part), state, moved
            )
        return state

    def slopes(self, changes: Float[Array, "muscle mode"]) -> PathState:
        """Differentiate each path by its own changes, in forward mode."""
        count = changes.shape[1]
        slopes = jax.tree.map(lambda leaf: jnp.zeros((leaf.shape[0], count, *leaf.shape[1:])), self.nominal)
        for group in self.alike:
            size = _changes_of(group)
            by_change = jax.vmap(self._slope)(group.posed, changes[group.muscles, :size])
            slopes = jax.tree.map(
                lambda whole, part, rows=group.muscles, size=size: whole.at[rows, :size].set(part),
                slopes,
                by_change,
            )
        return slopes

    def _path(self, posed: PosedPath, changes: Float[Array, " mode"]) -> PathState:
        parameters = changes.reshape(-1, _PER_WRAP) + jnp.asarray(NOMINAL)[None]
        radius = jnp.min(posed.surfaces.radius)
        return _over_cycles(posed.wrapped(parameters, self.wrapping), radius, self.velocities, self.columns)

    def _slope(self, posed: PosedPath, changes: Float[Array, " mode"]) -> PathState:
        def along(direction: Float[Array, " mode"]) -> PathState:
            return jax.jvp(lambda at: self._path(posed, at), (changes,), (direction,))[1]

        return jax.vmap(along)(jnp.eye(changes.size))


def _changes_of(group: _Alike) -> int:
    return _PER_WRAP * group.posed.surfaces.radius.shape[1]


def _over_cycles(
    path: WrappedPath,
    radius: Float[Array, ""],
    velocities: Float[Array, "trial coordinate frame"],
    columns: Int[np.ndarray, " moment_coordinate"],
) -> PathState:
    """Arrange a path's poses by cycle and frame, and add its rate."""
    trials, coordinates, frames = velocities.shape
    arms = jnp.moveaxis(path.moment_arm.reshape(trials, frames, coordinates), -1, 1)
    nothing = jnp.zeros((trials, 1, frames))
    margins = path.margins
    clearance = jnp.minimum(jnp.minimum(margins.inside, margins.off_end), radius * margins.long_wrap)
    return PathState(
        length=path.length.reshape(trials, frames),
        velocity=-jnp.sum(arms * velocities, axis=1),
        moment_arm=jnp.concatenate([arms, nothing], axis=1)[:, columns],
        clearance=clearance.reshape(trials, frames),
    )


def wrapped_paths(
    engine: ExactPaths,
    angles: Float[np.ndarray, "trial coordinate frame"],
    velocities: Float[np.ndarray, "trial coordinate frame"],
    moment_coordinates: Sequence[str],
    free: Sequence[str],
    wrapping: Wrapping = GEODESIC,
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

    Returns
    -------
    paths, touching
        The paths, and which of its cylinders each muscle lies on in at least one frame (False where it
        has fewer).
    """
    poses = np.moveaxis(angles, 1, -1).reshape(-1, angles.shape[1])
    posed = engine.posed(poses)
    columns = np.array(
        [
            engine.coordinates.index(name) if name in engine.coordinates else len(engine.coordinates)
            for name in moment_coordinates
        ]
    )
    most = max((len(engine.wraps_of(name)) for name in engine.muscles), default=0)
    touching = np.zeros((len(engine.muscles), most), dtype=bool)
    states: list[PathState | None] = [None] * len(engine.muscles)
    movable = []
    for kind in _kinds(posed):
        posed_alike = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(posed[name] for name in kind))
        wrapped = _wrapped(posed_alike, wrapping)
        rows = [engine.muscles.index(name) for name in kind]
        for place, row in enumerate(rows):
            one, radii = _rows_of((wrapped, posed_alike.surfaces.radius), place)
            touching[row, : radii.size] = np.asarray(one.touching).any(axis=0)
            states[row] = _over_cycles(one, jnp.min(radii, initial=1.0), jnp.asarray(velocities), columns)
        moved = np.array([bool(set(engine.wraps_of(name)) & set(free)) for name in kind])
        if moved.any():
            own = np.flatnonzero(moved)
            movable.append(_Alike(np.array(rows)[own], _rows_of(posed_alike, own)))
    paths = WrappedPaths(
        nominal=jax.tree.map(lambda *leaves: jnp.stack(leaves), *states),
        alike=tuple(movable),
        velocities=jnp.asarray(velocities),
        columns=columns,
        wraps=most,
        wrapping=wrapping,
    )
    return paths, touching


def _rows_of(tree: _Tree, rows: int | Int[np.ndarray, " row"]) -> _Tree:
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
