"""Reading of JSON and ``.npz`` files of results, with checks against damaged or manipulated files.

Every fault raises a `ValueError`. Writing is in `wrapjax.io.files` (`write_json`).
"""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

#: Largest sizes of files that are read, bytes; files that this package writes are far smaller.
MAX_JSON_BYTES = 256 << 20
MAX_ARRAY_BYTES = 4 << 30
#: Longest integer in a JSON file, digits; longer ones exceed the range of floating-point numbers.
MAX_DIGITS = 300


def load_json(file: Path) -> Any:
    """Read a JSON file (UTF-8).

    Raises
    ------
    ValueError
        If the file is damaged, not JSON, too large, too deeply nested or holds an integer of too many digits.
    OSError
        If the file cannot be opened.
    """
    if file.stat().st_size > MAX_JSON_BYTES:
        raise ValueError(f"more than {MAX_JSON_BYTES >> 20} MiB")
    try:
        return json.loads(file.read_text(encoding="utf-8"), parse_int=_parse_integer)
    except RecursionError:
        raise ValueError("too deeply nested lists") from None


def _parse_integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


def load_arrays(file: Path) -> dict[str, np.ndarray]:
    """Read all arrays of an ``.npz`` file; pickled objects are refused, as they can run code.

    Sizes are checked before anything is read: a small file may declare a huge array, or hold compressed
    zeros, and so fill the memory.

    Raises
    ------
    ValueError
        If the file is damaged, incomplete, not an ``.npz`` file, or holds objects.
    OSError
        If the file cannot be opened.
    """
    # `numpy.load` leaves the file open if it is not a complete archive, so that it is opened here.
    with file.open("rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                if sum(member.file_size for member in archive.infolist()) > MAX_ARRAY_BYTES:
                    raise ValueError(f"more than {MAX_ARRAY_BYTES >> 30} GiB of arrays")
                for member in archive.infolist():
                    _check_size(archive, member)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as stored:
                return dict(stored)
        except ValueError:
            raise
        except Exception as error:
            # Damaged headers of archives and arrays raise exceptions of many types.
            raise ValueError(f"not a complete archive of arrays: {error or type(error).__name__}") from error


def _check_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Raise an error unless the size of an array agrees with its header."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = read(stream)
        if math.prod(shape) * kind.itemsize != member.file_size - stream.tell():
            raise ValueError(f"the size of {member.filename} disagrees with its header")
