"""Paths round one random surface in random poses, by the exact engine in parity mode and by OpenSim 4.6.

``python -m validation.wrapping.random_configurations`` draws 10,000 configurations of each kind of surface:
50 surfaces with 200 poses each. ``--surfaces N --poses N --kinds KIND ... --seed N`` change that. Quadrants
are drawn, too; unrestricted and restricted surfaces have rows of their own. The limit is 1e-9 m for
cylinders and spheres, 5e-6 m for ellipsoids and 1e-6 m for tori, whose nearest point OpenSim searches to a
relative tolerance.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.machine import pin_threads
from validation.wrapping.differences import HEAD, Differences
from validation.wrapping.draws import KINDS, draws
from validation.wrapping.single_path import COORDINATES, MUSCLE, by_opensim, write_model
from wrapjax.jax_setup import set_up_jax

#: Largest difference of length that counts as agreement (m), by kind.
LIMITS = {"cylinder": 1e-9, "sphere": 1e-9, "torus": 1e-6}
_ELLIPSOID_LIMIT = 5e-6


def compare(kind: str, surfaces: int, poses: int, seed: int, quadrant: str | None) -> Differences:
    """Compare paths round random surfaces of a kind."""
    from wrapjax.geometry.exact_paths.engine import PARITY, ExactPaths, nominal_parameters, wrap_at_samples
    from wrapjax.osim.model import describe_model

    lengths, arms = [], []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        for surface, drawn in draws(kind, surfaces, poses, seed, quadrant):
            write_model([surface], file)
            length, arm = by_opensim(file, drawn)
            engine = ExactPaths(describe_model(file), [MUSCLE], COORDINATES)
            found = wrap_at_samples(engine.posed(drawn)[MUSCLE], nominal_parameters(1)[None], PARITY)
            lengths.append(np.abs(found.length[0] - length))
            arms.append(np.abs(found.moment_arm[0] - arm).max(axis=1))
    sides = "unrestricted" if quadrant == "all" else "any quadrant"
    limit = LIMITS.get(kind, _ELLIPSOID_LIMIT)
    return Differences(f"{kind}, {sides}", np.concatenate(lengths), np.concatenate(arms), limit)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="compare paths round random surfaces with OpenSim's")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND")
    parser.add_argument("--surfaces", type=int, default=50)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print(HEAD)
    for kind in options.kinds:
        for quadrant in ("all", None):
            found = compare(kind, options.surfaces, options.poses, options.seed, quadrant)
            print(found.row(), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
