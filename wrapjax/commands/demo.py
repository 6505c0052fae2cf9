"""``wrapjax demo``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, print_json, stored, unfinished
from wrapjax.files import refuse_existing
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    demo = command("demo", run, "Calibrate a virtual subject of known truth by every method.", writing)
    demo.add_argument("--out", type=Path, default=Path("wrapjax-demo"), metavar="DIR")


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api.demonstration.demo import demo
    from wrapjax.api.tables.calibration import calibration_table, iteration_printer
    from wrapjax.api.tables.demonstration import recovery_table, wrap_recovery_table
    from wrapjax.api.tables.gap import gap_table

    journal = unfinished(options)
    begun = options.resume and journal.exists()
    refuse_existing(options.out, options.force or begun)
    shown = demo(
        options.out,
        seed=options.seed,
        force=options.force,
        journal=journal,
        resume=begun,
        quiet=options.quiet,
        callback=iteration_printer(quiet=options.quiet),
    )
    if options.json:
        print_json(stored(options.out / "demo.json"))
    else:
        for calibration in shown.calibrations.values():
            print(calibration_table(calibration))
            print()
        print(recovery_table(shown))
        print()
        print(wrap_recovery_table(shown))
        print(f"\nhidden in another person: {shown.gap.hidden}; a diagnosis (unit test, no accuracy) says:\n")
        print(gap_table(shown.gap.diagnosis.result))
        print(f"\nwritten to {options.out}; open {options.out / 'PGA' / 'report.html'} in a browser")
    return DONE if shown.converged else NOT_CONVERGED
