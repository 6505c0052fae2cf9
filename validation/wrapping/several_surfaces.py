"""Shortest paths round two and three surfaces against polylines that SciPy minimises.

``python -m validation.wrapping.several_surfaces`` draws paths round two and round three spheres, ellipsoids
and cylinders that lie one after the other, until 100 of each number touch all of them (``--count N``,
``--seed N``). The oracle's path has straight segments between surfaces, which may leave a surface but not
enter it, and a polyline of 12 or 24 chords with its nodes on each surface. SLSQP minimises its length over
all nodes: from the engine's path, and from paths on random sides of each surface. Extrapolated to infinitely
many chords, the first tells whether the engine's path is a shortest one among its neighbors, and the second
whether another way round is shorter.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.wrapping.differences import HEAD, Differences
from validation.wrapping.draws import draw_surface
from validation.wrapping.single_path import COORDINATES, MUSCLE, SurfaceDraw, write_model
from wrapjax.jax_setup import set_up_jax

#: Largest difference of length that counts as agreement, m.
LIMIT = 1e-6
# Chords on each surface, and random sides from which paths are minimised.
_CHORDS = (12, 24)
_SIDES = 3
# Step of central differences, m.
_STEP = 1e-6
_Ends = Float[np.ndarray, "2 3"]


@dataclass(frozen=True)
class PlacedDraw:
    """Surfaces in the order of the path, and the positions of its ends, m."""

    surfaces: tuple[SurfaceDraw, ...]
    start: Float[np.ndarray, " 3"]
    end: Float[np.ndarray, " 3"]


def draw(kinds: Sequence[str], generator: np.random.Generator) -> PlacedDraw:
    """Draw surfaces along the x axis that do not intersect, and a path past them."""
    surfaces, reached = [], 0.0
    for kind in kinds:
        surface = draw_surface(kind, generator, "all")
        # Long cylinders that cross the way, so that no path runs off their ends.
        size = surface.sizes[0] if surface.kind == "cylinder" else max(surface.sizes)
        angles = surface.angles
        if surface.kind == "cylinder":
            surface = SurfaceDraw("cylinder", (surface.sizes[0], 0.6))
            angles = (generator.uniform(-np.pi, np.pi), generator.uniform(-0.3, 0.3), 0.0)
        reached += size + generator.uniform(0.01, 0.04)
        aside = 0.4 * size * generator.uniform(-1.0, 1.0, 2)
        surfaces.append(
            SurfaceDraw(surface.kind, surface.sizes, center=(reached, *aside.tolist()), angles=angles)
        )
        reached += size
    end = np.array([reached + generator.uniform(0.01, 0.04), 0.0, 0.0])
    return PlacedDraw(tuple(surfaces), np.zeros(3), end)


# ---- Oracle


def _rotation(surface: SurfaceDraw) -> Float[np.ndarray, "3 3"]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("XYZ", surface.angles).as_matrix()


def _sizes(surface: SurfaceDraw) -> Float[np.ndarray, " 3"]:
    """Semi-axes; those of a cylinder have no meaning along its axis, z."""
    sizes = surface.sizes
    return np.array(sizes if surface.kind == "ellipsoid" else (sizes[0],) * 3)


def _compiled(round_axis: tuple[bool, ...], chords: int) -> tuple[Callable[..., Any], ...]:
    """Compile length and constraints of a path round surfaces, with derivatives.

    A node's variables are a vector from the surface's center, whose direction places it; on a cylinder, the
    direction within the plane across its axis, and the height.

    Parameters
    ----------
    round_axis
        Whether each surface is a cylinder.
    chords
        Number of chords on each surface.
    """
    import jax
    import jax.numpy as jnp

    number = len(round_axis)

    def placed(variables, centers, rotations, sizes):
        """Nodes and outward normals on each surface."""
        nodes, normals = [], []
        parts = variables.reshape(number, chords + 1, 3)
        for part, center, rotation, size, round_one in zip(
            parts, centers, rotations, sizes, round_axis, strict=True
        ):
            across = part.at[:, 2].set(0.0) if round_one else part
            unit = across / jnp.linalg.norm(across, axis=1)[:, None]
            local = unit * size
            normal = unit / size
            if round_one:
                local = local.at[:, 2].set(part[:, 2] * size[2])
            nodes.append(center + local @ rotation.T)
            normals.append((normal / jnp.linalg.norm(normal, axis=1)[:, None]) @ rotation.T)
        return nodes, normals

    def length(variables, start, end, centers, rotations, sizes):
        nodes, _ = placed(variables, centers, rotations, sizes)
        total, at = 0.0, start
        for one in nodes:
            total += jnp.linalg.norm(one[0] - at)
            total += jnp.sqrt(chords * jnp.sum(jnp.diff(one, axis=0) ** 2))
            at = one[-1]
        return total + jnp.linalg.norm(end - at)

    def outside(variables, start, end, centers, rotations, sizes):
        """Components of unit segments along outward normals at their ends, zero or more outside."""
        nodes, normals = placed(variables, centers, rotations, sizes)
        before = [start, *(one[-1] for one in nodes)]
        after = [*(one[0] for one in nodes), end]
        found = []
        for surface in range(number):
            for point, normal, other in (
                (nodes[surface][0], normals[surface][0], before[surface]),
                (nodes[surface][-1], normals[surface][-1], after[surface + 1]),
            ):
                segment = other - point
                found.append(jnp.dot(normal, segment) / jnp.linalg.norm(segment))
        return jnp.stack(found)

    return jax.jit(jax.value_and_grad(length)), jax.jit(outside), jax.jit(jax.jacfwd(outside))


class Oracle:
    """Shortest polylines round surfaces of given kinds."""

    def __init__(self, kinds: Sequence[str]):
        self._functions = {
            chords: _compiled(tuple(k == "cylinder" for k in kinds), chords) for chords in _CHORDS
        }

    def length(self, drawn: PlacedDraw, ends: Sequence[_Ends]) -> float:
        """Compute the length (m) of the path that SLSQP finds from contacts with given ends; NaN if none.

        Parameters
        ----------
        drawn
            Surfaces and ends of the path.
        ends
            First and last point of contact with each surface, m.
        """
        by_chords = [self._minimum(drawn, ends, chords) for chords in _CHORDS]
        return by_chords[1] + (by_chords[1] - by_chords[0]) / 3.0

    def _minimum(self, drawn: PlacedDraw, ends: Sequence[_Ends], chords: int) -> float:
        from scipy.optimize import minimize

        length, outside, slopes = self._functions[chords]
        rotations = np.stack([_rotation(one) for one in drawn.surfaces])
        centers = np.stack([np.array(one.center) for one in drawn.surfaces])
        sizes = np.stack([_sizes(one) for one in drawn.surfaces])
        given = (drawn.start, drawn.end, centers, rotations, sizes)
        share = np.linspace(0.0, 1.0, chords + 1)[:, None]
        begun = []
        for (first, last), center, rotation, size in zip(ends, centers, rotations, sizes, strict=True):
            local = ((first - center) @ rotation / size, (last - center) @ rotation / size)
            begun.append(local[0] + share * (local[1] - local[0]))
        found = minimize(
            lambda one: tuple(map(np.asarray, length(one, *given))),
            np.concatenate(begun).ravel(),
            jac=True,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda one: np.asarray(outside(one, *given)),
                "jac": lambda one: np.asarray(slopes(one, *given)),
            },
            options={"maxiter": 500, "ftol": 1e-15},
        )
        feasible = np.asarray(outside(found.x, *given)).min() > -1e-7
        return float(found.fun) if feasible and np.isfinite(found.fun) else np.nan


def sides(drawn: PlacedDraw, generator: np.random.Generator) -> list[_Ends]:
    """Draw contacts on a random side of each surface, the same for all."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    aside = np.array([0.0, np.cos(angle), np.sin(angle)])
    along = np.array([0.3, 0.0, 0.0])
    ends = []
    for surface in drawn.surfaces:
        rotation, size = _rotation(surface), _sizes(surface)
        points = []
        for toward in (aside - along, aside + along):
            local = toward @ rotation
            if surface.kind == "cylinder":
                local = np.array([*local[:2], 0.0])
            points.append(np.array(surface.center) + rotation @ (local / np.linalg.norm(local / size)))
        ends.append(np.stack(points))
    return ends


# ---- Engine


@dataclass(frozen=True)
class EnginePath:
    """A path by the engine.

    Parameters
    ----------
    length
        Length, m.
    slope_error
        Largest difference of its derivatives by the ends' positions from central differences.
    contacts
        First and last point of the contact with each surface that it touches, by the surface's number, m.
    """

    length: float
    slope_error: float
    contacts: dict[int, Float[np.ndarray, "2 3"]]


def engine_path(drawn: PlacedDraw) -> EnginePath:
    """Compute the shortest path by the engine."""
    from wrapjax.geometry.exact_paths.routed_path import route_path
    from wrapjax.path_sources.muscle_paths import muscle_paths

    pose = np.concatenate([drawn.start, drawn.end])
    steps = _STEP * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        write_model(drawn.surfaces, file)
        paths = muscle_paths(file, coordinates=COORDINATES)
        routed = route_path(paths.engine.model, MUSCLE, COORDINATES, pose)
    found = paths(pose + steps)
    length, arms = np.asarray(found.length)[:, 0], np.asarray(found.moment_arm)[0, :, 0]
    differences = (length[1:7] - length[7:]) / (2.0 * _STEP)
    contacts = {int(name.rsplit("_", 1)[1]): ends for name, ends in routed.contacts.items()}
    return EnginePath(float(length[0]), float(np.abs(arms + differences).max()), contacts)


def compare(kinds: Sequence[tuple[str, ...]], count: int, seed: int) -> tuple[Differences, int, list[float]]:
    """Compare paths that touch all surfaces with the oracle's.

    Parameters
    ----------
    kinds
        Kinds of the surfaces in the order of the path, each for the same share of the paths.
    count, seed
        Number of paths, and seed of their draws.

    Returns
    -------
    differences, unconfirmed, shorter
        Differences from the path among its neighbors; number of paths from which SLSQP found none; and by how
        much another way is shorter than the engine's, m, of each path for which it is by more than the limit.
    """
    generator = np.random.default_rng(seed)
    lengths, slopes, shorter, unconfirmed = [], [], [], 0
    for one in kinds:
        oracle, touched = Oracle(one), 0
        while touched < count // len(kinds):
            drawn = draw(one, generator)
            path = engine_path(drawn)
            if len(path.contacts) < len(one):
                continue
            touched += 1
            near = oracle.length(drawn, [path.contacts[number] for number in range(len(one))])
            others = [oracle.length(drawn, sides(drawn, generator)) for _ in range(_SIDES)]
            unconfirmed += int(np.isnan(near))
            lengths.append(abs(path.length - near))
            slopes.append(path.slope_error)
            least = np.nanmin([*others, path.length])
            if path.length - least > LIMIT:
                shorter.append(float(path.length - least))
    name = f"{len(kinds[0])} surfaces, shortest path"
    return Differences(name, np.array(lengths), np.array(slopes), LIMIT), unconfirmed, shorter


#: Kinds of surfaces along a path.
COMBINATIONS = {
    2: (
        ("sphere", "ellipsoid"),
        ("ellipsoid", "ellipsoid"),
        ("cylinder", "ellipsoid"),
        ("cylinder", "sphere"),
    ),
    3: (("sphere", "ellipsoid", "cylinder"), ("ellipsoid", "ellipsoid", "ellipsoid")),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="compare shortest paths round several surfaces with SciPy")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print(HEAD)
    for number, kinds in COMBINATIONS.items():
        found, unconfirmed, shorter = compare(kinds, options.count, options.seed)
        print(found.row(), flush=True)
        print(f"{number} surfaces: SLSQP found no path from {unconfirmed} of the engine's", flush=True)
        worst = f", by up to {1e3 * max(shorter):.2f} mm" if shorter else ""
        print(f"{number} surfaces: another way is shorter for {len(shorter)}{worst}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
