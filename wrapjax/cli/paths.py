"""Command ``wrapjax paths``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.cli.common import DONE, AddCommand, print_json
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.path_sources.path_tables import PathTables


def path_table(tables: PathTables) -> str:
    """Tabulate the muscles: shares of poses in which they touch a wrap, and range of length."""
    lines = [
        f"{len(tables.time)} poses, {tables.paths.mode} paths. Shares of poses in which the path touches",
        "a wrap, and in which it is beyond a discontinuity of its length (a point inside a wrap, off",
        "a cylinder's end, more than half a turn)",
        f"{'muscle':20s}{'wraps':>7s}{'touches':>10s}{'beyond':>10s}{'shortest, m':>14s}{'longest, m':>13s}",
    ]
    muscles = tables.summary()["muscles"]
    assert isinstance(muscles, dict)
    for name, entry in muscles.items():
        shortest, longest = entry["length_m"]
        lines.append(
            f"{name:20s}{len(entry['wraps']):7d}{entry['touching_share']:10.2f}"
            f"{entry['irregular_share']:10.2f}{shortest:14.4f}{longest:13.4f}"
        )
    return "\n".join(lines)


def inside_sentence(tables: PathTables) -> str:
    """Name the wraps that a path point is inside of in every pose; empty without one."""
    named = [
        f"{muscle} {wrap} ({1e3 * depth:.2g} mm)"
        for muscle, wraps in tables.inside.items()
        for wrap, depth in wraps.items()
    ]
    if not named:
        return ""
    answer = {
        "parity": "As in OpenSim, the segments of the path next to it do not wrap there",
        "geodesic": "The shortest path begins on the surface there; OpenSim does not wrap the segments next "
        "to the point",
    }[tables.paths.mode]
    return f"In every pose a point of the path is inside a wrap: {', '.join(named)}. {answer}."


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    about = "Compute muscle lengths and moment arms of an OpenSim model in poses, without OpenSim."
    paths = command("paths", run, about, writing)
    paths.add_argument("model", type=Path, metavar="MODEL", help="OpenSim model (.osim)")
    paths.add_argument(
        "--poses",
        type=Path,
        required=True,
        metavar="FILE",
        help=".sto or .mot table with a row a pose and a column a coordinate; other coordinates stay at the "
        "model's defaults",
    )
    paths.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    paths.add_argument(
        "--mode",
        choices=["parity", "geodesic"],
        default="geodesic",
        help="geodesic, shortest paths (default); parity, paths as OpenSim 4.6 has them, defects included",
    )
    paths.add_argument(
        "--skip-unsupported",
        action="store_true",
        help="leave out muscles whose path cannot be computed, instead of stopping",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.path_sources.muscle_paths import muscle_paths
    from wrapjax.path_sources.path_tables import path_tables

    check_output_folder(options.out, options.force)
    paths = muscle_paths(options.model, mode=options.mode, skip_unsupported=options.skip_unsupported)
    for name, reason in paths.unsupported.items():
        print(f"left out: muscle {name}: {reason}", file=sys.stderr)
    tables = path_tables(paths, options.poses)
    tables.save(options.out, force=options.force)
    if options.json:
        print_json(tables.summary())
        return DONE
    print(path_table(tables))
    if tables.at_default:
        print(f"\nat the model's defaults: {', '.join(tables.at_default)}")
    if sentence := inside_sentence(tables):
        print(f"\n{sentence}")
    print(f"\nwritten to {options.out}")
    return DONE
