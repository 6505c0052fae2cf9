"""Command ``wrapjax protocol``: the trials that would tell most."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from wrapjax.cli.common import DONE, AddCommand, add_effect_options, print_json
from wrapjax.io.files import check_output_folder
from wrapjax.jax_setup import set_up_jax

if TYPE_CHECKING:
    from wrapjax.diagnosis.protocol.protocol import Protocol

_WIDTH = 100


def protocol_table(protocol: Protocol) -> str:
    """Format the advised trials, what each adds, and what it tells apart."""
    from wrapjax.report.diagnosis.protocol_page import protocol_findings

    lines = [textwrap.fill(sentence, _WIDTH) for sentence in protocol_findings(protocol)]
    for number, one in enumerate(protocol.advised, start=1):
        lines += ["", f"{number}. {one.trial.what} ({one.trial.task}, {one.trial.minutes} min)"]
        lines.append(f"   {one.conditions}")
        lines.append(
            f"   adds {one.information:.2f} nats; expected evidence of an undecided effect "
            f"{one.expected_evidence:.1f} nats"
        )
        if one.splits:
            pairs = ", ".join(f"{first} / {second}" for first, second in one.splits[:4])
            more = f" and {len(one.splits) - 4} more" if len(one.splits) > 4 else ""
            lines.append(
                textwrap.fill(
                    f"tells apart {pairs}{more}", _WIDTH, initial_indent="   ", subsequent_indent="   "
                )
            )
    width = max(len(id) for id in protocol.effects) + 2
    lines += ["", f"{'effect':{width}s}{'d before':>10s}{'d after':>10s}"]
    for id, before, after in zip(
        protocol.effects, protocol.before.detectability, protocol.after.detectability, strict=True
    ):
        lines.append(f"{id:{width}s}{before:10.1f}{after:10.1f}")
    return "\n".join(lines)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    protocol = command(
        "protocol",
        run,
        "Find the trials that would tell most about what a model lacks: task, posture, effort and minutes.",
        writing,
    )
    protocol.add_argument(
        "place",
        type=Path,
        metavar="SUBJECT|MODEL|GAP",
        help="subject folder, with all its tasks; OpenSim model (.osim), with an electrode on every group of "
        "muscles; or folder from 'diagnose', whose undecided effects are to be distinguished",
    )
    protocol.add_argument("--out", type=Path, metavar="DIR", help="also write protocol.json and report.html")
    protocol.add_argument(
        "--side", choices=["l", "r"], default="r", help="leg of a model without recordings (default: r)"
    )
    add_effect_options(protocol)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.cli.calibrate import iteration_printer
    from wrapjax.diagnosis.protocol.protocol import protocol, subject_and_probabilities
    from wrapjax.path_sources.polynomial_fit import load_fit
    from wrapjax.progress import print_progress
    from wrapjax.report.diagnosis.protocol_page import describe_protocol

    if options.out is not None:
        check_output_folder(options.out, options.force)
    subject, probabilities = subject_and_probabilities(options.place, options.side)
    done = protocol(
        subject,
        options.method,
        load_fit(options.fit, subject) if options.fit else None,
        probabilities=probabilities,
        without=options.without,
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        log=lambda line: print_progress(line, quiet=options.quiet),
    )
    if options.out is not None:
        done.save(options.out, force=options.force)
    if options.json:
        print_json(describe_protocol(done))
        return DONE
    print(protocol_table(done))
    if options.out is not None:
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE
