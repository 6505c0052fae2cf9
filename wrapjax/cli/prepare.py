"""Command ``wrapjax prepare``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json, read_json
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    prepare = command(
        "prepare",
        run,
        "Make a subject folder from a laboratory's raw files or a project of the NMSM Pipeline.",
    )
    prepare.add_argument(
        "settings",
        type=Path,
        metavar="SETTINGS",
        help="laboratory settings (TOML), or settings of the NMSM Pipeline's muscle-tendon personalization "
        "(XML)",
    )
    prepare.add_argument("--out", type=Path, required=True, metavar="SUBJECT", help="subject folder to write")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    # Inverse kinematics in JAX, if the settings name it.
    set_up_jax()
    from wrapjax.preprocessing.preparation import prepare_subject
    from wrapjax.progress import print_progress
    from wrapjax.subject.description import render_tables

    check_output_folder(options.out, options.force)
    done = prepare_subject(options.settings, log=lambda line: print_progress(line, quiet=options.quiet))
    done.save(options.out, force=options.force)
    if options.json:
        print_json(read_json(options.out / "preparation.json"))
    else:
        print(render_tables(done.tables()))
        print(f"written to {options.out}; look at {options.out / 'report.html'}")
    return DONE
