"""TOML files: writing of strings, reading, and checking of the keys and values of tables.

`TableReader` takes the known keys of a table one by one and collects all faults, so that the user sees them
at once.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content


def toml_string(text: str) -> str:
    """Format a string as TOML."""
    # TOML's basic strings have the syntax of JSON's.
    return json.dumps(text, ensure_ascii=False)


def toml_list(names: Sequence[str]) -> str:
    """Format a list of strings as TOML."""
    return f"[{', '.join(map(toml_string, names))}]"


#: Largest TOML file, bytes. Settings of a subject with a thousand cycles have about 100 kB.
MAX_BYTES = 16 << 20


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    InputError
        If the file cannot be read or is not valid TOML.
    """
    return parse_toml(read_toml_text(file), file)


def read_toml_text(file: Path) -> str:
    """Read the text of a TOML file.

    Raises
    ------
    InputError
        If the file cannot be read or is not text in UTF-8.
    """
    try:
        return read_content(file, "a TOML file of settings", max_bytes=MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(Problem(str(file), "is not text in UTF-8, where TOML was expected")) from None


def parse_toml(text: str, file: Path) -> dict[str, Any]:
    """Parse the text of a TOML file.

    Raises
    ------
    InputError
        If the text is not valid TOML.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(Problem(str(file), "is not valid TOML (too deeply nested lists)")) from None
    except ValueError as error:
        # Errors of syntax, and integers of thousands of digits.
        raise InputError(Problem(str(file), f"is not valid TOML ({error})")) from None


_TYPE_NAMES = {
    bool: "true or false",
    str: "text",
    int: "a number",
    float: "a number",
    list: "a list",
    dict: "a table",
}


@contextmanager
def collect_problems(problems: list[Problem]) -> Iterator[None]:
    """Catch an `InputError` raised in the block and add its problems to the list."""
    try:
        yield
    except InputError as error:
        problems.extend(error.problems)


def describe_value(value: Any) -> str:
    """Describe a value for an error message: the value itself if it is short, else its type."""
    try:
        shown = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    except ValueError:  # an integer of thousands of digits, which Python does not convert to text
        return "a number of too many digits"
    return shown if len(shown) <= 40 else _TYPE_NAMES.get(type(value), type(value).__name__)


class TableReader:
    """Reader of the known keys of a TOML table; faults and unknown keys are added to a list of problems.

    Every method that reads a key returns None where the key is missing or its value is invalid, so that
    reading continues and later faults are found as well.

    Parameters
    ----------
    table
        Table, as returned by `tomllib`; None where it is missing, which has been reported already, so that
        its missing keys are not reported again.
    file
        File, for error messages.
    place
        Name of the table for error messages, such as ``[subject]``.
    problems
        List to which problems are added.
    """

    def __init__(self, table: Any, file: Path, place: str, problems: list[Problem]):
        self.file = file
        self.place = place
        self.problems = problems
        if table is not None and not isinstance(table, dict):
            self.add_problem("", f"expected a table, found {describe_value(table)}")
            table = None
        self.silent = table is None
        self._table: dict[str, Any] = table or {}
        self._known: list[str] = []

    def add_problem(self, key: str, message: str, hint: str = "") -> None:
        """Add a problem with a key of this table to the list."""
        place = f"{self.place} {key}".strip()
        self.problems.append(Problem(str(self.file), message, place, hint))

    def has(self, key: str) -> bool:
        """Return whether the table has the key."""
        return key in self._table

    def _take(self, key: str, required: bool, expected: str, hint: str = "") -> Any:
        self._known.append(key)
        if key not in self._table:
            if required and not self.silent:
                self.add_problem(key, f"expected {expected}, found nothing", hint)
            return None
        return self._table[key]

    def text(
        self, key: str, *, required: bool = True, choices: tuple[str, ...] = (), if_missing: str = ""
    ) -> str | None:
        """Read a text that is not empty; if there are choices, one of them.

        ``if_missing`` is a hint for where there is none and one is required.
        """
        expected = " or ".join(f"'{choice}'" for choice in choices) or "text"
        value = self._take(key, required, expected, if_missing)
        if value is None:
            return None
        if not isinstance(value, str) or not value.strip() or (choices and value not in choices):
            hint = nearest_name(value, choices) if choices and isinstance(value, str) else ""
            hint = hint if hint.startswith("did") else ""
            self.add_problem(key, f"expected {expected}, found {describe_value(value)}", hint)
            return None
        return value

    def number(
        self, key: str, *, lowest: float, highest: float, unit: str, required: bool = True
    ) -> float | None:
        """Read a number from ``lowest`` to ``highest`` (both included)."""
        expected = f"a number from {lowest:g} to {highest:g} {unit}"
        value = self._take(key, required, expected)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not lowest <= value <= highest:
            self.add_problem(key, f"expected {expected}, found {describe_value(value)}")
            return None
        return float(value)

    def boolean(self, key: str) -> bool | None:
        """Read true or false; None if the key is missing."""
        value = self._take(key, False, "true or false")
        if value is not None and not isinstance(value, bool):
            self.add_problem(key, f"expected true or false, found {describe_value(value)}")
            return None
        return value

    def names(self, key: str, *, required: bool = True) -> tuple[str, ...] | None:
        """Read a list of at least one name, without duplicates."""
        expected = "a list of names"
        value = self._take(key, required, expected)
        if value is None:
            return None
        if (
            not isinstance(value, list)
            or not value
            or not all(isinstance(name, str) and name for name in value)
        ):
            self.add_problem(key, f"expected {expected}, found {describe_value(value)}")
            return None
        duplicates = sorted({name for name in value if value.count(name) > 1})
        for name in duplicates:
            self.add_problem(key, f"'{name}' is listed more than once")
        return None if duplicates else tuple(value)

    def path(self, key: str, folder: Path, *, required: bool = True) -> Path | None:
        """Read a path inside a folder; absolute paths, and paths or links that lead out of it, are refused.

        Otherwise a folder received from others could cause any file of this computer to be read and quoted in
        error messages.
        """
        value = self.text(key, required=required)
        return None if value is None else self._inside(key, value, folder)

    def paths(self, key: str, folder: Path) -> tuple[Path, ...]:
        """Read a list of paths inside a folder, see `path`; empty if the key is missing."""
        values = self.names(key, required=False) or ()
        found = [self._inside(key, value, folder) for value in values]
        return tuple(path for path in found if path is not None)

    def _inside(self, key: str, value: str, folder: Path) -> Path | None:
        """Return the path inside the folder; report one that leads out of it."""
        windows = PureWindowsPath(value)
        parts = {*PurePosixPath(value).parts, *windows.parts}
        if PurePosixPath(value).is_absolute() or windows.drive or windows.root or ".." in parts:
            self.add_problem(key, f"expected a path inside the subject's folder, found '{value}'")
            return None
        path = folder / value
        try:
            outside = not path.resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError, ValueError):  # a loop of links, a zero byte
            self.add_problem(key, f"expected a path inside the subject's folder, found '{value}'")
            return None
        if outside:
            message = (
                f"expected a path inside the subject's folder, found the link '{value}' to {path.resolve()}"
            )
            self.add_problem(key, message, "copy the file into the folder")
            return None
        return path

    def table(self, key: str) -> Any:
        """Read a value that should be a table, for a `TableReader` of its own; None if the key is missing."""
        return self._take(key, True, "a table")

    def tables(self, key: str) -> list[Any]:
        """Read a list of tables (``[[key]]``); empty if the key is missing."""
        value = self._take(key, True, f"at least one table [[{key}]]")
        if value is None:
            return []
        if not isinstance(value, list):
            self.add_problem(key, f"expected tables [[{key}]], found {describe_value(value)}")
            return []
        return value

    def raw(self, key: str) -> Any:
        """Read a value of any type; None if the key is missing."""
        return self._take(key, False, "")

    def report_unknown_keys(self) -> None:
        """Add a problem for every key of the table that was not read."""
        for key in self._table:
            if key not in self._known:
                self.add_problem(key, "is not a known key", nearest_name(key, self._known))
