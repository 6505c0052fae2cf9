"""``wrapjax report``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, AddCommand, print_json


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    report = command("report", run, "Draw a report again from what is stored, or an index of results.")
    report.add_argument("folder", type=Path, metavar="DIR", help="a result, or what holds several")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from wrapjax.api.runs.reporting import redraw

    page = redraw(options.folder)
    if options.json:
        print_json({"page": str(page)})
    else:
        print(f"written: {page}; open it in a browser")
    return DONE
