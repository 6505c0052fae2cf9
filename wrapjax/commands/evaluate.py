"""``wrapjax evaluate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, print_json
from wrapjax.commands.settings import add_settings
from wrapjax.files import plain_values, refuse_existing
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    evaluate = command("evaluate", run, "Predict other cycles by a finished calibration.")
    evaluate.add_argument("calibration", type=Path, metavar="RUN", help="from 'wrapjax calibrate'")
    evaluate.add_argument("subject", type=Path, metavar="SUBJECT", help="with the run's muscles")
    evaluate.add_argument("--out", type=Path, metavar="DIR", help="write moments and a report, too")
    add_settings(evaluate)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import evaluate, load_run, load_subject
    from wrapjax.api.tables.evaluation import evaluation_table

    if options.out:
        refuse_existing(options.out, options.force)
    calibrated = load_run(options.calibration)
    done = evaluate(calibrated, load_subject(options.subject))
    content = done.content()
    if options.out:
        done.save(options.out, force=options.force)
    if options.json:
        print_json(plain_values(content))
    else:
        print(evaluation_table(content))
        if options.out:
            print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if calibrated.converged else NOT_CONVERGED
