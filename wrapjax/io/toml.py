"""Values as TOML writes them, for whatever writes a subject's settings.

Reading TOML, whoever wrote it.

Reading a TOML table key by key, collecting everything wrong on the way.
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


def quoted(text: str) -> str:
    """Write a string."""
    # TOML's basic strings are JSON's.
    return json.dumps(text, ensure_ascii=False)


def quoted_list(names: Sequence[str]) -> str:
    """Write a list of strings."""
    return f"[{', '.join(map(quoted, names))}]"


#: Larger files are refused. Settings of a subject with a thousand cycles have about 100 kB.
MOST_BYTES = 16 << 20


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    InputError
        If there is no such file, or it is not TOML.
    """
    return parse_toml(read_toml_text(file), file)


def read_toml_text(file: Path) -> str:
    """Read the text of a TOML file.

    Raises
    ------
    InputError
        If there is no such file, or it is not text.
    """
    try:
        return read_content(file, "a TOML file of settings", most_bytes=MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(Problem(str(file), "is not text in UTF-8, where TOML was expected")) from None


def parse_toml(text: str, file: Path) -> dict[str, Any]:
    """Parse the text of a TOML file.

    Raises
    ------
    InputError
        If it is not TOML.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(Problem(str(file), "is not valid TOML (lists within lists without end)")) from None
    except ValueError as error:
        # Beside errors of syntax: whole numbers of thousands of digits.
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
def collecting(problems: list[Problem]) -> Iterator[None]:
    """Add the problems of an `InputError` to the list and go on after the block."""
    try:
        yield
    except InputError as error:
        problems.extend(error.problems)


def describe_value(value: Any) -> str:
    """Say what was found: the value if it is short, else its kind."""
    try:
        shown = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    except ValueError:  # a whole number of thousands of digits, which Python does not write out
        return "a number without end"
    return shown if len(shown) <= 40 else _TYPE_NAMES.get(type(value), type(value).__name__)


class TableReader:
    """Takes the known keys out of a TOML table; whatever is wrong or left over becomes a problem.

    Every method returns None where the key is absent or unfit, so that reading goes on and the next
    fault is found as well.

    Parameters
    ----------
    table
        The table, as `tomllib` gives it; None where it is missing, which has been reported and makes all
        its keys missing without another word.
    file
        The file, as the user knows it.
    place
        Name of the table, such as ``[subject]``.
    problems
        The list to add to.
    """

    def __init__(self, table: Any, file: Path, place: str, problems: list[Problem]):
        self.file = file
        self.place = place
        self.problems = problems
        if table is not None and not isinstance(table, dict):
            self.problem("", f"expected a table, found {describe_value(table)}")
            table = None
        self.silent = table is None
        self._table: dict[str, Any] = table or {}
        self._known: list[str] = []

    def problem(self, key: str, message: str, hint: str = "") -> None:
        """Report something wrong at a key of this table."""
        place = f"{self.place} {key}".strip()
        self.problems.append(Problem(str(self.file), message, place, hint))

    def has(self, key: str) -> bool:
        """Say whether the table holds the key."""
        return key in self._table

    def _take(self, key: str, required: bool, expected: str) -> Any:
        self._known.append(key)
        if key not in self._table:
            if required and not self.silent:
                self.problem(key, f"expected {expected}, found nothing")
            return None
        return self._table[key]

    def text(self, key: str, *, required: bool = True, choices: tuple[str, ...] = ()) -> str | None:
        """Take a text that is not empty, one of the choices where there are any."""
        expected = " or ".join(f"'{choice}'" for choice in choices) or "text"
        value = self._take(key, required, expected)
        if value is None:
            return None
        if not isinstance(value, str) or not value.strip() or (choices and value not in choices):
            hint = nearest_name(value, choices) if choices and isinstance(value, str) else ""
            hint = hint if hint.startswith("did") else ""
            self.problem(key, f"expected {expected}, found {describe_value(value)}", hint)
            return None
        return value

    def number(
        self, key: str, *, lowest: float, highest: float, unit: str, required: bool = True
    ) -> float | None:
        """Take a number within limits."""
        expected = f"a number from {lowest:g} to {highest:g} {unit}"
        value = self._take(key, required, expected)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not lowest <= value <= highest:
            self.problem(key, f"expected {expected}, found {describe_value(value)}")
            return None
        return float(value)

    def boolean(self, key: str) -> bool | None:
        """Take true or false; absent means unknown."""
        value = self._take(key, False, "true or false")
        if value is not None and not isinstance(value, bool):
            self.problem(key, f"expected true or false, found {describe_value(value)}")
            return None
        return value

    def names(self, key: str, *, required: bool = True) -> tuple[str, ...] | None:
        """Take a list of different names, at least one."""
        expected = "a list of names"
        value = self._take(key, required, expected)
        if value is None:
            return None
        if (
            not isinstance(value, list)
            or not value
            or not all(isinstance(name, str) and name for name in value)
        ):
            self.problem(key, f"expected {expected}, found {describe_value(value)}")
            return None
        twice = sorted({name for name in value if value.count(name) > 1})
        for name in twice:
            self.problem(key, f"'{name}' stands there more than once")
        return None if twice else tuple(value)

    def path(self, key: str, folder: Path, *, required: bool = True) -> Path | None:
        """Take a path inside the folder; absolute ones, and those that lead out, by links too, are refused.

        A folder from somebody else could otherwise have any file of this machine read, and parts of it told.
        """
        value = self.text(key, required=required)
        if value is None:
            return None
        windows = PureWindowsPath(value)
        parts = {*PurePosixPath(value).parts, *windows.parts}
        if PurePosixPath(value).is_absolute() or windows.drive or windows.root or ".." in parts:
            self.problem(key, f"expected a path inside the subject's folder, found '{value}'")
            return None
        path = folder / value
        try:
            outside = not path.resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError, ValueError):  # a loop of links, a zero byte
            self.problem(key, f"expected a path inside the subject's folder, found '{value}'")
            return None
        if outside:
            message = (
                f"expected a path inside the subject's folder, found the link '{value}' to {path.resolve()}"
            )
            self.problem(key, message, "copy the file into the folder")
            return None
        return path

    def table(self, key: str) -> Any:
        """Take what should be a table, for a reader of its own; None where it is absent."""
        return self._take(key, True, "a table")

    def tables(self, key: str) -> list[Any]:
        """Take a list of tables (``[[key]]``), empty where it is absent."""
        value = self._take(key, True, f"at least one table [[{key}]]")
        if value is None:
            return []
        if not isinstance(value, list):
            self.problem(key, f"expected tables [[{key}]], found {describe_value(value)}")
            return []
        return value

    def raw(self, key: str) -> Any:
        """Take a value of any kind, None where it is absent."""
        return self._take(key, False, "")

    def finish(self) -> None:
        """Report the keys that nobody took."""
        for key in self._table:
            if key not in self._known:
                self.problem(key, "is not a known key", nearest_name(key, self._known))
