"""Random surfaces and poses of a single path round them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from validation.wrapping.single_path import SurfaceDraw

#: Kinds of surfaces that are drawn. ``ellipsoid`` is OpenSim's default method, hybrid.
KINDS = ("cylinder", "sphere", "ellipsoid", "ellipsoid_midpoint", "ellipsoid_axial", "torus")
_QUADRANTS = ("all", "all", "x", "-x", "y", "-y", "z", "-z")


def draw_surface(kind: str, generator: np.random.Generator, quadrant: str | None = None) -> SurfaceDraw:
    """Draw a surface at the origin.

    Parameters
    ----------
    kind
        One of `KINDS`.
    generator
        Random number generator.
    quadrant
        OpenSim's quadrant; by default a quarter of the surfaces is unrestricted.
    """
    side = str(generator.choice(_QUADRANTS)) if quadrant is None else quadrant
    shape, _, method = kind.partition("_")
    angles = tuple(generator.uniform(-np.pi, np.pi, 3))
    sizes: tuple[float, ...]
    if shape == "cylinder":
        sizes = (generator.uniform(0.01, 0.05), generator.uniform(0.05, 0.3))
    elif shape == "sphere":
        sizes = (generator.uniform(0.01, 0.05),)
    elif shape == "ellipsoid":
        sizes = tuple(generator.uniform(0.02, 0.06, 3))
    else:
        ring = generator.uniform(0.015, 0.05)
        sizes = (ring, ring * generator.uniform(0.1, 0.5))
        side = side if side[-1] != "z" else "all"
    return SurfaceDraw(shape, sizes, side, method or "hybrid", angles=angles)


def draw_poses(
    surface: SurfaceDraw, count: int, generator: np.random.Generator
) -> Float[np.ndarray, "pose coordinate"]:
    """Draw positions of the path's start and end, most of them on opposite sides of the surface (m)."""
    if surface.kind == "torus":
        ring = surface.sizes[0]
        across = generator.uniform(-1.5 * ring, 1.5 * ring, (2, count, 2))
        above = generator.uniform(0.3 * ring, 3.0 * ring, (2, count, 1))
        along = above * np.array([1.0, -1.0])[:, None, None]
        ends = np.concatenate([across, along], axis=2)
    else:
        extents = np.array(surface.sizes if surface.kind == "ellipsoid" else (surface.sizes[0],) * 3)
        start = _directions(count, generator)
        end = -start + 0.7 * generator.normal(size=(count, 3))
        end /= np.linalg.norm(end, axis=1)[:, None]
        reach = generator.uniform(1.02, 4.0, (2, count, 1))
        ends = np.stack([start, end]) * reach * extents
    rotated = ends @ _rotation(surface.angles).T
    return np.concatenate([rotated[0], rotated[1]], axis=1)


def draw_sweep(
    ends: Float[np.ndarray, " coordinate"], count: int, reach: float, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "pose coordinate"], Float[np.ndarray, "pose 3"]]:
    """Draw poses that move the path's end once round a circle.

    Parameters
    ----------
    ends
        First pose: positions of the path's start and end, m.
    count
        Number of poses.
    reach
        Radius of the circle, as a share of the end's distance from the origin.
    generator
        Random number generator.

    Returns
    -------
    poses, direction
        Poses, and the direction in which the end moves in each.
    """
    around, across = np.linalg.qr(generator.normal(size=(3, 2)))[0].T
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[:, None]
    radius = reach * np.linalg.norm(ends[3:])
    poses = np.repeat(ends[None], count, axis=0)
    poses[:, 3:] += radius * ((np.cos(angle) - 1.0) * around + np.sin(angle) * across)
    return poses, np.cos(angle) * across - np.sin(angle) * around


def draws(
    kind: str, surfaces: int, poses: int, seed: int, quadrant: str | None = None
) -> Iterator[tuple[SurfaceDraw, Float[np.ndarray, "pose coordinate"]]]:
    """Draw surfaces with poses of a path."""
    generator = np.random.default_rng(seed)
    for _ in range(surfaces):
        surface = draw_surface(kind, generator, quadrant)
        yield surface, draw_poses(surface, poses, generator)


def _directions(count: int, generator: np.random.Generator) -> Float[np.ndarray, "direction 3"]:
    directions = generator.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def _rotation(angles: tuple[float, float, float]) -> Float[np.ndarray, "3 3"]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("XYZ", angles).as_matrix()
