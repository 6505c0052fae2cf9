"""Time of length and moment arms of a path round one surface of each kind, beside OpenSim.

``python -m benchmarks.wrap_surfaces`` computes 1,000 random poses of one path round a random unrestricted
surface of each kind (``--poses N``, ``--kinds KIND ...``), by the exact engine in both modes and by OpenSim's
``GeometryPath``: the length, and the moment arms about six coordinates. OpenSim's moment arms are minus
lengthening speeds, its fastest way. The engine is timed once compiled, from positions of points and bodies
on. Both use one core; each time is the best of three.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.machine import pin_threads
from wrapjax.jax_setup import set_up_jax

KINDS = ("cylinder", "sphere", "ellipsoid", "torus")
_REPEATS = 3


def best_seconds(function: Callable[[], object]) -> float:
    """Time a function and return the shortest of several times, s."""
    times = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def compare(kind: str, count: int, seed: int) -> dict[str, float]:
    """Time one path and pose by the engine's modes and by OpenSim, s."""
    import equinox as eqx
    import jax

    from validation.wrapping.draws import draws
    from validation.wrapping.single_path import COORDINATES, MUSCLE, write_model
    from wrapjax.osim.path_engine import PathEngine
    from wrapjax.path_sources.muscle_paths import muscle_paths

    ((surface, poses),) = draws(kind, 1, count, seed, "all")
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        write_model([surface], file)
        reference = PathEngine(file, COORDINATES, {MUSCLE: COORDINATES})
        seconds["GeometryPath"] = best_seconds(lambda: reference.analyse(poses)) / count
        for mode in ("geodesic", "parity"):
            posed = muscle_paths(file, mode=mode, coordinates=COORDINATES).posed(poses)
            evaluate = eqx.filter_jit(lambda own: own())
            jax.block_until_ready(evaluate(posed))
            seconds[mode] = (
                best_seconds(lambda: jax.block_until_ready(evaluate(posed))) / count  # noqa: B023
            )
    return seconds


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="time paths round surfaces beside OpenSim's")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND")
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print("| surface | GeometryPath, us | geodesic, us | times as fast | parity, us | times as fast |")
    print("|---|---|---|---|---|---|")
    for kind in options.kinds:
        one = compare(kind, options.poses, options.seed)
        reference = one["GeometryPath"]
        columns = [f"{1e6 * one[mode]:.2f} | {reference / one[mode]:.1f}" for mode in ("geodesic", "parity")]
        print(f"| {kind} | {1e6 * reference:.1f} | {' | '.join(columns)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
