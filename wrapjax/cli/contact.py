"""``wrapjax contact``.

Contact forces as plain text for a terminal.
"""

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
    """Show what the forces are, and the peaks of each joint by each run."""
    from wrapjax.comparison.statistics import spread
    from wrapjax.contact_forces.result import peak_windows, peaks
    from wrapjax.report.contact_page import sentences, undriven_sentences
    from wrapjax.report.contact_summary import compared_peaks, tests_reason

    result = contact.result
    lines = [textwrap.fill(sentences(result)[0], 100), ""]
    lines.append(f"{'peak':24s}{'run':16s}{'bodyweights':>18s}{'N':>18s}{'% of cycle':>14s}")
    for part in result.parts:
        for measure, stretch in peak_windows(part).items():
            for run in result.runs:
                found = peaks(result.curves(run, part), result.phase, stretch)
                of_units = ((found.force / result.bodyweight, 2), (found.force, 0), (found.phase, 0))
                cells = [mean_and_deviation(spread(own), digits) for own, digits in of_units]
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
    lines += [textwrap.fill(sentence, 100) for sentence in undriven_sentences(result)]
    return "\n".join([*lines, *sentences(result)[1 + len(result.runs) :]])


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    contact = command("contact", run, "Say what joints bear, by one finished run or two.", writing)
    contact.add_argument("first", type=Path, metavar="RUN", help="from 'wrapjax calibrate', NGA or PGA")
    contact.add_argument("second", type=Path, nargs="?", metavar="RUN2", help="to compare it with")
    contact.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: RUN/contact)")
    contact.add_argument("--subject", type=Path, metavar="SUBJECT", help="if it is not where it was")
    contact.add_argument(
        "--undriven",
        choices=["static-optimization", "left"],
        default="static-optimization",
        help="muscles without an electrode: close the moments with least effort, or left without force",
    )
    contact.add_argument(
        "--condyle-distance",
        type=float,
        metavar="M",
        help="between the points where the condyles touch the tibia, m: divides the knee's force between its "
        "medial and its lateral side",
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
