"""Command ``wrapjax ik``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, print_json, read_json
from wrapjax.cli.settings_file import add_settings
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    ik = command("ik", run, "Compute joint angles from recorded markers by inverse kinematics.")
    ik.add_argument("model", type=Path, metavar="MODEL", help="OpenSim model scaled to the person (.osim)")
    ik.add_argument("markers", type=Path, metavar="MARKERS", help="recorded markers (.trc, .c3d)")
    ik.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    ik.add_argument(
        "--tasks",
        type=Path,
        metavar="FILE",
        help="settings of OpenSim's inverse kinematics tool (.xml): weights of markers, goals of coordinates",
    )
    ik.add_argument("--marker-set", type=Path, metavar="FILE", help="OpenSim's marker set to add (.xml)")
    ik.add_argument(
        "--forward", default="x", metavar="AXIS", help="the laboratory's forward axis (default: x)"
    )
    ik.add_argument("--up", default="y", metavar="AXIS", help="the laboratory's upward axis (default: y)")
    ik.add_argument("--start", type=float, metavar="S", help="start of the interval, s")
    ik.add_argument("--end", type=float, metavar="S", help="end of the interval, s")
    add_settings(ik)


def kinematics_table(content: dict[str, Any]) -> str:
    """Tabulate the distances of markers."""
    width = max(map(len, (*content["markers_rms_mm"], "marker")))
    lines = [
        f"{content['converged_frames']} of {content['frames']} frames solved; the model's markers are "
        f"{content['rms_mm']:.2f} mm from those recorded (root mean square; at most {content['max_mm']:.1f})",
        "",
        f"{'marker':{width}s}{'distance (mm)':>16s}",
    ]
    lines += [f"{name:{width}s}{value:16.2f}" for name, value in content["markers_rms_mm"].items()]
    if content["undetermined"]:
        lines += ["", f"no marker determines {', '.join(content['undetermined'])}"]
    return "\n".join(lines)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.preprocessing.files.kinematics_settings import read_kinematics_settings
    from wrapjax.preprocessing.files.laboratory_settings import named_rotation
    from wrapjax.preprocessing.inverse_kinematics import inverse_kinematics, read_marker_file

    check_output_folder(options.out, options.force)
    rotation = named_rotation(options.forward, options.up)
    markers = read_marker_file(options.markers).rotated(rotation)
    start = markers.time[0] if options.start is None else options.start
    end = markers.time[-1] if options.end is None else options.end
    done = inverse_kinematics(
        options.model,
        markers.during(float(start), float(end)),
        settings=None if options.tasks is None else read_kinematics_settings(options.tasks),
        marker_set=options.marker_set,
        file=options.markers,
    )
    done.save(options.out, force=options.force)
    content = read_json(options.out / "ik.json")
    if options.json:
        print_json(content)
    else:
        print(kinematics_table(content))
        print(f"\nwritten to {options.out}")
    return DONE if done.converged.all() else NOT_CONVERGED
