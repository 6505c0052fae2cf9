"""Opening an input file, so that every reader answers the same faults in the same words."""

from __future__ import annotations

from pathlib import Path

from wrapjax.errors import InputError, Problem, nearest_name


def read_content(path: Path, expected: str, line_limit: int | None = None) -> bytes:
    """Read a file, or its first lines.

    Parameters
    ----------
    path
        The file.
    expected
        What it should be, such as ``XML``, for the message.
    line_limit
        Lines to read; all by default.

    Raises
    ------
    InputError
        If there is no such file, it cannot be read, or it is empty.
    """
    try:
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
        raise InputError(Problem(str(path), f"cannot be read ({error})")) from None
    if not content.strip():
        raise InputError(Problem(str(path), f"is empty, where {expected} was expected"))
    return content


def _nearest_file(path: Path) -> str:
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist either"
    siblings = tuple(sorted(entry.name for entry in path.parent.iterdir() if entry.is_file()))
    return nearest_name(path.name, siblings) if siblings else "its folder is empty"
