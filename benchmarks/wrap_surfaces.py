"""Time of length and moment arms of a path round one surface of each kind, beside OpenSim.

``python -m benchmarks.wrap_surfaces`` computes 1,000 poses of one path whose end moves along a circle, round
a random unrestricted surface of each kind (``--poses N``, ``--kinds KIND ...``): the length and moment arms
about six coordinates by the exact engine in both modes, and by OpenSim's ``GeometryPath`` once the length
alone and once the length and moment arms. OpenSim's moment arms are minus lengthening speeds, its fastest
way. The engine is timed once compiled, from positions of points and bodies on; OpenSim's length from a
realised position on, and its moment arms with the velocities of bodies that they need. OpenSim's
``Scholz2015GeometryPath`` computes a path with positions: its time is that of both less that of positions
alone; it follows its path from pose to pose, and needs neighboring poses. All use one core; each time is the
best of three.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.wrapping.draws import draw_sweep, draws
from validation.wrapping.single_path import SurfaceDraw
from wrapjax.jax_setup import set_up_jax

KINDS = ("cylinder", "sphere", "ellipsoid", "torus")
_REPEATS = 3
# Radius of the circle, as a share of the end's distance from the surface's center.
_REACH = 0.1


def best_seconds(function: Callable[[], object]) -> float:
    """Time a function and return the shortest of several times, s."""
    times = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def swept_path(kind: str, count: int, seed: int) -> tuple[SurfaceDraw, Float[np.ndarray, "pose coordinate"]]:
    """Draw an unrestricted surface and poses of a path whose end moves once round a circle."""
    ((surface, ends),) = draws(kind, 1, 1, seed, "all")
    return surface, draw_sweep(ends[0], count, _REACH, np.random.default_rng(seed + 1))[0]


def compare(kind: str, count: int, seed: int) -> dict[str, float]:
    """Time one path and pose by the engine's modes and by OpenSim, s."""
    import equinox as eqx
    import jax

    from validation.wrapping.scholz_paths import contact_hint
    from validation.wrapping.single_path import COORDINATES, MUSCLE, by_scholz, write_model
    from wrapjax.osim.path_engine import PathEngine
    from wrapjax.path_sources.muscle_paths import muscle_paths

    surface, poses = swept_path(kind, count, seed)
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        write_model([surface], file)
        reference = PathEngine(file, COORDINATES, {MUSCLE: COORDINATES})
        seconds["length and arms"] = best_seconds(lambda: reference.analyse(poses)) / count
        seconds["length"] = min(_length_seconds(file, poses) for _ in range(_REPEATS))
        hint = contact_hint(surface, file, poses[0])
        seconds["scholz"] = min(by_scholz(surface, hint, poses)[1] for _ in range(_REPEATS))
        for mode in ("geodesic", "parity"):
            posed = muscle_paths(file, mode=mode, coordinates=COORDINATES).posed(poses)
            evaluate = eqx.filter_jit(lambda own: own())
            jax.block_until_ready(evaluate(posed))
            seconds[mode] = (
                best_seconds(lambda: jax.block_until_ready(evaluate(posed))) / count  # noqa: B023
            )
    return seconds


def _length_seconds(file: Path, poses: Float[np.ndarray, "pose coordinate"]) -> float:
    """Time OpenSim's length of one path in one pose whose position is realised, s."""
    from validation.wrapping.single_path import COORDINATES
    from wrapjax.osim.loading import load_model

    model, state = load_model(file)
    path = model.getMuscles().get(0).getGeometryPath()
    coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
    taken = 0.0
    for pose in poses:
        for coordinate, value in zip(coordinates, pose, strict=True):
            coordinate.setValue(state, float(value), False)
        model.realizePosition(state)
        began = time.perf_counter()
        path.getLength(state)
        taken += time.perf_counter() - began
    return taken / len(poses)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="time paths round surfaces beside OpenSim's")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND")
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    titles = (
        *("OpenSim: length, us", "length and arms, us", "Scholz: length, us", "geodesic, us", "parity, us"),
        *("geodesic: times as fast as OpenSim's length", "as Scholz's", "parity: as OpenSim's length"),
    )
    print(f"| surface | {' | '.join(titles)} |\n|{'---|' * (len(titles) + 1)}")
    for kind in options.kinds:
        one = compare(kind, options.poses, options.seed)
        names = ("length", "length and arms", "scholz", "geodesic", "parity")
        times = [f"{1e6 * one[name]:.2f}" for name in names]
        pairs = (("length", "geodesic"), ("scholz", "geodesic"), ("length", "parity"))
        faster = [f"{one[slow] / one[fast]:.1f}" for slow, fast in pairs]
        print(f"| {kind} | {' | '.join((*times, *faster))} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
