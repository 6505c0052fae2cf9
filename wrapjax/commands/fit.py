"""``wrapjax fit``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, AddCommand, add_drive, show
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    fit = command("fit", run, "Replace the subject's muscle paths by polynomials.", writing)
    fit.add_argument("subject", type=Path, metavar="SUBJECT")
    fit.add_argument("--out", type=Path, required=True, metavar="FIT")
    fit.add_argument(
        "--geometry",
        choices=["opensim", "engine", "engine-parity"],
        default="opensim",
        help="source of the paths: OpenSim, the exact engine (shortest paths), or it as OpenSim wraps",
    )
    fit.add_argument("--resume", action="store_true", help="go on with an interrupted fit (done in any case)")
    add_drive(fit)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import fit, fit_wraps, load_subject
    from wrapjax.api.calibrating.extrapolation import drive
    from wrapjax.api.tables.calibration import fit_table, wrap_table
    from wrapjax.progress import say

    refuse_existing(options.out, options.force)
    subject = drive(load_subject(options.subject), options.undriven, options.synergies)
    how = {"processes": options.threads, "quiet": options.quiet}
    result = fit_wraps(subject, fit(subject, options.geometry, seed=options.seed, **how), **how)
    say("drawing the report", quiet=options.quiet)
    result.save(options.out, subject=subject, force=options.force)

    def tables() -> str:
        wraps = result.wraps
        return fit_table(result) + (f"\n\n{wrap_table(wraps)}" if wraps and wraps.quality else "")

    show(options, "fit.json", tables)
    return DONE
