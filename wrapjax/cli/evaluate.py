"""Command ``wrapjax evaluate``, with the table of an evaluation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import DONE, NOT_CONVERGED, AddCommand, print_json
from wrapjax.cli.settings_file import add_settings
from wrapjax.io.files import check_output_folder, to_json_values
from wrapjax.jax_setup import set_up_jax


def evaluation_table(content: dict[str, Any]) -> str:
    """Tabulate moment errors by coordinate and use, and by cycle."""
    run = content["run"]
    columns = {use: errors for use, errors in content["mae_Nm"].items() if errors is not None}
    columns |= {f"run's {use}": errors for use, errors in run["mae_Nm"].items() if errors is not None}
    names = (*content["coordinates"], "mean")
    width = max(map(len, (*names, *content["trials"], "coordinate")))
    lines = [
        f"{content['subject']}, predicted by the {run['method']} calibration of {run['subject']}",
        "",
        "Mean absolute error of the joint moments, N m",
        f"{'coordinate':{width}s}" + "".join(f"{name:>20s}" for name in columns),
        *(
            f"{name:{width}s}" + "".join(f"{errors[name]:20.2f}" for errors in columns.values())
            for name in names
        ),
        "",
        f"{'cycle':{width}s}{'use':>20s}{'mean':>20s}",
        *(
            f"{name:{width}s}{cycle['use']:>20s}{cycle['mae_Nm']['mean']:20.2f}"
            for name, cycle in content["trials"].items()
        ),
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in content["notes"])])


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    evaluate = command(
        "evaluate",
        run,
        "Predict the joint moments of other recordings with a calibrated model, without fitting.",
    )
    evaluate.add_argument("calibration", type=Path, metavar="RUN", help="folder from 'wrapjax calibrate'")
    evaluate.add_argument(
        "subject",
        type=Path,
        metavar="SUBJECT",
        help="subject folder with the muscles and coordinates of the run",
    )
    evaluate.add_argument(
        "--out", type=Path, metavar="DIR", help="output folder for moments and a report (default: only print)"
    )
    add_settings(evaluate)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.evaluation.evaluation import evaluate
    from wrapjax.evaluation.stored_run import load_run
    from wrapjax.subject.subject import load_subject

    if options.out:
        check_output_folder(options.out, options.force)
    calibrated = load_run(options.calibration)
    done = evaluate(calibrated, load_subject(options.subject))
    content = done.summary()
    if options.out:
        done.save(options.out, force=options.force)
    if options.json:
        print_json(to_json_values(content))
    else:
        print(evaluation_table(content))
        if options.out:
            print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")
    return DONE if calibrated.converged else NOT_CONVERGED
