"""Command ``wrapjax fetch``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json
from wrapjax.errors import InputError, Problem
from wrapjax.io.files import check_output_folder


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    fetch = command("fetch", run, "Download a public recording of walking as a subject folder.")
    fetch.add_argument("name", nargs="?", metavar="NAME", help="name of the recording, see --list")
    fetch.add_argument("--list", action="store_true", help="list the recordings that can be downloaded")
    fetch.add_argument("--out", type=Path, metavar="DIR", help="subject folder to write (default: ./NAME)")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from wrapjax.datasets.public_recordings import fetch, public_recordings

    known = public_recordings()
    if options.list:
        if options.json:
            print_json(known)
        else:
            print("\n".join(f"{name}: {about}." for name, about in known.items()))
        return DONE
    if options.name is None:
        raise InputError(
            Problem("NAME", f"expected a recording ({', '.join(known)}), found none", hint="see --list")
        )
    check_output_folder(options.out or Path(options.name), options.force)
    folder = fetch(options.name, options.out, force=options.force, quiet=options.quiet)
    if options.json:
        print_json({"name": options.name, "folder": str(folder)})
    else:
        print(f"written to {folder}; see what is in it with 'wrapjax check {folder}'")
    return DONE
