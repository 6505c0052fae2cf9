"""``wrapjax initialise``."""

from __future__ import annotations

import argparse
from pathlib import Path

from wrapjax.commands.common import DONE, NOT_CONVERGED, AddCommand, print_json
from wrapjax.commands.settings import add_settings
from wrapjax.files import plain_values, refuse_existing
from wrapjax.jax_setup import set_up_jax


def add(command: AddCommand, writing: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    initialise = command(
        "initialise", run, "Find fiber and slack lengths to start from, by passive moments and walking."
    )
    initialise.add_argument(
        "subject", type=Path, metavar="SUBJECT", help="with [[passive]] trials, if it has any"
    )
    initialise.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    initialise.add_argument("--curves", choices=["paper", "opensim"], default="paper", help="Hill curves")
    add_settings(initialise)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    set_up_jax()
    from wrapjax.api import initialise, load_subject
    from wrapjax.api.calibrating.initialisation import PARAMETERS_FILE
    from wrapjax.api.tables.initialisation import initialisation_table

    refuse_existing(options.out, options.force)
    done = initialise(load_subject(options.subject), curves=options.curves)
    done.save(options.out, force=options.force)
    if options.json:
        print_json(plain_values(done.content()))
    else:
        print(initialisation_table(done.content()))
        print(
            f"\nwritten to {options.out}; look at its report.html, then copy {PARAMETERS_FILE} beside "
            f'subject.toml\nand name it there under [model]: muscle_parameters = "{PARAMETERS_FILE}"'
        )
    return DONE if done.status.converged else NOT_CONVERGED
