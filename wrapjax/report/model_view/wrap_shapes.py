"""Wrapping surfaces as small triangle meshes for drawing: the one place that knows the kinds of surfaces.

Another kind of surface is a function in `SHAPES` that returns its mesh in the surface's own frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from wrapjax.geometry.engine import surfaces_of
from wrapjax.geometry.model_description import WrapObject
from wrapjax.geometry.wrapping import Surface

_FACETS = 48

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
    """Make the mesh of a wrap with given wrap parameters (`WRAP_PARAMETERS`); None for unknown kinds."""
    shape = SHAPES.get(wrap.kind)
    if shape is None:
        return None
    vertices, triangles, lines = shape(wrap, parameters)
    return WrapShape(wrap.name, wrap.kind, wrap.body, vertices, triangles, lines)


def _cylinder(wrap: WrapObject, parameters: Float[np.ndarray, " wrap_parameter"]) -> Mesh:
    (surface,) = _leaves(surfaces_of([wrap]))
    placed = surface.placed(jnp.asarray(parameters))
    axes = np.array([[axis.x, axis.y, axis.z] for axis in (placed.x_axis, placed.y_axis, placed.z_axis)])
    center = np.array([placed.center.x, placed.center.y, placed.center.z])
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
    local = np.concatenate(rings)
    return center + local @ axes, np.concatenate(sides), np.concatenate([*edges, along])


def _leaves(surfaces: Surface) -> list[Surface]:
    """Separate surfaces that are stacked along the first axis of all leaves."""
    import jax

    count = surfaces.radius.shape[0]
    return [jax.tree.map(lambda leaf: leaf[row], surfaces) for row in range(count)]  # noqa: B023


SHAPES: dict[str, Callable[[WrapObject, Float[np.ndarray, " wrap_parameter"]], Mesh]] = {
    "WrapCylinder": _cylinder,
}
