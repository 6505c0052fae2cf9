"""Options of a command in one TOML file: read before the command line, and kept beside what came of them.

Keys are the options' long names with underscores, paths are relative to the file. What the command line says
goes before what the file says.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import write_text

#: In the folder that a command writes.
FILE = "settings.toml"
# Of one call and not of what it is for.
_NOT_KEPT = {"help", "settings", "out", "force", "resume", "quiet", "json", "threads", "workers", "scheduler"}


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the file."""
    parser.add_argument(
        "--settings", type=Path, metavar="FILE.toml", help="options in a file, as RUN/settings.toml has them"
    )


def apply_settings(parser: argparse.ArgumentParser, command: str, arguments: Sequence[str]) -> None:
    """Take a command's defaults from the file that its arguments name, if they name one.

    Parameters
    ----------
    parser
        Of the command.
    command
        Its name: a file that was kept by another command is refused.
    arguments
        Those of the command.

    Raises
    ------
    InputError
        If the file cannot be read, or says something that is no option or no value of one.
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


def keep_settings(parser: argparse.ArgumentParser, command: str, options: argparse.Namespace) -> None:
    """Write what a command was asked for into the folder that it wrote, if it wrote one.

    Parameters
    ----------
    parser, command
        As of `apply_settings`.
    options
        As they were parsed.
    """
    folder: Path | None = getattr(options, "out", None)
    if not _takes_settings(parser) or folder is None or not folder.is_dir():
        return
    from wrapjax.io.toml import toml_string

    lines = [
        f"# What 'wrapjax {command}' was asked for: begin anew with --settings {FILE}",
        f"command = {toml_string(command)}",
    ]
    for action in _options(parser):
        value = getattr(options, action.dest, None)
        if value is not None and value is not False and value != []:
            lines.append(f"{action.dest} = {_written(value, folder)}")
    write_text(folder / FILE, "\n".join(lines) + "\n")


def _takes_settings(parser: argparse.ArgumentParser) -> bool:
    return "--settings" in parser._option_string_actions


def _options(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if action.option_strings and action.dest not in _NOT_KEPT:
            yield action


def _value(file: Path, key: str, value: Any, action: argparse.Action) -> Any:
    """Read a value as the command line would."""
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise InputError(Problem(str(file), f"expected true or false, found {value!r}", key))
        return value
    if action.nargs is not None:
        if not isinstance(value, list):
            raise InputError(Problem(str(file), f"expected a list, found {value!r}", key))
        return [_single(file, key, one, action) for one in value]
    return _single(file, key, value, action)


def _single(file: Path, key: str, value: Any, action: argparse.Action) -> Any:
    if isinstance(value, (bool, list, dict)):
        raise InputError(Problem(str(file), f"expected one value, found {value!r}", key))
    if action.type is Path:
        return file.parent / str(value)
    try:
        found = action.type(str(value)) if callable(action.type) else str(value)
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise InputError(Problem(str(file), str(error), key)) from None
    if action.choices is not None and found not in action.choices:
        listed = ", ".join(map(str, action.choices))
        raise InputError(Problem(str(file), f"expected one of {listed}, found {value!r}", key))
    return found


def _written(value: Any, folder: Path) -> str:
    from wrapjax.io.toml import toml_string

    if isinstance(value, bool):
        return "true"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_written(one, folder) for one in value)}]"
    if isinstance(value, Path):
        try:
            value = os.path.relpath(value.resolve(), folder.resolve())
        except ValueError:  # another drive
            value = value.resolve()
        return toml_string(Path(value).as_posix())
    return str(value) if isinstance(value, (int, float)) else toml_string(str(value))
