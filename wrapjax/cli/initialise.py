"""Command ``wrapjax initialise``, with the table of initial fiber and tendon slack lengths."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from wrapjax.cli.common import CURVES_HELP, DONE, NOT_CONVERGED, AddCommand, print_json
from wrapjax.cli.settings_file import add_settings
from wrapjax.io.files import check_output_folder, to_json_values
from wrapjax.jax_setup import set_up_jax


def initialisation_table(content: dict[str, Any]) -> str:
    """Tabulate lengths before and after, and the errors of passive moments."""
    width = max(map(len, (*content["muscles"], "coordinate")))
    lines = [f"{content['subject']}: {content['message']}", ""]
    if content["passive_mae_Nm"]:
        lines += [
            "Mean absolute error of passive moments, N m",
            f"{'coordinate':{width}s}{'before':>12s}{'after':>12s}",
        ]
        lines += [
            f"{name:{width}s}{errors['before']:12.2f}{errors['after']:12.2f}"
            for name, errors in content["passive_mae_Nm"].items()
        ]
        lines.append("")
    lines += [
        "Fiber and tendon slack lengths, mm (before, after), and normalised fiber lengths in walking (after)",
        f"{'muscle':{width}s}{'fiber':>16s}{'slack':>18s}{'range':>16s}",
    ]
    for muscle, values in content["muscles"].items():
        pairs = [
            f"{1e3 * values[name]['before']:8.1f}{1e3 * values[name]['after']:8.1f}"
            for name in ("optimal_fiber_length_m", "tendon_slack_length_m")
        ]
        low, high = values["normalized_fiber_length"]["after"]
        lines.append(f"{muscle:{width}s}{pairs[0]}  {pairs[1]}{low:9.2f} to {high:.2f}")
    return "\n".join([*lines, *(f"note: {note}" for note in content["notes"])])


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    initialise = command(
        "initialise", run, "Estimate initial fiber and tendon slack lengths from passive moments and walking."
    )
    initialise.add_argument(
        "subject",
        type=Path,
        metavar="SUBJECT",
        help="subject folder; its [[passive]] trials are used, if it has any",
    )
    initialise.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="output folder")
    initialise.add_argument("--curves", choices=["paper", "opensim"], default="paper", help=CURVES_HELP)
    add_settings(initialise)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.calibration.initialisation import PARAMETERS_FILE, initialise
    from wrapjax.subject.subject import load_subject

    check_output_folder(options.out, options.force)
    done = initialise(load_subject(options.subject), curves=options.curves)
    done.save(options.out, force=options.force)
    if options.json:
        print_json(to_json_values(done.summary()))
    else:
        print(initialisation_table(done.summary()))
        print(
            f"\nwritten to {options.out}; look at its report.html, then copy {PARAMETERS_FILE} beside "
            f'subject.toml\nand name it there under [model]: muscle_parameters = "{PARAMETERS_FILE}"'
        )
    return DONE if done.status.converged else NOT_CONVERGED
