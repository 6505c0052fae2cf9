"""Reading TOML, whoever wrote it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from wrapjax.errors import InputError, Problem
from wrapjax.subject.content import read_content

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
