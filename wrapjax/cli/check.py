"""Command ``wrapjax check``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.cli.common import DONE, AddCommand, print_json

if TYPE_CHECKING:
    from wrapjax.subject.description import Table
    from wrapjax.subject.subject import Subject


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    check = command("check", run, "Read a subject folder and show its content, or all errors in it.")
    check.add_argument("subject", type=Path, metavar="SUBJECT", help="subject folder")
    check.add_argument(
        "--out", type=Path, metavar="DIR", help="also write a report with a figure for every finding"
    )
    check.add_argument(
        "--capacity",
        action="store_true",
        help="also compute, by OpenSim, which share of each joint's moment capacity has no electrode",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from wrapjax.preprocessing.checks.recording_findings import recording_findings
    from wrapjax.subject.description import Table, describe_subject, render_tables, tables_content
    from wrapjax.subject.subject import load_subject

    subject = load_subject(options.subject)
    findings = recording_findings(subject)
    rows = tuple((one.kind, one.sentence) for one in findings)
    tables = (*describe_subject(subject), Table("Findings in the recordings", ("kind", "finding"), rows))
    if options.capacity:
        tables = (*tables, _capacity_table(subject))
    if options.out is not None:
        from wrapjax.report.check_page import write_check

        write_check(subject, tables, findings, options.out, force=options.force)
    if options.json:
        print_json(tables_content(tables))
    else:
        print(render_tables(tables))
        if options.out is not None:
            print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE


def _capacity_table(subject: Subject) -> Table:
    """Tabulate the share of each joint's moment capacity without an electrode, in either direction."""
    from wrapjax.path_sources.moment_capacity import unrecorded_capacity
    from wrapjax.subject.description import Table

    rows = tuple(
        (one.coordinate, f"{one.sign:+d}", round(100.0 * one.share, 1), ", ".join(one.muscles) or None)
        for one in unrecorded_capacity(subject)
    )
    header = ("coordinate", "direction", "without EMG (%)", "strongest muscles without EMG")
    return Table("Moment capacity without an electrode", header, rows)
