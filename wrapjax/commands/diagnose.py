"""``wrapjax diagnose``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, positive, show
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax


class ListEffects(argparse.Action):
    """Print the catalogue's effects and end, as ``--version`` does: no subject is needed."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None):
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print one line an effect, with its id as files and ``--without`` have it."""
        from wrapjax.api import effect_meanings

        print("\n".join(f"{id}: {meaning}." for id, meaning in effect_meanings().items()))
        parser.exit(DONE)


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    diagnose = command(
        "diagnose", run, "Say where the remaining error is and what explains it best.", writing
    )
    diagnose.add_argument(
        "--list", action=ListEffects, help="show the effects that a diagnosis looks for, and end"
    )
    diagnose.add_argument("subject", type=Path, metavar="SUBJECT")
    diagnose.add_argument("--out", type=Path, required=True, metavar="GAP")
    diagnose.add_argument(
        "--method",
        choices=["NGA", "SGA", "LSGA", "PGA"],
        default="NGA",
        help="of the calibration before it (default: NGA)",
    )
    diagnose.add_argument(
        "--without",
        action="extend",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="leave these out of the catalogue; the calibration is not done again",
    )
    diagnose.add_argument(
        "--fit", type=Path, metavar="FIT", help="from 'wrapjax fit' (default: made and cached)"
    )
    diagnose.add_argument(
        "--starts", type=positive, default=4, metavar="N", help="of the calibration, as in 'calibrate'"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import diagnose, load_fit, load_subject
    from wrapjax.api.calibrating.problem import source_for
    from wrapjax.api.diagnosing.diagnosis import refuse_unknown
    from wrapjax.api.tables.calibration import iteration_printer
    from wrapjax.api.tables.gap import gap_table
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    refuse_unknown(options.without)
    subject = load_subject(options.subject)
    if options.fit:
        paths = load_fit(options.fit, subject)
    else:
        paths = source_for(
            (options.method,), subject, seed=options.seed, processes=options.threads, quiet=options.quiet
        )
    done = diagnose(
        subject,
        options.method,
        paths,
        without=options.without,
        starts=options.starts,
        seed=options.seed,
        callback=iteration_printer(quiet=options.quiet),
        tell=lambda line: say(line, quiet=options.quiet),
    )
    done.save(options.out, force=options.force)
    show(options, "gap.json", lambda: gap_table(done.result))
    return NOT_CONVERGED if done.result.outcome in ("insufficient_data", "not_converged") else DONE
