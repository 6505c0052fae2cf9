"""``wrapjax evaluate``.

A finished calibration on other cycles, for a terminal.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, print_json
from wrapjax.cli.settings import add_settings
from wrapjax.io.files import check_output_folder, to_json_values
from wrapjax.jax_setup import set_up_jax


def evaluation_table(content: dict[str, Any]) -> str:
    """Show errors by coordinate and use, and cycle by cycle."""
    run = content["run"]
    columns = {use: own for use, own in content["mae_Nm"].items() if own is not None}
    columns |= {f"run's {use}": own for use, own in run["mae_Nm"].items() if own is not None}
    names = (*content["coordinates"], "mean")
    width = max(map(len, (*names, *content["trials"], "coordinate")))
    lines = [
        f"{content['subject']}, predicted by the {run['method']} calibration of {run['subject']}",
        "",
        "Mean absolute error of the joint moments, N m",
        f"{'coordinate':{width}s}" + "".join(f"{name:>20s}" for name in columns),
        *(f"{name:{width}s}" + "".join(f"{own[name]:20.2f}" for own in columns.values()) for name in names),
        "",
        f"{'cycle':{width}s}{'use':>20s}{'mean':>20s}",
        *(
            f"{name:{width}s}{own['use']:>20s}{own['mae_Nm']['mean']:20.2f}"
            for name, own in content["trials"].items()
        ),
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in content["notes"])])


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
    from wrapjax.evaluation.evaluation import evaluate
    from wrapjax.evaluation.stored_run import load_run
    from wrapjax.subject.subject import load_subject as load_subject

    if options.out:
        check_output_folder(options.out, options.force)
    calibrated = load_run(options.calibration)
    done = evaluate(calibrated, load_subject(options.subject))
    content = done.content()
    if options.out:
        done.save(options.out, force=options.force)
    if options.json:
        print_json(to_json_values(content))
    else:
        print(evaluation_table(content))
        if options.out:
            print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if calibrated.converged else NOT_CONVERGED
