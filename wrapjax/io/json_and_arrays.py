"""Results read back from files, which may be cut off, changed or made up: a `ValueError` at worst."""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

#: Larger files are not read: nothing that is written here comes near.
MOST_JSON_BYTES = 256 << 20
MOST_ARRAY_BYTES = 4 << 30
#: Longer whole numbers are no floating-point numbers, and calculating with them ends in errors.
MOST_DIGITS = 300


def load_json(file: Path) -> Any:
    """Read a JSON file (UTF-8).

    Raises
    ------
    ValueError
        If it is damaged, not JSON, or larger or deeper than anything that is written here.
    OSError
        If it cannot be opened.
    """
    if file.stat().st_size > MOST_JSON_BYTES:
        raise ValueError(f"more than {MOST_JSON_BYTES >> 20} MiB")
    try:
        return json.loads(file.read_text(encoding="utf-8"), parse_int=_whole_number)
    except RecursionError:
        raise ValueError("lists within lists without end") from None


def _whole_number(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a whole number of {len(text)} digits")
    return int(text)


def load_arrays(file: Path) -> dict[str, np.ndarray]:
    """Read all arrays of an ``.npz`` file: plain numbers and texts, never objects, which are code.

    Sizes are looked at before anything is read: of a small file, an array as large as its header says, or
    compressed zeros, could fill the memory.

    Raises
    ------
    ValueError
        If it is damaged, cut off, no such file, or holds objects.
    OSError
        If it cannot be opened.
    """
    # Opened by hand: what is no whole archive is otherwise left open.
    with file.open("rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                if sum(member.file_size for member in archive.infolist()) > MOST_ARRAY_BYTES:
                    raise ValueError(f"more than {MOST_ARRAY_BYTES >> 30} GiB of arrays")
                for member in archive.infolist():
                    _check_size(archive, member)
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as stored:
                return dict(stored)
        except ValueError:
            raise
        except Exception as error:
            # Headers of archives and of arrays can be wrong in ways that raise almost anything.
            raise ValueError(f"no whole archive of arrays: {error or type(error).__name__}") from error


def _check_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Raise an error unless a member is as large as its header says."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = read(stream)
        if math.prod(shape) * kind.itemsize != member.file_size - stream.tell():
            raise ValueError(f"{member.filename} does not have the size that it says")
