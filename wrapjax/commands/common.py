"""What all commands share: exit statuses, what is refused, what is printed."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem

DONE, NOT_CONVERGED, BAD_INPUT = 0, 1, 2

#: Adds a command by its name, what runs it, a sentence, and the options that it shares with others.
AddCommand = Callable[..., argparse.ArgumentParser]


def refuse_existing(folder: Path, force: bool) -> None:
    """Say at once, not after the work, that a folder would be overwritten or cannot be made."""
    if folder.exists() and not force:
        raise InputError(
            Problem(str(folder), "exists already and is not overwritten", hint="use --force to replace it")
        )
    if folder.is_file():
        raise InputError(Problem(str(folder), "is a file, where a folder was expected"))
    parent = next(place for place in folder.absolute().parents if place.exists())
    if not parent.is_dir():
        raise InputError(Problem(str(folder), "cannot be created", hint=f"{parent} is a file"))
    if not os.access(parent, os.W_OK):
        raise InputError(Problem(str(folder), "cannot be created", hint=f"{parent} is not writable"))


def positive(text: str) -> int:
    """Read a whole number above 0 off the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, found '{text}'")
    return number


def stored(file: Path) -> Any:
    """Read a JSON file."""
    return json.loads(file.read_text(encoding="utf-8"))


def print_json(content: Any) -> None:
    """Print a result as JSON."""
    print(json.dumps(content, indent=1))
