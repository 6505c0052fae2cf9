"""Changes that know what files are made of: lines, cells, numbers, elements, members of an archive."""

from __future__ import annotations

import io
import random
import re
import zipfile
from collections.abc import Callable, Sequence

#: Numbers at which readers stumble.
NUMBERS = (
    *(b"0", b"-1", b"1", b"1e308", b"-1e308", b"1e309", b"1e-320", b"nan", b"inf", b"-inf", b"NaN"),
    *(b"1_0", b"1,5", b"0x10", b"99999999999999999999", b"2147483648", b"1" * 400, b"9" * 5000),
    *(b"0x" + b"f" * 4000, b"1e5000", b"-0.0", b"0.1e", b"--1", "\u0665".encode(), b"true", b'"1"'),
)
#: Pieces at which readers stumble.
PIECES = (
    *(b"", b"\0", b"\r", b"\n", b"\t", b"\r\n\r\n", b"\xef\xbb\xbf", b"\xff\xfe", b"\x1b[31m", b"\x85"),
    *(b"\xc2\x85", b"\xe2\x80\xa8", b"a" * 3000, b"[" * 3000, b"{" * 3000, b"<a>" * 3000, b'"', b"'"),
    *(b"../", b"/etc/passwd", b"C:\\x", b"x\0y", b"%s{}", "µ".encode(), "\U0001f600".encode(), b"/"),
    *(b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&b;", b"&#0;", b"&#55296;", b"<![CDATA[", b"<!--", b"?>"),
    *(b"null", b"[]", b"{}", b"true", b"[[]]", b"1979-05-27", b"'''", b'"""', b"=", b"a.b.c = 1\n"),
)
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w./-]*")
_ELEMENT = re.compile(rb"<(\w+)[^<>]*>[^<>]*</\1>|<[^<>]*>")

Change = Callable[[bytes, random.Random], bytes]


def mutated(data: bytes, dice: random.Random, others: Sequence[bytes]) -> bytes:
    """Change a file once to four times, or begin again with a valid one."""
    if dice.random() < 0.4:
        data = dice.choice(others)
    for _ in range(dice.choice((1, 1, 1, 2, 3, 4))):
        data = dice.choice(_CHANGES)(data, dice)
    return data


def mutated_archive(data: bytes, dice: random.Random, others: Sequence[bytes]) -> bytes:
    """Change one member of a ``.npz`` file, whose checksums stay right; what is none becomes one."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > 1 << 22:
                raise ValueError
            members = {name: archive.read(name) for name in archive.namelist()}
        if not members or dice.random() < 0.4:
            raise ValueError
    except Exception:
        with zipfile.ZipFile(io.BytesIO(dice.choice(others))) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    name = dice.choice(list(members))
    act = dice.random()
    if act < 0.1:
        del members[name]
    elif act < 0.2:
        members[name] = members[dice.choice(list(members))]
    elif act < 0.6:
        # The header says type and shape.
        end = members[name].find(b"\n") + 1
        head = dice.choice((*_CHANGES, *[_number] * 6))(members[name][8:end], dice).rstrip()
        padded = head.ljust(end - 9) + b"\n"
        members[name] = members[name][:8] + padded + members[name][end:]
    else:
        members[name] = dice.choice(_CHANGES)(members[name], dice)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for own, content in members.items():
            archive.writestr(own, content)
    return made.getvalue()


def _number(data: bytes, dice: random.Random) -> bytes:
    return _replaced(data, _NUMBER, lambda old: dice.choice((*NUMBERS, old + b"0", b"-" + old)), dice)


def _word(data: bytes, dice: random.Random) -> bytes:
    words = _WORD.findall(data)
    return _replaced(data, _WORD, lambda old: dice.choice((*words[:200], *PIECES)), dice)


def _element(data: bytes, dice: random.Random) -> bytes:
    elements = [match[0] for match in _ELEMENT.finditer(data)][:400]
    return _replaced(data, _ELEMENT, lambda old: dice.choice((b"", old + old, *elements)), dice)


def _replaced(
    data: bytes, pattern: re.Pattern[bytes], new: Callable[[bytes], bytes], dice: random.Random
) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return _piece(data, dice)
    one = dice.choice(found)
    return data[: one.start()] + new(one[0]) + data[one.end() :]


def _line(data: bytes, dice: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, other = dice.randrange(len(lines)), dice.randrange(len(lines))
    act = dice.randrange(5)
    if act == 0:
        del lines[at]
    elif act == 1:
        lines.insert(other, lines[at])
    elif act == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif act == 3:
        lines = lines[:at]
    else:
        lines[at:at] = [lines[at]] * dice.choice((2, 50))
    return b"\n".join(lines)


def _cell(data: bytes, dice: random.Random) -> bytes:
    """Take away, double or empty a cell of a table."""
    lines = data.split(b"\n")
    at = dice.randrange(len(lines))
    between = b"\t" if b"\t" in lines[at] else b"," if b"," in lines[at] else b" "
    cells = lines[at].split(between)
    column = dice.randrange(len(cells))
    cells[column : column + 1] = dice.choice(([], [cells[column]] * 2, [b""], [dice.choice(NUMBERS)]))
    lines[at] = between.join(cells)
    return b"\n".join(lines)


def _piece(data: bytes, dice: random.Random) -> bytes:
    at = dice.randint(0, len(data))
    return data[:at] + dice.choice(PIECES) + data[at:]


def _cut(data: bytes, dice: random.Random) -> bytes:
    first, last = sorted((dice.randint(0, len(data)), dice.randint(0, len(data))))
    return dice.choice((data[:first], data[first:], data[:first] + data[last:]))


def _byte(data: bytes, dice: random.Random) -> bytes:
    at = dice.randint(0, max(len(data) - 1, 0))
    return data[:at] + bytes([dice.randrange(256)]) + data[at + 1 :]


def _repeated(data: bytes, dice: random.Random) -> bytes:
    first, last = sorted((dice.randint(0, len(data)), dice.randint(0, len(data))))
    last = min(last, first + 200)
    return data[:first] + data[first:last] * dice.choice((2, 10, 100)) + data[last:]


_CHANGES: tuple[Change, ...] = (
    *(_number, _number, _word, _word, _element, _line, _line, _cell, _cell),
    *(_piece, _cut, _byte, _repeated),
)
