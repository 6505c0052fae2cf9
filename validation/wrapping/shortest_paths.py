"""Shortest paths of the exact engine against polylines that SciPy minimises.

``python -m validation.wrapping.shortest_paths`` draws 200 paths round spheres, ellipsoids and tori each
(``--count N``, ``--kinds KIND ...``). The oracle's path is a straight line to a tangent point, a polyline of
80 chords with its nodes on the surface, and a straight line from another tangent point. L-BFGS-B minimises
its length over both tangent points and all nodes, first with 20 chords from paths on several sides, then with
40 and 80 from the shortest two; the result is extrapolated to infinitely many chords, of which the length's
error is proportional to the inverse square. Polylines through a torus whose straight lines cut the tube are
left out.
Printed are the differences in length, and differences of moment arms from central differences of the
engine's own length.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.wrapping.differences import HEAD, Differences
from validation.wrapping.draws import draws
from validation.wrapping.single_path import SurfaceDraw
from wrapjax.jax_setup import set_up_jax

#: Largest difference of length that counts as agreement, m.
LIMIT = 1e-6
_KINDS = ("sphere", "ellipsoid", "torus")
CHORDS = (20, 40, 80)
# Angles about the segment at which searches begin.
_STARTS = np.arange(4) * 0.5 * np.pi
# Step of central differences, m.
_STEP = 1e-6
_Points = Float[np.ndarray, "point 3"]


class Polyline(NamedTuple):
    """A path over a surface as a function of its variables, the ends and the sizes."""

    #: Length (m) and its gradient.
    length: Callable[..., Any]
    #: Points on the surface, m.
    points: Callable[..., Any]


def _on_ellipsoid(chords: int) -> Polyline:
    """Polyline over an ellipsoid, from angles on both ends' horizons and points of a sphere."""
    import jax.numpy as jnp

    def tangent(angle, point):
        """Point of the unit sphere whose tangent plane contains a point."""
        square = jnp.sum(point**2)
        toward = point / jnp.sqrt(square)
        one = jnp.cross(toward, jnp.eye(3)[jnp.argmin(jnp.abs(toward))])
        one = one / jnp.linalg.norm(one)
        other = jnp.cross(toward, one)
        around = jnp.cos(angle) * one + jnp.sin(angle) * other
        return point / square + jnp.sqrt(1.0 - 1.0 / square) * around

    def points(variables, start, end, sizes):
        nodes = variables[2:].reshape(chords - 1, 3)
        nodes = nodes / jnp.linalg.norm(nodes, axis=1)[:, None]
        first, last = tangent(variables[0], start / sizes), tangent(variables[1], end / sizes)
        return jnp.concatenate([first[None], nodes, last[None]]) * sizes

    return _polyline(points, chords)


def _polyline(points: Callable[..., Any], chords: int) -> Polyline:
    import jax
    import jax.numpy as jnp

    def length(variables, start, end, sizes):
        found = points(variables, start, end, sizes)
        curve = jnp.sqrt(chords * jnp.sum(jnp.diff(found, axis=0) ** 2))
        return jnp.linalg.norm(found[0] - start) + curve + jnp.linalg.norm(found[-1] - end)

    return Polyline(jax.jit(jax.value_and_grad(length)), jax.jit(points))


def through_torus(chords: int) -> Polyline:
    """Polyline over a torus, from angles about the tube (zero at its inner edge) and the ring."""
    import jax.numpy as jnp

    def points(variables, start, end, sizes):
        ring, tube = sizes[0], sizes[1]

        def tangent(angle, point, sign):
            outward = point[0] * jnp.cos(angle) + point[1] * jnp.sin(angle) - ring
            apart = jnp.arccos(jnp.clip(tube / jnp.hypot(outward, point[2]), -1.0, 1.0))
            return jnp.stack([jnp.arctan2(-point[2], -outward) + sign * apart, angle])

        sign = jnp.sign(start[2])
        ends = tangent(variables[0], start, sign), tangent(variables[1], end, -sign)
        angles = jnp.concatenate([ends[0][None], variables[2:].reshape(-1, 2), ends[1][None]])
        outward = ring - tube * jnp.cos(angles[:, 0])
        columns = [outward * jnp.cos(angles[:, 1]), outward * jnp.sin(angles[:, 1])]
        return jnp.stack([*columns, -tube * jnp.sin(angles[:, 0])], axis=1)

    return _polyline(points, chords)


def lines_are_clear(
    start: np.ndarray, end: np.ndarray, points: _Points, sizes: np.ndarray, depth: float = 1e-6
) -> bool:
    """Whether the straight lines from both ends to a polyline are nowhere deeper in a torus' tube (m)."""
    share = np.linspace(0.0, 1.0, 401)[:, None]
    lines = np.concatenate([start + share * (points[0] - start), end + share * (points[-1] - end)])
    aside = np.hypot(lines[:, 0], lines[:, 1]) - sizes[0]
    return bool(np.hypot(aside, lines[:, 2]).min() > sizes[1] - depth)


def _minimum(polyline: Polyline, initial: np.ndarray, *given: np.ndarray) -> tuple[float, np.ndarray]:
    from scipy.optimize import minimize

    def value_and_slope(variables: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = polyline.length(variables, *given)
        return float(value), np.asarray(slope)

    settings = {"maxiter": 3000, "maxfun": 6000, "ftol": 1e-16, "gtol": 1e-11, "maxcor": 30}
    found = minimize(value_and_slope, initial, jac=True, method="L-BFGS-B", options=settings)
    return float(found.fun), found.x


def _refined(variables: np.ndarray, chords: int) -> np.ndarray:
    """Interpolate the nodes of a polyline to twice as many chords as it has."""
    ends, nodes = variables[:2], variables[2:].reshape(chords - 1, -1)
    outer = [2.0 * nodes[:1] - nodes[1:2], nodes, 2.0 * nodes[-1:] - nodes[-2:-1]]
    share, finer = (np.linspace(0.0, 1.0, count + 1) for count in (chords, 2 * chords))
    columns = [np.interp(finer, share, column)[1:-1] for column in np.concatenate(outer).T]
    return np.concatenate([ends, np.stack(columns, axis=1).ravel()])


def _shortest(
    polylines: Sequence[Polyline],
    initial: Sequence[np.ndarray],
    start: np.ndarray,
    end: np.ndarray,
    sizes: np.ndarray,
    allowed: Callable[[np.ndarray, np.ndarray, _Points, np.ndarray], bool] = lambda *_: True,
) -> float:
    """Length (m) of the shortest path from the given polylines of the fewest chords.

    The two shortest of their minima that are allowed are refined, as an initial polyline may be left far from
    its minimum. Infinite if none is allowed.
    """
    given = (start, end, sizes)
    minima = [_minimum(polylines[0], one, *given) for one in initial]
    minima = [
        one for one in minima if allowed(start, end, np.asarray(polylines[0].points(one[1], *given)), sizes)
    ]
    lengths = [[np.inf, np.inf]]
    for _, variables in sorted(minima, key=lambda one: one[0])[:2]:
        by_chords = []
        for coarser, polyline in zip(CHORDS, polylines[1:], strict=False):
            value, variables = _minimum(polyline, _refined(variables, coarser), *given)
            by_chords.append(value)
        if allowed(start, end, np.asarray(polylines[-1].points(variables, *given)), sizes):
            lengths.append(by_chords)
    fewer, more = np.min(lengths, axis=0)
    return float(more + (more - fewer) / 3.0) if np.isfinite(more) else np.inf


def ellipsoid_oracle(
    start: np.ndarray, end: np.ndarray, sizes: np.ndarray, polylines: Sequence[Polyline]
) -> float:
    """Length of the shortest path (m) between two points outside an ellipsoid whose segment intersects it."""
    scaled = start / sizes, end / sizes
    along = scaled[1] - scaled[0]
    along /= np.linalg.norm(along)
    one = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    one /= np.linalg.norm(one)
    other = np.cross(along, one)
    initial = []
    for begin in _STARTS:
        aside = np.cos(begin) * one + np.sin(begin) * other
        share = np.linspace(0.0, 1.0, CHORDS[0] + 1)[1:-1, None]
        nodes = scaled[0] + share * (scaled[1] - scaled[0]) + 2.0 * np.sin(np.pi * share) * aside
        initial.append(np.concatenate([[_angle_towards(point, aside) for point in scaled], nodes.ravel()]))
    return _shortest(polylines, initial, start, end, sizes)


def _angle_towards(point: np.ndarray, aside: np.ndarray) -> float:
    toward = point / np.linalg.norm(point)
    one = np.cross(toward, np.eye(3)[np.argmin(np.abs(toward))])
    one /= np.linalg.norm(one)
    return float(np.arctan2(aside @ np.cross(toward, one), aside @ one))


def torus_oracle(
    start: np.ndarray, end: np.ndarray, sizes: np.ndarray, polylines: Sequence[Polyline]
) -> float:
    """Length of the shortest path (m) through a torus' hole along the tube."""
    inner = sizes[0] - sizes[1]
    ring = np.linspace(0.0, 2.0 * np.pi, 73)[:-1]
    points = inner * np.stack([np.cos(ring), np.sin(ring), 0.0 * ring], axis=1)
    ways = np.linalg.norm(points - start, axis=1) + np.linalg.norm(points - end, axis=1)
    initial = []
    for angle in ring[np.argsort(ways)[[0, 3, 9]]]:
        # Lines to an end near the surface are tangent only near the end's own angle about the ring.
        own = [angle + np.angle(np.exp(1j * (np.arctan2(one[1], one[0]) - angle))) for one in (start, end)]
        for first, last in product((angle, own[0]), (angle, own[1])):
            share = np.linspace(-1.0, 1.0, CHORDS[0] + 1)[1:-1]
            around = np.interp(share, (-1.0, 0.0, 1.0), (first, angle, last))
            nodes = np.stack([0.3 * np.sign(start[2]) * share, around], axis=1)
            straight = np.concatenate([[first, last], nodes.ravel()])
            outer = np.asarray(polylines[0].points(straight, start, end, sizes))[[0, -1]]
            about_tube = np.arctan2(-outer[:, 2], sizes[0] - np.hypot(outer[:, 0], outer[:, 1]))
            nodes[:, 0] = np.interp(share, (-1.0, 1.0), about_tube)
            initial += [straight, np.concatenate([[first, last], nodes.ravel()])]
    return _shortest(polylines, initial, start, end, sizes, lines_are_clear)


def engine_paths(
    surface: SurfaceDraw, ends: Float[np.ndarray, "pose 6"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, derivatives by the ends' positions and contact lengths of shortest paths round one surface."""
    import jax.numpy as jnp

    from wrapjax.geometry.surfaces.placed_surface import PlacedSurface
    from wrapjax.geometry.surfaces.wrap_methods import kind_of
    from wrapjax.geometry.vectors import vector

    sizes = np.array((*surface.sizes, surface.sizes[-1], surface.sizes[-1])[:3])
    axes = [vector(jnp.eye(3)[axis]) for axis in range(3)]
    radius = jnp.asarray(surface.sizes[1] if surface.kind == "torus" else float(np.mean(sizes)))
    none = jnp.asarray(0)
    placed = PlacedSurface(
        x_axis=axes[0],
        y_axis=axes[1],
        z_axis=axes[2],
        center=vector(jnp.zeros(3)),
        radius=radius,
        half_length=radius,
        side_axis=none,
        side=none,
        sizes=vector(jnp.asarray(sizes)),
    )
    function = _compiled(kind_of(f"Wrap{surface.kind.capitalize()}", surface.method))
    length, slope, on_surface = function(jnp.asarray(ends), placed)
    return np.asarray(length), np.asarray(slope), np.asarray(on_surface)


@cache
def _compiled(kind: str) -> Callable[..., Any]:
    """Compile the paths from many ends round a surface of a kind."""
    import jax
    import jax.numpy as jnp

    from wrapjax.geometry.surfaces.wrap_methods import SHORTEST
    from wrapjax.geometry.vectors import stack_components, vector

    method = SHORTEST[kind]

    def path(ends, placed):
        start, end = vector(ends[:3]), vector(ends[3:])
        decision = method.decide(start, end, placed)
        contact = method.find_contact(start, end, placed, decision)
        wraps = decision.mandatory | decision.possible
        straight = stack_components((end - start).unit())
        pulls = [
            jnp.where(wraps, stack_components(pull), straight)
            for pull in (contact.start_pull, contact.end_pull)
        ]
        length = jnp.where(wraps, contact.total, (end - start).norm())
        return length, jnp.concatenate([-pulls[0], pulls[1]]), jnp.where(wraps, contact.length, 0.0)

    return jax.jit(jax.vmap(path, in_axes=(0, None)))


def compare(kind: str, count: int, seed: int) -> tuple[Differences, float]:
    """Compare the paths that touch among random ones; return also the share of paths that touch."""
    per_surface = 20
    lengths, arms, touched = [], [], 0
    maker = through_torus if kind == "torus" else _on_ellipsoid
    oracle = torus_oracle if kind == "torus" else ellipsoid_oracle
    polylines = [maker(chords) for chords in CHORDS]
    for surface, poses in draws(kind, count // per_surface, per_surface, seed, "all"):
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_euler("XYZ", surface.angles).as_matrix()
        ends = (poses.reshape(-1, 2, 3) @ turn).reshape(-1, 6)
        length, slope, on_surface = engine_paths(surface, ends)
        sizes = np.array((*surface.sizes, surface.sizes[-1], surface.sizes[-1])[:3])
        differences = np.stack(
            [
                (engine_paths(surface, ends + step)[0] - engine_paths(surface, ends - step)[0])
                / (2.0 * _STEP)
                for step in _STEP * np.eye(6)
            ],
            axis=1,
        )
        for row in np.flatnonzero(on_surface > 1e-6):
            expected = oracle(ends[row, :3], ends[row, 3:], sizes, polylines)
            lengths.append(abs(length[row] - expected))
            arms.append(np.abs(slope[row] - differences[row]).max())
        touched += int((on_surface > 1e-6).sum())
    share = touched / (count // per_surface * per_surface)
    return Differences(f"{kind}, shortest path", np.array(lengths), np.array(arms), LIMIT), share


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="compare shortest paths with minimised polylines")
    parser.add_argument("--kinds", nargs="+", default=list(_KINDS), choices=_KINDS, metavar="KIND")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print(HEAD)
    for kind in options.kinds:
        found, share = compare(kind, options.count, options.seed)
        print(found.row(), flush=True)
        print(f"share of {kind} paths that touch: {share:.2f}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
