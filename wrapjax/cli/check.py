"""Command ``wrapjax check``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.cli.common import DONE, AddCommand, print_json


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    check = command("check", run, "Read a subject folder and show its content, or all errors in it.")
    check.add_argument("subject", type=Path, metavar="SUBJECT", help="subject folder")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from wrapjax.subject.description import describe_subject, render_tables
    from wrapjax.subject.subject import load_subject

    tables = describe_subject(load_subject(options.subject))
    if options.json:
        print_json(
            {
                table.title: [dict(zip(table.header, row, strict=True)) for row in table.rows]
                for table in tables
            }
        )
    else:
        print(render_tables(tables))
    return DONE
