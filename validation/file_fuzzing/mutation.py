"""Mutations by syntax: lines, cells, numbers, XML elements, and members of an archive."""

from __future__ import annotations

import io
import random
import re
import zipfile
from collections.abc import Callable, Sequence

#: Numbers that are difficult to read.
NUMBERS = (
    *(b"0", b"-1", b"1", b"1e308", b"-1e308", b"1e309", b"1e-320", b"nan", b"inf", b"-inf", b"NaN"),
    *(b"1_0", b"1,5", b"0x10", b"99999999999999999999", b"2147483648", b"1" * 400, b"9" * 5000),
    *(b"0x" + b"f" * 4000, b"1e5000", b"-0.0", b"0.1e", b"--1", "\u0665".encode(), b"true", b'"1"'),
)
#: Byte strings that are difficult to read.
PIECES = (
    *(b"", b"\0", b"\r", b"\n", b"\t", b"\r\n\r\n", b"\xef\xbb\xbf", b"\xff\xfe", b"\x1b[31m", b"\x85"),
    *(b"\xc2\x85", b"\xe2\x80\xa8", b"a" * 3000, b"[" * 3000, b"{" * 3000, b"<a>" * 3000, b'"', b"'"),
    *(b"../", b"/etc/passwd", b"C:\\x", b"x\0y", b"%s{}", "\u00b5".encode(), "\U0001f600".encode(), b"/"),
    *(b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&b;", b"&#0;", b"&#55296;", b"<![CDATA[", b"<!--", b"?>"),
    *(b"null", b"[]", b"{}", b"true", b"[[]]", b"1979-05-27", b"'''", b'"""', b"=", b"a.b.c = 1\n"),
)
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w./-]*")
_ELEMENT = re.compile(rb"<(\w+)[^<>]*>[^<>]*</\1>|<[^<>]*>")

Change = Callable[[bytes, random.Random], bytes]


def mutated(data: bytes, generator: random.Random, others: Sequence[bytes]) -> bytes:
    """Apply one to four mutations to a file, or to a valid one."""
    if generator.random() < 0.4:
        data = generator.choice(others)
    for _ in range(generator.choice((1, 1, 1, 2, 3, 4))):
        data = generator.choice(_CHANGES)(data, generator)
    return data


def mutated_archive(data: bytes, generator: random.Random, others: Sequence[bytes]) -> bytes:
    """Mutate one member of a ``.npz`` file and write valid checksums; replace other files by a valid one."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > 1 << 22:
                raise ValueError
            members = {name: archive.read(name) for name in archive.namelist()}
        if not members or generator.random() < 0.4:
            raise ValueError
    except Exception:
        with zipfile.ZipFile(io.BytesIO(generator.choice(others))) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    name = generator.choice(list(members))
    act = generator.random()
    if act < 0.1:
        del members[name]
    elif act < 0.2:
        members[name] = members[generator.choice(list(members))]
    elif act < 0.6:
        # The header contains type and shape.
        end = members[name].find(b"\n") + 1
        head = generator.choice((*_CHANGES, *[_number] * 6))(members[name][8:end], generator).rstrip()
        padded = head.ljust(end - 9) + b"\n"
        members[name] = members[name][:8] + padded + members[name][end:]
    else:
        members[name] = generator.choice(_CHANGES)(members[name], generator)
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return written.getvalue()


def _number(data: bytes, generator: random.Random) -> bytes:
    return _replaced(
        data, _NUMBER, lambda old: generator.choice((*NUMBERS, old + b"0", b"-" + old)), generator
    )


def _word(data: bytes, generator: random.Random) -> bytes:
    words = _WORD.findall(data)
    return _replaced(data, _WORD, lambda old: generator.choice((*words[:200], *PIECES)), generator)


def _element(data: bytes, generator: random.Random) -> bytes:
    elements = [match[0] for match in _ELEMENT.finditer(data)][:400]
    return _replaced(data, _ELEMENT, lambda old: generator.choice((b"", old + old, *elements)), generator)


def _replaced(
    data: bytes, pattern: re.Pattern[bytes], new: Callable[[bytes], bytes], generator: random.Random
) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return _piece(data, generator)
    one = generator.choice(found)
    return data[: one.start()] + new(one[0]) + data[one.end() :]


def _line(data: bytes, generator: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, other = generator.randrange(len(lines)), generator.randrange(len(lines))
    act = generator.randrange(5)
    if act == 0:
        del lines[at]
    elif act == 1:
        lines.insert(other, lines[at])
    elif act == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif act == 3:
        lines = lines[:at]
    else:
        lines[at:at] = [lines[at]] * generator.choice((2, 50))
    return b"\n".join(lines)


def _cell(data: bytes, generator: random.Random) -> bytes:
    """Delete, duplicate, empty or replace a cell of a table."""
    lines = data.split(b"\n")
    at = generator.randrange(len(lines))
    between = b"\t" if b"\t" in lines[at] else b"," if b"," in lines[at] else b" "
    cells = lines[at].split(between)
    column = generator.randrange(len(cells))
    cells[column : column + 1] = generator.choice(
        ([], [cells[column]] * 2, [b""], [generator.choice(NUMBERS)])
    )
    lines[at] = between.join(cells)
    return b"\n".join(lines)


def _piece(data: bytes, generator: random.Random) -> bytes:
    at = generator.randint(0, len(data))
    return data[:at] + generator.choice(PIECES) + data[at:]


def _cut(data: bytes, generator: random.Random) -> bytes:
    first, last = sorted((generator.randint(0, len(data)), generator.randint(0, len(data))))
    return generator.choice((data[:first], data[first:], data[:first] + data[last:]))


def _byte(data: bytes, generator: random.Random) -> bytes:
    at = generator.randint(0, max(len(data) - 1, 0))
    return data[:at] + bytes([generator.randrange(256)]) + data[at + 1 :]


def _repeated(data: bytes, generator: random.Random) -> bytes:
    first, last = sorted((generator.randint(0, len(data)), generator.randint(0, len(data))))
    last = min(last, first + 200)
    return data[:first] + data[first:last] * generator.choice((2, 10, 100)) + data[last:]


_CHANGES: tuple[Change, ...] = (
    *(_number, _number, _word, _word, _element, _line, _line, _cell, _cell),
    *(_piece, _cut, _byte, _repeated),
)
