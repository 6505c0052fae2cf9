"""Compare inverse kinematics with OpenSim's: distances, coordinates, and frames a second.

Run it as ``python -m validation.joints.inverse_kinematics MODEL MARKERS [--marker-set FILE] [--frames 40]``,
or without files to use the recorded walk (``WRAPJAX_DATA``) with the model as it is and with its joints
personalised. OpenSim solves the first frames at an accuracy of 1e-9. Times are of one core (set ``NPROC=1``),
checks included, without compilation, which is stated apart.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from wrapjax.jax_setup import set_up_jax
from wrapjax.joints.personalisation import personalize_joints
from wrapjax.joints.settings import JointSettings, MarkerTrial
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_joints import JointChanges, write_model_with_joints
from wrapjax.osim.tools import solve_inverse_kinematics
from wrapjax.preprocessing.files.markers import match_markers, write_trc
from wrapjax.preprocessing.inverse_kinematics import read_marker_file, solve

#: Aims: degrees for determined coordinates, share of the root mean square, ratio of frames a second.
MAX_DEGREES, MAX_SHARE, MIN_SPEED = 0.01, 1e-3, 50.0


def compare(model: Path, file: Path, frames: int) -> bool:
    """Print the comparison for one model and file; return whether the aims are met."""
    description = describe_model(model)
    markers = read_marker_file(file)
    names = match_markers(markers, tuple(marker.name for marker in description.markers), (), file)
    markers = markers.select(names)
    weights = np.ones(len(names))
    began = time.perf_counter()
    solve(description, markers, weights, {}, file)
    first = time.perf_counter() - began
    began = time.perf_counter()
    found = solve(description, markers, weights, {}, file)
    seconds = time.perf_counter() - began
    end = float(markers.time[min(frames, markers.time.size) - 1])
    with tempfile.TemporaryDirectory() as folder:
        # OpenSim reads the same numbers, in m.
        trc = Path(folder) / "markers.trc"
        write_trc(trc, markers)
        began = time.perf_counter()
        theirs = solve_inverse_kinematics(
            model, trc, dict.fromkeys(names, 1.0), float(markers.time[0]), end, accuracy=1e-9
        )
        opensim = time.perf_counter() - began
    count = theirs.time.size
    rows = [theirs.coordinates.index(name) for name in found.coordinates]
    difference = np.abs(found.values[:, :count] - theirs.values[rows])
    known = found.determined & ~np.array([entry.locked for entry in description.coordinates])
    ours = np.sqrt(np.mean(found.distances[:, :count] ** 2))
    other = np.sqrt(np.nanmean(np.sum((theirs.positions - markers.positions[:, :count]) ** 2, axis=-1)))
    degrees = np.degrees(difference[known & found.rotational].max())
    metres = difference[known & ~found.rotational].max(initial=0.0)
    rates = (markers.time.size / seconds, count / opensim)
    print(f"{model.name}, {file.name}: {len(names)} markers, {int(known.sum())} determined coordinates")
    print(f"  root mean square {1e3 * ours:.6f} mm, OpenSim {1e3 * other:.6f} mm ({ours / other - 1.0:+.1e})")
    print(f"  largest difference of determined coordinates {degrees:.1e} degrees, {metres:.1e} m")
    print(
        f"  {rates[0]:.0f} frames a second, OpenSim {rates[1]:.1f} ({rates[0] / rates[1]:.0f} times); "
        f"first call {first:.1f} s, compilation included",
        flush=True,
    )
    return bool(
        degrees <= MAX_DEGREES and abs(ours / other - 1.0) <= MAX_SHARE and rates[0] / rates[1] >= MIN_SPEED
    )


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare inverse kinematics with OpenSim's.")
    parser.add_argument("model", type=Path, nargs="?")
    parser.add_argument("markers", type=Path, nargs="?")
    parser.add_argument("--marker-set", type=Path)
    parser.add_argument("--frames", type=int, default=40)
    options = parser.parse_args()
    set_up_jax()
    recorded = Path(os.environ.get("WRAPJAX_DATA", ".")) / "markers_walk"
    model = options.model or recorded / "RajagopalLaiUhlrich2023.osim"
    file = options.markers or recorded / "motion_capture_walk.trc"
    marker_set = options.marker_set or (None if options.model else recorded / "markerset_walk.xml")
    with tempfile.TemporaryDirectory() as folder:
        with_markers = Path(folder) / "model_as_it_is.osim"
        write_model_with_joints(model, with_markers, JointChanges(), marker_set)
        met = compare(with_markers, file, options.frames)
        if options.model is None:
            settings = JointSettings(file, "walk", with_markers, (MarkerTrial("walk", file),))
            personalised = Path(folder) / "model_joints.osim"
            personalised.write_bytes(personalize_joints(settings).model)
            met = compare(personalised, file, options.frames) and met
    print("aims met" if met else "aims missed")
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
