"""Files of arbitrary content are read, or refused with printable error messages of limited length.

Tested with files for which readers failed in the past, reduced to the relevant part (found by ``python -m
validation.file_fuzzing``), and with random bytes.
"""

import io
import json
import os
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.subject.synthetic import MODEL, SETTINGS, write_subject
from wrapjax.errors import MAX_MESSAGE_LENGTH, InputError, Problem, nearest_name
from wrapjax.io.json_and_arrays import load_arrays, load_json
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.io.xml import MAX_BYTES, MAX_NESTING
from wrapjax.joints.nmsm_settings import read_nmsm_settings
from wrapjax.joints.settings import read_joint_settings
from wrapjax.preprocessing.files.c3d import read_c3d_markers
from wrapjax.preprocessing.files.laboratory_settings import read_laboratory_settings
from wrapjax.preprocessing.files.markers import read_trc
from wrapjax.preprocessing.nmsm.files import read_osimx, read_tool_settings
from wrapjax.subject.external_loads import read_external_loads
from wrapjax.subject.joint_spread import read_joint_spread
from wrapjax.subject.muscle_parameters import read_muscle_parameters
from wrapjax.subject.subject import load_subject

HEAD = "a\nversion=1\nnRows={rows}\nendheader\ntime\tb\n0\t1\n1\t2\n"
TRC = "PathFileType\t4\nRate\tNumFrames\tUnits\n100\t{rows}\tmm\nFrame#\tTime\tHEEL\n\tX1\tY1\tZ1\n\n"
FRAMES = "".join(f"{n}\t{n / 100}\t{n}\t{n}\t1\n" for n in range(1, 12))

READERS = {
    "sto": read_storage,
    "csv": read_muscle_parameters,
    "osim": read_model_file,
    "xml": read_external_loads,
    "osimx": read_osimx,
    "settings.xml": read_tool_settings,
    "toml": read_laboratory_settings,
    "trc": read_trc,
    "joints.toml": read_joint_settings,
    "jmp.xml": read_nmsm_settings,
    "joints.json": lambda path: read_joint_spread(path, ["hip_flexion_l"]),
    "c3d": read_c3d_markers,
}


def joined_messages(error: InputError) -> str:
    """Check all messages of an error, and join them."""
    assert error.problems
    for sentence in map(str, error.problems):
        assert sentence.isprintable() and len(sentence) < 4 * MAX_MESSAGE_LENGTH
    return "\n".join(map(str, error.problems))


def refusal(read, path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    return joined_messages(caught.value)


# ---- Files found by fuzzing


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("sto", HEAD.format(rows="9" * 5000), "an integer"),
        ("sto", HEAD.format(rows=2).replace("\tb\n", "\t\x1b[31mb\tc\n"), "binary"),
        ("sto", HEAD.format(rows=2).replace("\tb\n", "\t\u202eb\t\u202eb\n"), "\\u202e"),
        ("csv", "\ufeff", "column muscle"),
        ("trc", TRC.format(rows=0), "10 frames"),
        ("trc", TRC.format(rows="9" * 5000) + FRAMES, "states"),
        ("trc", TRC.format(rows=11) + FRAMES.replace("\t5\t5\t", "\t1e999\t5\t"), "infinity"),
        ("toml", "a = " + "[" * 3000, "too deeply nested"),
        ("toml", "a = " + "9" * 5000, "not valid TOML"),
        ("toml", "[subject]\nmass_kg = 0x" + "f" * 5000, "a number of too many digits"),
        ("toml", f'[model]\nfile = "{"x" * 3000}"', "expected a file"),
        ("toml", "[[trial]]\ncycle = [0, 1" + "0" * 400 + "]", "expected [t0, t1]"),
        ("osim", "<a>" * 100_000, "levels"),
        ("osimx", "<a/>" + "<" * 10, "well-formed"),
    ],
    ids=range(14),
)
def test_files_found_by_fuzzing_are_refused(tmp_path, name, content, words):
    file = tmp_path / f"input.{name}"
    file.write_bytes(content.encode())
    assert words in refusal(READERS[name], file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("name = ", "name = " + "[" * 3000, "too deeply nested"),
        ("[0.6, 1.8]", f"[0, 1{'0' * 400}]", "expected [t0, t1]"),
        ("mass_kg = 70.0", "mass_kg = 0x" + "f" * 5000, "a number of too many digits"),
        ('side = "l"', f'side = "l"\nother_leg = "{"x" * 3000}"', "expected the folder"),
    ],
)
def test_settings_found_by_fuzzing_are_refused(tmp_path, old, new, words):
    folder = write_subject(tmp_path / "subject")
    assert old in SETTINGS
    (folder / "subject.toml").write_text(SETTINGS.replace(old, new))
    assert words in refusal(load_subject, folder)


def test_one_long_cell_does_not_exhaust_the_memory(tmp_path):
    """NumPy would allocate the length of the longest text for all cells: 40 GB here."""
    (tmp_path / "a.sto").write_text(HEAD.format(rows=10_002) + "".join(f"{n}\t1\n" for n in range(2, 10_002)))
    text = (tmp_path / "a.sto").read_text().replace("\n1\t2\n", f"\n1\t{'x' * 1_000_000}\n")
    (tmp_path / "a.sto").write_text(text)
    assert "expected a number" in refusal(read_storage, tmp_path / "a.sto")


def test_a_c3d_file_with_invalid_offsets_is_refused(tmp_path):
    """With a wrong length of a description, ezc3d would allocate gigabytes."""
    header = bytes([2, 80]) + struct.pack("<5Hf2Hf", 1, 0, 1, 10, 0, -1.0, 3, 0, 100.0)
    group = b"\x05\xffPOINT" + struct.pack("<HB", 3, 0)
    wrong = b"\x04\x01UNIT" + struct.pack("<HbBH", 7, 2, 0, 0) + b"\xa5"
    section = bytes([1, 80, 1, 84]) + group + wrong
    content = header.ljust(512, b"\0") + section.ljust(512, b"\0") + bytes(2048)
    (tmp_path / "a.c3d").write_bytes(content)
    assert "UNIT is longer than its offset allows" in refusal(read_c3d_markers, tmp_path / "a.c3d")
    corrected = content.replace(b"\xa5", b"\x00")
    (tmp_path / "a.c3d").write_bytes(corrected[:1100])
    assert "bytes of frames, found 76" in refusal(read_c3d_markers, tmp_path / "a.c3d")


# ---- XML


@pytest.mark.parametrize("name", ["osim", "xml", "osimx", "settings.xml"])
@pytest.mark.parametrize(
    "declared",
    [
        '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;&b;&b;">]>',
        '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE a SYSTEM "http://localhost/a.dtd">',
    ],
    ids=["bomb", "file", "network"],
)
def test_entities_are_refused_by_every_reader_of_xml(tmp_path, name, declared):
    file = tmp_path / f"input.{name}"
    file.write_text(f'<?xml version="1.0"?>{declared}<OpenSimDocument>&b;</OpenSimDocument>')
    assert "declares a document type" in refusal(READERS[name], file)
    # In another encoding the declaration has other bytes.
    file.write_bytes(file.read_text().replace('"1.0"', '"1.0" encoding="UTF-16"').encode("utf-16"))
    assert "UTF-8 was expected" in refusal(READERS[name], file)


def test_models_that_refer_to_other_files_are_refused(tmp_path):
    """OpenSim would read any file of this computer that the model refers to."""
    file = tmp_path / "a.osim"
    file.write_text(MODEL.replace("<Model ", '<Model file="/etc/outside.xml" ', 1))
    assert "<Model> refers to another file, '/etc/outside.xml'" in refusal(read_model_file, file)


def test_huge_files_and_pipes_are_refused(tmp_path):
    huge = tmp_path / "huge.osim"
    with huge.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)  # a sparse file, which takes no space on the disk
    assert "256 MiB" in refusal(read_model_file, huge)
    pipe = tmp_path / "pipe.sto"
    os.mkfifo(pipe)
    assert "device or a pipe" in refusal(read_storage, pipe)


def test_deeply_nested_models_are_accepted(tmp_path):
    depth = MAX_NESTING - 5
    (tmp_path / "a.osim").write_text(f"<OpenSimDocument>{'<a>' * depth}{'</a>' * depth}</OpenSimDocument>")
    assert "<Model>" in refusal(read_model_file, tmp_path / "a.osim")


# ---- Paths


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    """In a folder received from others it could cause any file of this computer to be read."""
    folder = write_subject(tmp_path / "subject")
    own = folder / "trials" / "walk_a" / "emg.sto"
    own.rename(tmp_path / "secret.sto")
    own.symlink_to(tmp_path / "secret.sto")
    found = refusal(load_subject, folder)
    assert "emg" in found and "link" in found and "copy the file into the folder" in found
    # Links within the folder, and to the folder itself, are accepted.
    own.unlink()
    (tmp_path / "secret.sto").rename(folder / "recorded.sto")
    own.symlink_to(folder / "recorded.sto")
    (tmp_path / "link").symlink_to(folder)
    assert len(load_subject(tmp_path / "link").trials) == 3
    own.unlink()
    own.symlink_to(own)
    assert "expected a path inside" in refusal(load_subject, folder)


@pytest.mark.parametrize("path", ["/etc/passwd", "../../etc/passwd", "C:\\x", "a/../../b", "a\\u0000b"])
def test_paths_out_of_the_folder_are_refused(tmp_path, path):
    folder = write_subject(tmp_path / "subject")
    written = path if "u0000" in path else path.replace("\\", "\\\\")
    text = SETTINGS.replace("trials/walk_b/emg.sto", written)
    (folder / "subject.toml").write_text(text)
    assert "expected a path inside the subject's folder" in refusal(load_subject, folder)


# ---- Results read back


def archive(**members: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as stored:
        for name, content in members.items():
            stored.writestr(f"{name}.npy", content)
    return made.getvalue()


def array(header: str, content: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content


@pytest.mark.parametrize(
    "content",
    [
        archive(a=array("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}")),
        archive(a=array("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"cos\nsystem\n")),
        archive(a=array("{'descr': '<f8', ", b"12345678")),
        archive(a=array("(((((", b"")),
        archive(a=b"rubbish"),
        archive(a=b""),
        b"rubbish",
        b"",
        archive(a=array("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}", bytes(8)))[:-30],
    ],
    ids=[
        "too large",
        "objects",
        "header",
        "deep header",
        "no array",
        "empty",
        "no archive",
        "nothing",
        "cut",
    ],
)
def test_damaged_archives_of_arrays_are_errors(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError):
        load_arrays(tmp_path / "a.npz")


def test_arrays_are_read(tmp_path):
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.array(["recfem_l"]),
        "c": np.array(3),
        "d": np.zeros(0),
    }
    np.savez(tmp_path / "a.npz", **arrays)
    found = load_arrays(tmp_path / "a.npz")
    assert all(np.array_equal(found[name], value) for name, value in arrays.items())


def test_too_large_json_values_are_errors(tmp_path):
    (tmp_path / "a.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match="too deeply nested"):
        load_json(tmp_path / "a.json")
    (tmp_path / "a.json").write_text('{"a": -1' + 308 * "0" + "}")
    with pytest.raises(ValueError, match="310 digits"):
        load_json(tmp_path / "a.json")
    (tmp_path / "a.json").write_text(json.dumps({"a": [1, -(10**17)]}))
    assert load_json(tmp_path / "a.json") == {"a": [1, -(10**17)]}


# ---- Error messages


def test_messages_are_printable_and_of_limited_length():
    sentence = str(Problem("a\nb.sto", "found \x1b[2J" + "x" * 100_000, "column \t", "\u202e"))
    assert sentence.isprintable() and len(sentence) < 4 * MAX_MESSAGE_LENGTH
    assert "a\\nb.sto: column \\t: found \\x1b[2J" in sentence


def test_very_long_names_are_not_compared():
    """The time to compare two texts grows with the square of their lengths."""
    assert nearest_name("a" * 1_000_000, ["soleus_l"]) == "known: soleus_l"
    assert nearest_name("soleus", ["soleus_l", "b" * 1_000_000]) == "did you mean 'soleus_l'?"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("joints.toml", f'[model]\nfile = "{"x" * 3000}"', "expected a file"),
        ("joints.toml", f"[[trial]]\nmarkers = 'a'\ninterval = [0, 1{'0' * 400}]", "expected [start, end]"),
        ("joints.toml", f"[[trial]]\nmarkers = 'a'\ninterval = [1, 0x{'f' * 5000}]", "too many digits"),
        ("joints.toml", "[markers]\nweights = 3", "[markers.weights]"),
        ("joints.json", "[" * 100_000, "too deeply nested"),
    ],
    ids=("long path", "huge time", "huge integer", "weights", "nested"),
)
def test_files_of_joints_found_by_fuzzing_are_refused(tmp_path, name, content, words):
    file = tmp_path / f"input.{name}"
    file.write_text(content)
    assert words in refusal(READERS[name], file)


# ---- Any bytes


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300) | st.text(max_size=300).map(str.encode))
@example(content=b"\xef\xbb\xbf")
@example(content=b"\x02\x50" + bytes(1022))
def test_any_bytes_are_read_or_refused(tmp_path, name, content):
    file = tmp_path / f"input.{name}"
    file.write_bytes(content)
    try:
        READERS[name](file)
    except InputError as error:
        joined_messages(error)
