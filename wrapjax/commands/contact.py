"""``wrapjax contact``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, show
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax


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
    from wrapjax.api import contact
    from wrapjax.api.tables.contact import contact_table
    from wrapjax.progress import say

    options.out = options.out or options.first / "contact"
    refuse_existing(options.out, options.force)
    done = contact(
        options.first,
        options.second,
        subject=options.subject,
        undriven=options.undriven,
        condyle_distance=options.condyle_distance,
        tell=lambda line: say(line, quiet=options.quiet),
    )
    done.save(options.out, force=options.force)
    show(options, "contact.json", lambda: contact_table(done))
    return DONE if done.converged else NOT_CONVERGED
