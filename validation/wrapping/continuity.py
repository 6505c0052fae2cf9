"""Continuity of shortest paths round one surface over sweeps of poses.

``python -m validation.wrapping.continuity`` moves the end of a path round a random surface along a random
circle, in 500 poses a sweep (``--surfaces N``, ``--kinds KIND ...``, ``--seed N``), and in each of them by
1e-6 m more. The length of a continuous path changes by at most as much as the end moves. Poses with an end
inside the surface or beyond a margin (`regular`) are left out and counted: there is no shortest path, or none
that stays the shortest.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.machine import pin_threads
from validation.wrapping.draws import draw_sweep, draws
from validation.wrapping.single_path import COORDINATES, write_model
from wrapjax.jax_setup import set_up_jax

#: Kinds of surfaces, and step between two poses (m).
KINDS, STEP = ("cylinder", "sphere", "ellipsoid", "torus"), 1e-6
#: Poses of a sweep.
POSES = 500


def sweep(kind: str, surfaces: int, seed: int) -> tuple[np.ndarray, int]:
    """Compute changes of length between neighboring poses (m), and the number of poses left out."""
    from wrapjax.path_sources.muscle_paths import muscle_paths

    changes, left_out = [], 0
    generator = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        for surface, ends in draws(kind, surfaces, 1, seed, "all"):
            write_model([surface], file)
            paths = muscle_paths(file, coordinates=COORDINATES)
            poses, direction = draw_sweep(ends[0], POSES, 0.6, generator)
            moved = poses.copy()
            moved[:, 3:] += STEP * direction
            one, other = paths(poses), paths(moved)
            kept = (one.regular & other.regular)[:, 0]
            changes.append(np.abs(one.length - other.length)[kept, 0])
            left_out += int((~kept).sum())
    return np.concatenate(changes), left_out


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="continuity of shortest paths over sweeps of poses")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND")
    parser.add_argument("--surfaces", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print("| surface | steps of 1e-6 m | largest change, m | beyond 1e-6 m | left out |")
    print("|---|---|---|---|---|")
    for kind in options.kinds:
        changes, left_out = sweep(kind, options.surfaces, options.seed)
        beyond = int((changes > STEP * (1.0 + 1e-6)).sum())
        print(f"| {kind} | {changes.size} | {changes.max():.2e} | {beyond} | {left_out} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
