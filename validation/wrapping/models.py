"""Every muscle path of OpenSim models, by the exact engine in parity mode and by OpenSim 4.6.

``python -m validation.wrapping.models MODEL.osim ...`` draws 200 poses of each model (``--poses N``): all
coordinates that a muscle spans, within their ranges and 1 rad of their defaults. It prints a row for each
kind of path (straight, round one surface of a kind, round several) and the muscles with the largest
differences. ``--mode geodesic`` compares shortest paths, which differ from OpenSim's by its approximations,
and their moment arms with central differences of their own lengths.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from benchmarks.machine import pin_threads
from validation.wrapping.differences import HEAD, Differences
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.path_sources.muscle_paths import MusclePaths

#: Largest differences of length that count as agreement (m): of paths with an ellipsoid, with several
#: surfaces, of which OpenSim's sweeps are unfinished, and of others.
ELLIPSOID_LIMIT, SEVERAL_LIMIT, LIMIT = 5e-6, 5e-4, 1e-9
# Step of central differences, rad or m.
_STEP = 2e-6


def kind_of_path(paths: MusclePaths, muscle: str) -> tuple[str, float]:
    """Return the kind of a path, and its limit (m)."""
    wraps = paths.engine.wraps_of(muscle)
    kinds = [paths.engine.model.wrap(wrap).kind.removeprefix("Wrap").lower() for wrap in wraps]
    if not kinds:
        return "straight", LIMIT
    if len(kinds) > 1:
        return "several surfaces", SEVERAL_LIMIT
    return kinds[0], {"ellipsoid": ELLIPSOID_LIMIT, "torus": 1e-6}.get(kinds[0], LIMIT)


def draw_poses(paths: MusclePaths, count: int, seed: int) -> Float[np.ndarray, "pose coordinate"]:
    """Draw values of all coordinates within their ranges and 1 rad of their defaults."""
    model = paths.engine.model
    coordinates = [model.coordinate(name) for name in paths.coordinates]
    low = [max(one.range[0], one.default_value - 1.0) for one in coordinates]
    high = [min(one.range[1], one.default_value + 1.0) for one in coordinates]
    return np.random.default_rng(seed).uniform(low, high, (count, len(coordinates)))


def by_opensim(
    file: Path, paths: MusclePaths, poses: Float[np.ndarray, "pose coordinate"]
) -> tuple[Float[np.ndarray, "pose muscle"], Float[np.ndarray, "pose coordinate muscle"]]:
    """Compute lengths (m) and moment arms (m) of all muscles by OpenSim's own functions."""
    from wrapjax.osim.path_engine import PathEngine

    engine = PathEngine(file, paths.coordinates, dict.fromkeys(paths.muscles, paths.coordinates))
    # All moment arms by ``computeMomentArm``.
    everything = list(range(len(paths.muscles)))
    engine._by_opensim = [everything] * len(paths.coordinates)
    engine._by_speed = [[]] * len(paths.coordinates)
    return engine.analyse(poses)


def compare(file: Path, mode: str, count: int, seed: int) -> list[str]:
    """Compare all paths of a model; return rows of the table and sentences on the largest differences."""
    from wrapjax.path_sources.muscle_paths import muscle_paths

    paths = muscle_paths(file, mode=mode, skip_unsupported=True)
    poses = draw_poses(paths, count, seed)
    length, arms = by_opensim(file, paths, poses)
    found = paths(poses)
    by_length = np.abs(found.length - length)
    by_arm = np.abs(found.moment_arm - arms).max(axis=1)
    kinds = {name: kind_of_path(paths, name) for name in paths.muscles}
    rows = []
    for kind, limit in dict.fromkeys(kinds.values()):
        columns = [number for number, name in enumerate(paths.muscles) if kinds[name][0] == kind]
        title = f"{file.stem}, {len(columns)} {kind}"
        rows.append(
            Differences(title, by_length[:, columns].ravel(), by_arm[:, columns].ravel(), limit).row()
        )
    worst = np.argsort(-np.nan_to_num(by_length.max(axis=0)))[:5]
    for number in worst:
        name = paths.muscles[number]
        beyond = int((by_length[:, number] > kinds[name][1]).sum())
        if beyond:
            largest = by_length[:, number].max()
            rows.append(f"{name} ({kinds[name][0]}): {beyond} of {count} poses beyond, worst {largest:.1e} m")
    rows += [f"left out, {name}: {reason}" for name, reason in paths.unsupported.items()]
    if mode == "geodesic":
        values = (np.asarray(part) for part in (found.length, found.moment_arm, found.regular))
        rows.append(_own_differences(paths, poses, *values))
    return rows


def _own_differences(
    paths: MusclePaths,
    poses: Float[np.ndarray, "pose coordinate"],
    length: Float[np.ndarray, "pose muscle"],
    arms: Float[np.ndarray, "pose coordinate muscle"],
    regular: np.ndarray,
) -> str:
    """Compare moment arms with central differences of the engine's own lengths."""
    errors = []
    for column, step in enumerate(_STEP * np.eye(poses.shape[1])):
        above, below = (paths(poses + sign * step).length for sign in (1.0, -1.0))
        smooth = regular & (np.abs(above + below - 2.0 * length) < 1e-10)
        error = np.abs(arms[:, column] + (above - below) / (2.0 * _STEP))
        errors.append(error[smooth])
    joined = np.concatenate(errors)
    return (
        f"moment arms from central differences of length, {joined.size} regular ones: worst "
        f"{joined.max():.1e} m, {(joined > 1e-7).mean():.2%} beyond 1e-7 m"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="compare the muscle paths of models with OpenSim's")
    parser.add_argument("models", nargs="+", type=Path, metavar="MODEL")
    parser.add_argument("--mode", choices=["parity", "geodesic"], default="parity")
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    pin_threads()
    set_up_jax()
    print(HEAD)
    for file in options.models:
        print("\n".join(compare(file, options.mode, options.poses, options.seed)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
