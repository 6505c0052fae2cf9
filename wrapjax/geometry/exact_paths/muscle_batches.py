"""Posed paths of many muscles, stacked so that all paths of a kind share one compiled program.

Paths round one surface are stacked by the surface's kind. Paths round several surfaces are padded to the same
numbers of points and surfaces, whatever the kinds. A padding surface can be touched by no segment, and a
padding point coincides with the path's last point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from wrapjax.geometry.exact_paths.engine import PosedPath
from wrapjax.geometry.exact_paths.path_on_cylinders import PointsAndBodies
from wrapjax.geometry.exact_paths.wrapping import Surface


class MuscleBatch(eqx.Module):
    """Stacked paths of some muscles."""

    #: Numbers of the muscles.
    muscles: Int[np.ndarray, " muscle"]
    #: Numbers of the wraps of each muscle in the order of its path; 0 for padding.
    wraps: Int[np.ndarray, "muscle wrap"]
    #: The first axis of all leaves is ``muscle``.
    posed: PosedPath


def muscle_batches(
    posed: Mapping[str, PosedPath], wraps_of: Mapping[str, Sequence[str]], wraps: Sequence[str]
) -> tuple[MuscleBatch, ...]:
    """Stack the paths of muscles.

    Parameters
    ----------
    posed
        Path of each muscle in the same poses, from `ExactPaths.posed`.
    wraps_of
        Names of the wraps of each muscle, in the order of its path.
    wraps
        Names of all wraps, by which they are numbered.
    """
    names = list(posed)
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, one in posed.items():
        several = isinstance(one.path, PointsAndBodies)
        groups.setdefault(("several",) if several else ("single", *one.kinds), []).append(name)
    batches = []
    for key, members in groups.items():
        paths = [posed[name] for name in members]
        if key[0] == "several":
            paths = padded_alike(paths)
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *paths)
        count = stacked.surfaces.radius.shape[1]
        numbers = np.zeros((len(members), count), dtype=int)
        for row, name in enumerate(members):
            own = [wraps.index(wrap) for wrap in wraps_of[name]]
            numbers[row, : len(own)] = own
        batches.append(MuscleBatch(np.array([names.index(name) for name in members]), numbers, stacked))
    return tuple(batches)


def padded_alike(paths: Sequence[PosedPath], least_points: int = 0) -> list[PosedPath]:
    """Pad paths round several surfaces to the same numbers of points and surfaces.

    Parameters
    ----------
    paths
        Paths with `PointsAndBodies`; the returned ones have the same kinds of surfaces, in any order.
    least_points
        Number of points to pad to at least.
    """
    kinds = tuple(dict.fromkeys(kind for path in paths for kind in path.kinds))
    most_points = max(least_points, *(_points_and_bodies(path).position.shape[1] for path in paths))
    most_wraps = max(len(path.kinds) for path in paths)
    sized = any(path.surfaces.sizes is not None for path in paths)
    return [
        PosedPath(
            path=_padded_path(_points_and_bodies(path), most_points, most_wraps),
            surfaces=_padded_surfaces(path.surfaces, most_wraps, sized),
            kinds=kinds,
            numbers=jnp.asarray(
                [kinds.index(kind) for kind in path.kinds] + [0] * (most_wraps - len(path.kinds))
            ),
        )
        for path in paths
    ]


def _points_and_bodies(path: PosedPath) -> PointsAndBodies:
    assert isinstance(path.path, PointsAndBodies)
    return path.path


def _repeated(leaf: Array | np.ndarray, axis: int, size: int) -> Array:
    """Repeat the last entry along an axis up to a size."""
    values = np.asarray(leaf)
    last = np.take(values, [-1], axis=axis)
    return jnp.asarray(
        np.concatenate([values, np.repeat(last, size - values.shape[axis], axis=axis)], axis=axis)
    )


def _padded_path(path: PointsAndBodies, points: int, wraps: int) -> PointsAndBodies:
    known = path.first_point.shape[1]
    moving = np.zeros(path.point_body.shape, bool) if path.moving is None else path.moving
    first = _repeated(path.first_point, 1, wraps)
    # From a point to itself there is no segment that could wrap.
    last = np.array(first)
    last[:, :known] = path.last_point
    return PointsAndBodies(
        position=_repeated(path.position, 1, points),
        velocity=_repeated(path.velocity, 2, points),
        point_body=_repeated(path.point_body, 1, points),
        rotation=_repeated(path.rotation, 1, wraps),
        origin=_repeated(path.origin, 1, wraps),
        angular=_repeated(path.angular, 2, wraps),
        linear=_repeated(path.linear, 2, wraps),
        wrap_body=_repeated(path.wrap_body, 1, wraps),
        first_point=first,
        last_point=jnp.asarray(last),
        moving=_repeated(moving, 1, points),
    )


def _padded_surfaces(surfaces: Surface, wraps: int, sized: bool) -> Surface:
    if sized and surfaces.sizes is None:
        radius = np.asarray(surfaces.radius)
        surfaces = replace(surfaces, sizes=jnp.asarray(np.tile(radius[:, None], (1, 3))))
    return jax.tree.map(lambda leaf: _repeated(leaf, 0, wraps), surfaces)
