"""Command ``wrapjax contact``, with the table of joint contact forces."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, print_result
from wrapjax.cli.compare import mean_and_deviation
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.contact_forces.contact_force import Contact


def contact_table(contact: Contact) -> str:
    """Tabulate the peak contact forces of each joint by each run, with the tests between runs."""
    from wrapjax.comparison.statistics import spread
    from wrapjax.contact_forces.contact_result import peak_windows, peaks
    from wrapjax.report.contact_forces.page import contact_findings, undriven_findings
    from wrapjax.report.contact_forces.summary import compared_peaks, tests_reason

    result = contact.result
    lines = [textwrap.fill(contact_findings(result)[0], 100), ""]
    lines.append(f"{'peak':24s}{'run':16s}{'bodyweights':>18s}{'N':>18s}{'% of cycle':>14s}")
    for part in result.parts:
        for measure, window in peak_windows(part).items():
            for run in result.runs:
                part_peaks = peaks(result.curves(run, part), result.phase, window)
                columns = (
                    (part_peaks.force / result.bodyweight, 2),
                    (part_peaks.force, 0),
                    (part_peaks.phase, 0),
                )
                cells = [mean_and_deviation(spread(values), digits) for values, digits in columns]
                name = f"{part}, {measure.replace('_', ' ')}"
                lines.append(f"{name:24s}{run.label:16s}{cells[0]:>18s}{cells[1]:>18s}{cells[2]:>14s}")
    lines.append("")
    if reason := tests_reason(result):
        lines.append(f"not tested: {reason}")
    for joint, measure, test in compared_peaks(result):
        if test is not None:
            lines.append(
                f"{joint}, {measure.replace('_', ' ')}: {result.runs[1].label} less {result.runs[0].label} "
                f"{test.difference:+.3f} bodyweights (95 % {test.low:.3f} to {test.high:.3f}), paired t-test "
                f"over {test.n} cycles: p = {test.p:.2g}"
            )
    lines += [textwrap.fill(sentence, 100) for sentence in undriven_findings(result)]
    return "\n".join([*lines, *contact_findings(result)[1 + len(result.runs) :]])


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    contact = command("contact", run, "Compute joint contact forces from one or two calibrations.", writing)
    contact.add_argument(
        "first", type=Path, metavar="RUN", help="folder from 'wrapjax calibrate', method NGA or PGA"
    )
    contact.add_argument(
        "second",
        type=Path,
        nargs="?",
        metavar="RUN2",
        help="second run of the same subject, tested against the first",
    )
    contact.add_argument("--out", type=Path, metavar="DIR", help="output folder (default: RUN/contact)")
    contact.add_argument(
        "--subject",
        type=Path,
        metavar="SUBJECT",
        help="subject folder, if it has been moved since the calibration",
    )
    contact.add_argument(
        "--undriven",
        choices=["static-optimization", "left"],
        default="static-optimization",
        help="muscles without an electrode: static-optimization, they balance the remaining joint moments "
        "with least squared activations (default); left, they have no force",
    )
    contact.add_argument(
        "--condyle-distance",
        type=float,
        metavar="M",
        help="distance between the medial and lateral contact points of the knee, m; divides the knee's "
        "force between the two sides (default: not divided)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.contact_forces.contact_force import contact
    from wrapjax.progress import print_progress

    options.out = options.out or options.first / "contact"
    check_output_folder(options.out, options.force)
    done = contact(
        options.first,
        options.second,
        subject=options.subject,
        undriven=options.undriven,
        condyle_distance=options.condyle_distance,
        log=lambda line: print_progress(line, quiet=options.quiet),
    )
    done.save(options.out, force=options.force)
    print_result(options, "contact.json", lambda: contact_table(done))
    return DONE if done.converged else NOT_CONVERGED
