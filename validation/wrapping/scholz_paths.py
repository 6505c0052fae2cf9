"""Shortest paths of the exact engine against OpenSim's ``Scholz2015GeometryPath`` over smooth sweeps.

``python -m validation.wrapping.scholz_paths`` moves the end of a path round each of 20 random surfaces of a
kind along a random circle, in 500 poses (``--surfaces N``, ``--kinds KIND ...``, ``--seed N``). OpenSim's
path follows a geodesic from pose to pose, from the engine's contact in the first one, with no other help.
Poses that the engine holds for irregular (an end inside the surface, or no single shortest path nearby) and
those after a failure of OpenSim's are left out and counted. Where lengths differ, one of the two paths goes
another way: the longer one is not the shortest.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.wrapping.draws import draw_sweep, draws
from validation.wrapping.single_path import COORDINATES, MUSCLE, SurfaceDraw, by_scholz, write_model
from wrapjax.jax_setup import set_up_jax

#: Kinds of surfaces, largest difference of length that counts as the same path (m), and poses of a sweep.
KINDS, SAME, POSES = ("cylinder", "sphere", "ellipsoid", "torus"), 1e-9, 500
# Radius of the circles, as a share of the end's distance from the surface's center.
_REACH = 0.3


@dataclass(frozen=True)
class Compared:
    """Sweeps round surfaces of a kind.

    Parameters
    ----------
    difference
        Engine's length less OpenSim's in regular poses in which the engine's path touches, m.
    irregular, failed, straight
        Numbers of poses that are irregular, that come after a failure of OpenSim's, and whose path does not
        touch.
    """

    difference: Float[np.ndarray, " pose"]
    irregular: int
    failed: int
    straight: int


def contact_hint(surface: SurfaceDraw, file: Path, pose: Float[np.ndarray, " coordinate"]) -> np.ndarray:
    """Middle between both ends of the engine's contact in a pose, in the surface's frame, m."""
    from scipy.spatial.transform import Rotation

    from wrapjax.geometry.exact_paths.routed_path import route_path
    from wrapjax.osim.model import describe_model

    contacts = route_path(describe_model(file), MUSCLE, COORDINATES, pose).contacts
    if not contacts:
        return np.array([0.0, surface.sizes[0], 0.0])
    (ends,) = contacts.values()
    return ends.mean(axis=0) @ Rotation.from_euler("XYZ", surface.angles).as_matrix()


def compare(kind: str, surfaces: int, seed: int) -> Compared:
    """Compare sweeps round random surfaces of a kind."""
    from wrapjax.path_sources.muscle_paths import muscle_paths

    differences, irregular, failed, straight = [], 0, 0, 0
    generator = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.osim"
        for surface, ends in draws(kind, surfaces, 1, seed, "all"):
            write_model([surface], file)
            poses, _ = draw_sweep(ends[0], POSES, _REACH, generator)
            found = muscle_paths(file, coordinates=COORDINATES)(poses)
            length, regular = np.asarray(found.length)[:, 0], np.asarray(found.regular)[:, 0]
            touches = length > np.linalg.norm(poses[:, 3:] - poses[:, :3], axis=1) + 1e-12
            by_opensim, _ = by_scholz(surface, contact_hint(surface, file, poses[0]), poses)
            known = np.isfinite(by_opensim)
            differences.append((length - by_opensim)[known & regular & touches])
            irregular += int((~regular).sum())
            failed += int((regular & ~known).sum())
            straight += int((regular & known & ~touches).sum())
    return Compared(np.concatenate(differences), irregular, failed, straight)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="compare shortest paths with OpenSim's Scholz paths")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND")
    parser.add_argument("--surfaces", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    titles = ("poses", "same within 1e-9 m", "largest difference of these, m", "engine shorter", "longer")
    more = ("irregular", "after OpenSim failed", "straight")
    print(f"| surface | {' | '.join((*titles, *more))} |\n|{'---|' * 9}")
    for kind in options.kinds:
        one = compare(kind, options.surfaces, options.seed)
        same = np.abs(one.difference) <= SAME
        longer = one.difference[one.difference > SAME]
        numbers = (
            one.difference.size,
            int(same.sum()),
            f"{np.abs(one.difference[same]).max(initial=0.0):.1e}",
            int((one.difference < -SAME).sum()),
            f"{longer.size}, by up to {longer.max():.0e} m" if longer.size else "0",
            one.irregular,
            one.failed,
            one.straight,
        )
        print(f"| {kind} | {' | '.join(map(str, numbers))} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
