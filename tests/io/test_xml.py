"""Defends: XML as OpenSim 3 wrote it is read, whatever else is not XML is refused with its line."""

from pathlib import Path

import pytest

from wrapjax.errors import InputError
from wrapjax.io.xml import parse_xml

FILE = Path("model.osim")


def test_the_name_of_a_class_within_a_class_is_read():
    """OpenSim 3 wrote elements such as ``HuntCrossleyForce::ContactParameters``."""
    root = parse_xml(b"<Model><Force::Contact name='heel'><a>1</a></Force::Contact></Model>", FILE)
    assert root[0].tag == "Force.Contact"
    assert root[0].get("name") == "heel" and root.findtext("Force.Contact/a") == "1"


def test_colons_in_text_and_attributes_stay():
    root = parse_xml(b"<Model note='a::b'>c::d</Model>", FILE)
    assert root.get("note") == "a::b" and root.text == "c::d"


@pytest.mark.parametrize(
    "comment", [b"<!--\n<!--Markers in the model.-->", b"<!-- a -- b -->", b"<!---->", b"<!-- <a> -->"]
)
def test_comments_are_ignored_whatever_they_hold(comment: bytes):
    root = parse_xml(b"<Model>" + comment + b"<a>1</a></Model>", FILE)
    assert [child.tag for child in root] == ["a"]


def test_errors_name_the_line_of_the_file():
    """Lines within comments count."""
    with pytest.raises(InputError, match="line 4"):
        parse_xml(b"<Model>\n<!-- one\ntwo -->\n<a></b></Model>", FILE)


@pytest.mark.parametrize("content", [b"<Model><!-- never closed</Model>", b"<a::></a::>", b"<::a/>"])
def test_other_faults_are_refused(content: bytes):
    with pytest.raises(InputError, match="not well-formed"):
        parse_xml(content, FILE)


def test_a_document_type_is_refused_beside_comments():
    content = b"<!-- a --><!DOCTYPE x [<!ENTITY e 'f'>]><!-- b --><Model/>"
    with pytest.raises(InputError, match="document type or entities"):
        parse_xml(content, FILE)
