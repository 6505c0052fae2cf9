"""XML from anywhere, parsed without what makes XML dangerous."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.etree.ElementTree import Element

from wrapjax.errors import InputError, Problem

#: Larger files are refused. A whole-body model has about 2 MB, with 10,000 path points 10 MB.
MOST_BYTES = 256 << 20
#: Elements within elements. OpenSim's files have about 15; code that calls itself has its limit.
MOST_LEVELS = 200
_DECLARATION = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)


def read_xml_file(path: Path) -> Element:
    """Read and parse a file; see `parse_xml`.

    Raises
    ------
    InputError
        If it is too large or nothing that `parse_xml` takes.
    OSError
        If it cannot be read.
    """
    _check_size(path.stat().st_size, path)
    return parse_xml(path.read_bytes(), path)


def parse_xml(content: bytes, path: Path) -> Element:
    """Parse a document that declares nothing.

    Entities can make a small file expand without bound, or name files elsewhere, and no OpenSim file needs
    them. What declares any is refused before it is parsed.

    Parameters
    ----------
    content
        Of the file.
    path
        The file, for the message.

    Raises
    ------
    InputError
        If it is too large, no UTF-8, not well formed, too deep, or declares a document type or entities.
    """
    _check_size(len(content), path)
    # A zero byte means binary content, or an encoding in which the next check would not see the declaration.
    if b"\0" in content:
        raise InputError(Problem(str(path), "is binary, where XML in UTF-8 was expected"))
    if _DECLARATION.search(content):
        raise InputError(Problem(str(path), "declares a document type or entities, which are refused"))
    root: Element | None = None
    level = 0
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(content), ("start", "end")):
            root = element if root is None else root
            level += 1 if event == "start" else -1
            if level > MOST_LEVELS:
                message = f"has elements in more than {MOST_LEVELS} levels, which is no OpenSim file"
                raise InputError(Problem(str(path), message))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(Problem(str(path), f"is not well-formed XML ({error})")) from None
    assert root is not None  # else it would not have been well formed
    return root


def _check_size(size: int, path: Path) -> None:
    if size > MOST_BYTES:
        message = f"has {size >> 20} MiB, where XML of at most {MOST_BYTES >> 20} MiB was expected"
        raise InputError(Problem(str(path), message))
