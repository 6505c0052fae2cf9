"""Opening an input file, so that every reader answers the same faults in the same words."""

from __future__ import annotations

import stat
from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name

#: Larger files are refused unless a reader says otherwise. An hour of 20 channels at 1 kHz has 0.8 GB.
MOST_BYTES = 2 << 30


def read_content(
    path: Path, expected: str, line_limit: int | None = None, most_bytes: int = MOST_BYTES
) -> bytes:
    """Read a file, or its first lines.

    Parameters
    ----------
    path
        The file.
    expected
        What it should be, such as ``XML``, for the message.
    line_limit
        Lines to read; all by default.
    most_bytes
        A larger file is refused.

    Raises
    ------
    InputError
        If there is no such file, it cannot be read, is empty or too large, or is a device or a pipe, which
        might have no end.
    """
    try:
        found = path.stat()
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            raise InputError(Problem(str(path), f"is a device or a pipe, where {expected} was expected"))
        if line_limit is None and found.st_size > most_bytes:
            message = f"has {found.st_size >> 20} MiB, where {expected} of at most {most_bytes >> 20} MiB"
            raise InputError(Problem(str(path), f"{message} was expected"))
        if line_limit is None:
            content = path.read_bytes()
        else:
            with path.open("rb") as stream:
                # A binary file may be a single line without end.
                content = b"".join(stream.readline(1 << 20) for _ in range(line_limit))
    except FileNotFoundError:
        raise InputError(Problem(str(path), "does not exist", hint=_nearest_file(path))) from None
    except IsADirectoryError:
        raise InputError(Problem(str(path), f"is a folder, where {expected} was expected")) from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(Problem(str(path), f"cannot be read ({reason})")) from None
    if not content.strip():
        raise InputError(Problem(str(path), f"is empty, where {expected} was expected"))
    return content


def _nearest_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist either"
    siblings = tuple(sorted(entry.name for entry in path.parent.iterdir() if entry.is_file()))
    return nearest_name(path.name, siblings) if siblings else "its folder is empty"
