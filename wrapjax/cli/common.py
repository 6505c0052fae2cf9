"""Functions that several commands share: exit statuses, option types, shared options and output."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem

#: Exit statuses: finished and converged; not converged, interrupted or failed; invalid input or usage.
DONE, NOT_CONVERGED, BAD_INPUT = 0, 1, 2

#: Text after an interruption that ``--resume`` can continue.
INTERRUPTED = "interrupted; continue with --resume"

#: Descriptions of the methods of calibration.
METHODS_HELP = (
    "NGA, muscle parameters; SGA, also the polynomial paths of all muscles; LSGA, also the paths of the "
    "muscles that touch a wrapping surface; PGA, also the wrapping surfaces"
)
#: Description of the choices of Hill curves.
CURVES_HELP = "Hill curves: paper, as published with the method; opensim, their later refit (default: paper)"

#: Function that adds a command: takes its name, the function that runs it, its description and parent
#: parsers.
AddCommand = Callable[..., argparse.ArgumentParser]


def positive_integer(text: str) -> int:
    """Convert a command-line argument to a whole number above 0."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, found '{text}'")
    return number


def positive_number(text: str) -> float:
    """Convert a command-line argument to a finite number above 0."""
    number = float(text)
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, found '{text}'")
    return number


def read_json(file: Path) -> Any:
    """Read a JSON file."""
    return json.loads(file.read_text(encoding="utf-8"))


def print_json(content: Any) -> None:
    """Print a result as JSON to standard output."""
    print(json.dumps(content, indent=1))


def add_undriven_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that set the excitation of muscles without an electrode."""
    parser.add_argument(
        "--undriven",
        choices=["left", "synergies"],
        default="left",
        help="muscles without an electrode: left, they have no force (default); synergies, they are driven "
        "by synergies of the measured EMG, with calibrated weights",
    )
    parser.add_argument(
        "--synergies",
        type=positive_integer,
        default=5,
        metavar="K",
        help="number of synergies, with --undriven synergies (default: 5)",
    )


def add_effect_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that calibrates a subject before it compares effects."""
    parser.add_argument(
        "--method",
        choices=["NGA", "SGA", "LSGA", "PGA"],
        default="NGA",
        help=f"method of the preceding calibration: {METHODS_HELP} (default: NGA)",
    )
    parser.add_argument(
        "--without",
        action="extend",
        nargs="+",
        default=[],
        metavar="EFFECT",
        help="identifiers of effects to leave out of the catalogue; a cached calibration is used again",
    )
    parser.add_argument(
        "--fit",
        type=Path,
        metavar="FIT",
        help="folder of polynomial muscle paths from 'wrapjax fit' (default: fitted now and cached)",
    )
    parser.add_argument(
        "--starts",
        type=positive_integer,
        default=4,
        metavar="N",
        help="number of starting points of the calibration (default: 4)",
    )


def print_result(options: argparse.Namespace, file: str, table: Callable[[], str]) -> None:
    """Print a result that has been written: its JSON file with ``--json``, else a table and the folder."""
    if options.json:
        print_json(read_json(options.out / file))
    else:
        print(table())
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")


def checkpoint_folder(options: argparse.Namespace) -> Path:
    """Return the folder of a command's checkpoints.

    Raises
    ------
    InputError
        If checkpoints of an interrupted computation exist, and neither ``--resume`` nor ``--force`` is given.
    """
    checkpoints = options.out.with_name(f".{options.out.name}.unfinished")
    if checkpoints.exists() and not (options.resume or options.force):
        raise InputError(
            Problem(
                str(options.out),
                "was begun and interrupted",
                hint="continue with --resume, or start again with --force",
            )
        )
    return checkpoints
