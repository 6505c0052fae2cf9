"""Compare the skeleton with OpenSim in random poses of every model that can be had.

Run it as ``python -m validation.skeleton MODEL.osim ... [--poses 1000]``, or without models to use those of
the recorded subjects (``WRAPJAX_DATA``). Coordinates are drawn from their ranges (within pi and 1 m). Exit
status 1 if a frame or marker differs by more than 1e-9 m or 1e-9 rad.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from wrapjax.geometry.skeleton.bodies import body_poses, build_skeleton, stations
from wrapjax.osim.body_frames import pose_bodies
from wrapjax.osim.model import describe_model

#: Largest accepted difference, m and rad.
LIMIT = 1e-9


def compare_with_opensim(model_file: Path, count: int, seed: int = 0) -> dict[str, float]:
    """Largest differences from OpenSim: of body frames (rad, m) and markers (m), and seconds of both."""
    model = describe_model(model_file)
    free = [entry for entry in model.coordinates if not (entry.coupled_to or entry.locked)]
    reach = np.array([np.pi if entry.motion == "rotational" else 1.0 for entry in free])
    low, high = np.array([entry.range for entry in free]).T
    poses = np.random.default_rng(seed).uniform(
        np.maximum(low, -reach), np.minimum(high, reach), (count, len(free))
    )
    names = tuple(entry.name for entry in free)
    structure, skeleton = build_skeleton(model, names)
    began = time.perf_counter()
    found = body_poses(structure, skeleton, poses)
    carriers = [structure.bodies.index(marker.body) for marker in model.markers]
    locations = np.array([marker.location for marker in model.markers]).reshape(-1, 3)
    positions = stations(found, carriers, locations) if carriers else np.zeros((count, 0, 3))
    ours = time.perf_counter() - began
    began = time.perf_counter()
    expected = pose_bodies(model_file, names, poses)
    theirs = time.perf_counter() - began
    rows = [structure.bodies.index(body) for body in expected.bodies]
    turned = np.einsum("pbij,pbik->pbjk", expected.rotation, found.rotation[:, rows])
    antisymmetric = turned - np.swapaxes(turned, -1, -2)
    angle = np.linalg.norm(antisymmetric, axis=(-1, -2)) / np.sqrt(8.0)
    return {
        "joints": len(structure.joints),
        "coordinates": len(names),
        "angle_rad": float(angle.max()),
        "origin_m": float(np.abs(found.origin[:, rows] - expected.origin).max()),
        "marker_m": float(np.abs(positions - expected.positions).max(initial=0.0)),
        "seconds": ours,
        "opensim_seconds": theirs,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare the skeleton with OpenSim in random poses.")
    parser.add_argument("models", nargs="*", type=Path)
    parser.add_argument("--poses", type=int, default=1000)
    options = parser.parse_args()
    folder = Path(os.environ.get("WRAPJAX_DATA", "."))
    models = options.models or sorted(folder.glob("*/*.osim"))
    worst = 0.0
    for file in models:
        row = compare_with_opensim(file, options.poses)
        worst = max(worst, row["angle_rad"], row["origin_m"], row["marker_m"])
        sizes = f"{row['joints']:.0f} joints, {row['coordinates']:.0f} coordinates"
        print(f"{file.parent.name}/{file.name}: {sizes}")
        print(
            f"  largest difference: {row['angle_rad']:.1e} rad, origins {row['origin_m']:.1e} m, markers "
            f"{row['marker_m']:.1e} m; {row['seconds']:.2f} s, OpenSim {row['opensim_seconds']:.2f} s"
        )
    print(f"{len(models)} models, {options.poses} poses each: at most {worst:.1e} (limit {LIMIT:g})")
    return 0 if models and worst <= LIMIT else 1


if __name__ == "__main__":
    raise SystemExit(main())
