"""What all commands share: exit statuses, what is refused, what is printed."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem

DONE, NOT_CONVERGED, BAD_INPUT = 0, 1, 2

#: Adds a command by its name, what runs it, a sentence, and the options that it shares with others.
AddCommand = Callable[..., argparse.ArgumentParser]


def positive_integer(text: str) -> int:
    """Read a whole number above 0 off the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, found '{text}'")
    return number


def positive_number(text: str) -> float:
    """Read a number above 0 off the command line."""
    number = float(text)
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, found '{text}'")
    return number


def read_json(file: Path) -> Any:
    """Read a JSON file."""
    return json.loads(file.read_text(encoding="utf-8"))


def print_json(content: Any) -> None:
    """Print a result as JSON."""
    print(json.dumps(content, indent=1))


def add_undriven_options(parser: argparse.ArgumentParser) -> None:
    """Add what drives muscles without an electrode."""
    parser.add_argument(
        "--undriven",
        choices=["left", "synergies"],
        default="left",
        help="muscles without an electrode: left without force (default), or driven by synergies of the "
        "measured EMG whose weights are calibrated",
    )
    parser.add_argument(
        "--synergies",
        type=positive_integer,
        default=5,
        metavar="K",
        help="how many, with --undriven synergies",
    )


def print_result(options: argparse.Namespace, file: str, table: Callable[[], str]) -> None:
    """Print what was written: the file of numbers, or a table and where the report is."""
    if options.json:
        print_json(read_json(options.out / file))
    else:
        print(table())
        print(f"\nwritten to {options.out}; open {options.out / 'report.html'} in a browser")


def checkpoint_folder(options: argparse.Namespace) -> Path:
    """Name the folder of unfinished work, which is not thrown away unasked."""
    checkpoints = options.out.with_name(f".{options.out.name}.unfinished")
    if checkpoints.exists() and not (options.resume or options.force):
        raise InputError(
            Problem(
                str(options.out),
                "was begun and interrupted",
                hint="go on with --resume, or begin anew with --force",
            )
        )
    return checkpoints
