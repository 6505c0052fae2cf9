"""Command ``wrapjax show``: a page with a model in motion, in three dimensions."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    show = command(
        "show",
        run,
        "Show a model in motion in three dimensions: bones, joint axes, muscle paths and wrapping surfaces, "
        "with curves beside them, in one HTML file.",
    )
    show.add_argument(
        "place",
        type=Path,
        metavar="MODEL|SUBJECT|JOINTS|FIT|RUN|GAP",
        help="OpenSim model (.osim), subject folder, or folder from 'joints', 'fit', 'calibrate' or "
        "'diagnose'",
    )
    show.add_argument("--out", type=Path, required=True, metavar="FILE", help="HTML file to write")
    show.add_argument(
        "--subject",
        type=Path,
        metavar="SUBJECT",
        help="subject folder with the recorded motion (default: that of the result; a model alone moves "
        "each joint through its range)",
    )
    show.add_argument(
        "--bones",
        type=Path,
        metavar="DIR",
        help="folder of the bones' surfaces, .vtp (default: where OpenSim looks for them)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.progress import print_progress
    from wrapjax.report.model_view.show import show

    written = show(
        options.place,
        options.out,
        subject=options.subject,
        bones=options.bones,
        force=options.force,
        log=partial(print_progress, quiet=options.quiet),
    )
    if options.json:
        print_json({"page": str(written)})
    else:
        print(f"written: {written}; open it in a browser")
    return DONE
