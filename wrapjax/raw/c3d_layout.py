"""Whether a ``.c3d`` file is laid out as one, looked at before ezc3d reads it, which trusts what it finds.

A single wrong byte can send it through counts and sizes that no file has, for minutes and gigabytes. The
layout is that of the C3D User Guide (https://www.c3d.org/docs/C3D_User_Guide.pdf): blocks of 512 bytes; a
header; parameters, each with the way to the next; frames.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

from wrapjax.errors import InputError, Problem

_BLOCK = 512
_KEY = 0x50
_MOST_DIMENSIONS = 7
#: What the fourth byte of the parameters says of the order of bytes: Intel, DEC and MIPS.
_ORDERS = {84: "<", 85: "<", 86: ">"}


def check_layout(content: bytes, path: Path) -> None:
    """Raise an error unless header and parameters hold together and the frames are there.

    Raises
    ------
    InputError
        If the file is no C3D file, is cut off, or a parameter leads nowhere.
    """
    try:
        _check(content)
    except (ValueError, struct.error, IndexError) as error:
        raise InputError(Problem(str(path), f"cannot be read as a C3D file ({error})")) from None


def _check(content: bytes) -> None:
    if len(content) < 2 * _BLOCK or content[1] != _KEY or content[0] < 2:
        raise ValueError("its first bytes are not those of one")
    start = (content[0] - 1) * _BLOCK
    blocks, kind = content[start + 2], content[start + 3]
    if kind not in _ORDERS:
        raise ValueError(f"expected 84, 85 or 86 as the kind of processor, found {kind}")
    order = _ORDERS[kind]
    points, analog, first, last = struct.unpack_from(f"{order}4H", content, 2)
    data_block, samples = struct.unpack_from(f"{order}2H", content, 16)
    _check_parameters(content[start : start + max(blocks, 1) * _BLOCK], order)
    # Integers of 2 bytes at least. Recordings beyond 65,535 frames say their length elsewhere, and have more.
    least = 2 * (4 * points + analog) * max(last - first + 1, 0)
    found = len(content) - (data_block - 1) * _BLOCK
    if data_block < 2 or least > found or (analog and analog % max(samples, 1)):
        raise ValueError(f"its header promises {least} bytes of frames or more, found {max(found, 0)}")


def _check_parameters(section: bytes, order: str) -> None:
    """Go from parameter to parameter: each lies within the section, and its values within it."""
    at = 4
    while at < len(section) and section[at] != 0:
        length, group = (
            abs(struct.unpack_from("b", section, at)[0]),
            struct.unpack_from("b", section, at + 1)[0],
        )
        name = section[at + 2 : at + 2 + length]
        here = at + 2 + length
        (step,) = struct.unpack_from(f"{order}H", section, here)
        if not name.isascii() or not name.decode("ascii").isprintable() or group == 0:
            raise ValueError(f"a parameter without a proper name at byte {at} of its parameters")
        end = here + step if step else len(section)
        if end > len(section) or (step and step < 3):
            raise ValueError(f"the parameter {name.decode('ascii')} leads out of the parameters")
        remark = here + 2  # where the length of the description stands
        if group > 0:
            size, count = struct.unpack_from("bB", section, here + 2)
            sizes = section[here + 4 : here + 4 + count]
            remark = here + 4 + count + abs(size) * math.prod(sizes)
            if size not in (-1, 1, 2, 4) or count > _MOST_DIMENSIONS:
                raise ValueError(f"the parameter {name.decode('ascii')} is of no known kind")
        if remark >= end or remark + 1 + section[remark] > end:
            raise ValueError(f"the parameter {name.decode('ascii')} is larger than its place")
        if step == 0:
            return
        at = end
