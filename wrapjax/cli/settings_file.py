"""Options of a command from a TOML file, and the settings file that a command writes into its output folder.

Keys are the long names of the options with underscores. Paths are relative to the file. Options on the
command line take precedence over the file.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text

#: Name of the file in an output folder.
FILE = "settings.toml"
# Options that concern a single run and not its result.
_NOT_SAVED = {
    "help",
    "settings",
    "out",
    "force",
    "resume",
    "quiet",
    "json",
    "threads",
    "workers",
    "scheduler",
}


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--settings``."""
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="FILE.toml",
        help="read options from a file, such as the settings.toml of an output folder; options on the "
        "command line take precedence",
    )


def apply_settings(parser: argparse.ArgumentParser, command: str, arguments: Sequence[str]) -> None:
    """Set the defaults of a command's options from the file of ``--settings``, if the option is given.

    Parameters
    ----------
    parser
        Parser of the command.
    command
        Name of the command; a file that another command wrote is refused.
    arguments
        Arguments of the command.

    Raises
    ------
    InputError
        If the file cannot be read, or contains an unknown option or an invalid value.
    """
    if not _takes_settings(parser):
        return
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    add_settings(finder)
    file = finder.parse_known_args(arguments)[0].settings
    if file is None:
        return
    from wrapjax.io.toml import read_toml

    known = {action.dest: action for action in _options(parser)}
    for key, value in read_toml(file).items():
        if key == "command":
            if value != command:
                raise InputError(Problem(str(file), f"is of 'wrapjax {value}', not of 'wrapjax {command}'"))
            continue
        if key not in known:
            hint = nearest_name(key, tuple(known))
            raise InputError(Problem(str(file), f"'wrapjax {command}' has no such option", key, hint=hint))
        action = known[key]
        action.default, action.required = _value(file, key, value, action), False


def save_settings(parser: argparse.ArgumentParser, command: str, options: argparse.Namespace) -> None:
    """Write the options of a command into its output folder, if it wrote one.

    Parameters
    ----------
    parser
        Parser of the command.
    command
        Name of the command.
    options
        Parsed options.
    """
    folder: Path | None = getattr(options, "out", None)
    if not _takes_settings(parser) or folder is None or not folder.is_dir():
        return
    from wrapjax.io.toml import toml_string

    lines = [
        f"# Options of 'wrapjax {command}'; repeat it with --settings {FILE}",
        f"command = {toml_string(command)}",
    ]
    for action in _options(parser):
        value = getattr(options, action.dest, None)
        if value is not None and value is not False and value != []:
            lines.append(f"{action.dest} = {_toml(value, folder)}")
    write_text(folder / FILE, "\n".join(lines) + "\n")


def _takes_settings(parser: argparse.ArgumentParser) -> bool:
    return "--settings" in parser._option_string_actions


def _options(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if action.option_strings and action.dest not in _NOT_SAVED:
            yield action


def _value(file: Path, key: str, value: Any, action: argparse.Action) -> Any:
    """Convert the value of an option as the command line would."""
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise InputError(Problem(str(file), f"expected true or false, found {value!r}", key))
        return value
    if action.nargs is not None:
        if not isinstance(value, list):
            raise InputError(Problem(str(file), f"expected a list, found {value!r}", key))
        return [_single(file, key, entry, action) for entry in value]
    return _single(file, key, value, action)


def _single(file: Path, key: str, value: Any, action: argparse.Action) -> Any:
    if isinstance(value, (bool, list, dict)):
        raise InputError(Problem(str(file), f"expected one value, found {value!r}", key))
    if action.type is Path:
        return file.parent / str(value)
    try:
        converted = action.type(str(value)) if callable(action.type) else str(value)
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise InputError(Problem(str(file), str(error), key)) from None
    if action.choices is not None and converted not in action.choices:
        listed = ", ".join(map(str, action.choices))
        raise InputError(Problem(str(file), f"expected one of {listed}, found {value!r}", key))
    return converted


def _toml(value: Any, folder: Path) -> str:
    """Format a value for TOML; paths become relative to the folder."""
    from wrapjax.io.toml import toml_string

    if isinstance(value, bool):
        return "true"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml(entry, folder) for entry in value)}]"
    if isinstance(value, Path):
        try:
            value = os.path.relpath(value.resolve(), folder.resolve())
        except ValueError:  # The folder is on another drive.
            value = value.resolve()
        return toml_string(Path(value).as_posix())
    return str(value) if isinstance(value, (int, float)) else toml_string(str(value))
