"""Wrapping surfaces as small triangle meshes for drawing: the one place that knows the kinds of surfaces.

Another kind of surface is a function in `SHAPES` that returns its mesh in the surface's own frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from wrapjax.geometry.exact_paths.engine import surfaces_of
from wrapjax.geometry.exact_paths.wrapping import Surface
from wrapjax.geometry.skeleton.model_description import WrapObject
from wrapjax.geometry.surfaces.placed_surface import PlacedSurface

# Vertices round the axis of a surface, and circles of an ellipsoid or round a torus' tube.
_FACETS, _RINGS = 48, 16

Vertices = Float[np.ndarray, "vertex 3"]
Triangles = Int[np.ndarray, "triangle 3"]
#: Mesh, and lines (pairs of vertices) that show its shape.
Mesh = tuple[Vertices, Triangles, Int[np.ndarray, "line 2"]]


@dataclass(frozen=True)
class WrapShape:
    """A wrapping surface for drawing, in the frame of the body that carries it.

    Parameters
    ----------
    name, kind, body
        Name of the wrap, its OpenSim class and the body that carries it.
    vertices
        Vertices in the body's frame, m.
    triangles, lines
        Vertices of each triangle, and of each line that is drawn on it.
    """

    name: str
    kind: str
    body: str
    vertices: Vertices
    triangles: Triangles
    lines: Int[np.ndarray, "line 2"]


def wrap_shape(wrap: WrapObject, parameters: Float[np.ndarray, " wrap_parameter"]) -> WrapShape | None:
    """Make the mesh of a wrap with given wrap parameters (`PARAMETERS`); None for unknown kinds."""
    shape = SHAPES.get(wrap.kind)
    if shape is None:
        return None
    vertices, triangles, lines = _placed(shape, wrap, jnp.asarray(parameters))
    return WrapShape(wrap.name, wrap.kind, wrap.body, vertices, triangles, lines)


def _placed(mesh: Callable[[PlacedSurface], Mesh], wrap: WrapObject, parameters: Array) -> Mesh:
    """Make the mesh of a placed surface, and move it to the frame of its body."""
    (surface,) = _leaves(surfaces_of([wrap]))
    placed = surface.placed(parameters)
    local, triangles, lines = mesh(placed)
    axes = np.array([[axis.x, axis.y, axis.z] for axis in (placed.x_axis, placed.y_axis, placed.z_axis)])
    center = np.array([placed.center.x, placed.center.y, placed.center.z])
    return center + local @ axes, triangles, lines


def _cylinder(placed: PlacedSurface) -> Mesh:
    angle = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)
    circle = float(placed.radius) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [
        np.column_stack([circle, np.full(_FACETS, end * float(placed.half_length))]) for end in (-1.0, 1.0)
    ]
    here = np.arange(_FACETS)
    after = (here + 1) % _FACETS
    sides = [
        np.stack([here, after, _FACETS + here], axis=1),
        np.stack([after, _FACETS + after, _FACETS + here], axis=1),
    ]
    edges = [np.stack([here + shift, after + shift], axis=1) for shift in (0, _FACETS)]
    along = np.stack([here, _FACETS + here], axis=1)[:: _FACETS // 12]
    return np.concatenate(rings), np.concatenate(sides), np.concatenate([*edges, along])


def _curved(placed: PlacedSurface, kind: str) -> Mesh:
    sizes = placed.sizes
    assert sizes is not None, "only cylinders have none"
    return local_mesh(kind, (float(sizes.x), float(sizes.y), float(sizes.z)))


def local_mesh(kind: str, sizes: Sequence[float]) -> Mesh:
    """Make the mesh of a sphere, an ellipsoid or a torus in its own frame.

    Parameters
    ----------
    kind
        ``sphere``, ``ellipsoid`` or ``torus``.
    sizes
        Semi-axes (a sphere has three equal ones); radii of a torus' ring and tube, m.
    """
    return _torus(*sizes[:2]) if kind == "torus" else _ellipsoid(np.asarray(sizes))


def _ellipsoid(sizes: Float[np.ndarray, " 3"]) -> Mesh:
    """Circles of latitude on the unit sphere, scaled."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _RINGS + 1)[None]
    longitude = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)[:, None]
    grid = np.stack(
        np.broadcast_arrays(
            np.cos(longitude) * np.cos(latitude), np.sin(longitude) * np.cos(latitude), np.sin(latitude)
        ),
        axis=-1,
    )
    return _grid(grid * sizes, closed=False)


def _torus(ring: float, tube: float) -> Mesh:
    around = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)[:, None]
    across = np.linspace(0.0, 2.0 * np.pi, _RINGS, endpoint=False)[None]
    distance = ring + tube * np.cos(across)
    grid = np.stack(
        np.broadcast_arrays(
            np.cos(around) * distance, np.sin(around) * distance, np.ones_like(around) * tube * np.sin(across)
        ),
        axis=-1,
    )
    return _grid(grid, closed=True)


def _grid(points: Float[np.ndarray, "one other 3"], closed: bool) -> Mesh:
    """Connect the points of a grid: closed along its first axis, and along its second if ``closed``."""
    first, second = points.shape[:2]
    number = np.arange(first * second).reshape(first, second)
    beside = np.roll(number, -1, axis=0)
    here = number if closed else number[:, :-1]
    above = np.roll(number, -1, axis=1) if closed else number[:, 1:]
    across = np.roll(beside, -1, axis=1) if closed else beside[:, 1:]
    side = beside if closed else beside[:, :-1]
    triangles = [np.stack(corners, axis=-1) for corners in ((here, side, above), (side, across, above))]
    lines = [
        np.stack([number, beside], axis=-1)[:, :: second // 4],
        np.stack([here, above], axis=-1)[:: first // 12],
    ]
    return (
        points.reshape(-1, 3),
        np.concatenate([one.reshape(-1, 3) for one in triangles]),
        np.concatenate([one.reshape(-1, 2) for one in lines]),
    )


def _leaves(surfaces: Surface) -> list[Surface]:
    """Separate surfaces that are stacked along the first axis of all leaves."""
    import jax

    count = surfaces.radius.shape[0]
    return [jax.tree.map(lambda leaf: leaf[row], surfaces) for row in range(count)]  # noqa: B023


#: Mesh of a placed surface in its own frame, by OpenSim's class.
SHAPES: dict[str, Callable[[PlacedSurface], Mesh]] = {
    "WrapCylinder": _cylinder,
    "WrapSphere": partial(_curved, kind="sphere"),
    "WrapEllipsoid": partial(_curved, kind="ellipsoid"),
    "WrapTorus": partial(_curved, kind="torus"),
}
