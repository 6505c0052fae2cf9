"""Parsing of XML files from untrusted sources: size and depth are limited, entities are refused."""

from __future__ import annotations

import io
import re
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import read_content

#: Largest XML file, bytes. A whole-body model has about 2 MB, with 10,000 path points 10 MB.
MAX_BYTES = 256 << 20
#: Largest depth of nested elements. OpenSim's files have about 15; recursive functions have a limit.
MAX_NESTING = 200
#: Comments, and the two colons in the names of elements that OpenSim 3 wrote for a class within a class
#: (``HuntCrossleyForce::ContactParametersSet``). OpenSim reads both where XML forbids them: the colons, and
#: two hyphens within a comment.
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_NESTED_CLASS = re.compile(rb"(</?[A-Za-z_][\w.-]*)::(?=[A-Za-z_])")


def read_xml(path: Path, root_tag: str) -> Element:
    """Read and parse an XML file and check its root element.

    Raises
    ------
    InputError
        If the file cannot be read, is refused by `parse_xml`, or has another root element.
    """
    root = parse_xml(read_content(path, "XML", max_bytes=MAX_BYTES), path)
    if root.tag != root_tag:
        raise InputError(Problem(str(path), f"expected the root element <{root_tag}>, found <{root.tag}>"))
    return root


def read_xml_file(path: Path) -> Element:
    """Read and parse an XML file with any root element; see `parse_xml`.

    Raises
    ------
    InputError
        If the file is too large or refused by `parse_xml`.
    OSError
        If the file cannot be read.
    """
    _check_size(path.stat().st_size, path)
    return parse_xml(path.read_bytes(), path)


def parse_xml(content: bytes, path: Path) -> Element:
    """Parse an XML document without document type or entities.

    Entities can make a small file expand without limit, or include other files, and no OpenSim file needs
    them. A document that declares any is refused.

    Parameters
    ----------
    content
        Bytes of the file.
    path
        File, for error messages.

    Raises
    ------
    InputError
        If the document is too large, not UTF-8, not well formed, too deeply nested, or declares a document
        type or entities.
    """
    _check_size(len(content), path)
    if b"\0" in content:
        raise InputError(Problem(str(path), "is binary, where XML in UTF-8 was expected"))
    root: Element | None = None
    level = 0
    try:
        for event, element in iterparse(io.BytesIO(_as_xml(content)), ("start", "end"), forbid_dtd=True):
            root = element if root is None else root
            level += 1 if event == "start" else -1
            if level > MAX_NESTING:
                message = f"has elements nested in more than {MAX_NESTING} levels, unlike any OpenSim file"
                raise InputError(Problem(str(path), message))
    except DefusedXmlException:
        message = "declares a document type or entities, which are refused"
        raise InputError(Problem(str(path), message)) from None
    except (ParseError, ValueError, LookupError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(Problem(str(path), f"is not well-formed XML ({error})")) from None
    assert root is not None  # a well-formed document has a root element
    return root


def _as_xml(content: bytes) -> bytes:
    """Leave out comments, and the colons that XML forbids in names; the numbers of lines stay."""
    without_comments = _COMMENT.sub(lambda comment: b"\n" * comment[0].count(b"\n"), content)
    return _NESTED_CLASS.sub(rb"\1.", without_comments)


def _check_size(size: int, path: Path) -> None:
    if size > MAX_BYTES:
        message = f"has {size >> 20} MiB, where XML of at most {MAX_BYTES >> 20} MiB was expected"
        raise InputError(Problem(str(path), message))
