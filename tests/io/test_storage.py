"""Reading and writing of OpenSim's tables: round trip, header dialects, damaged files, column names."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wrapjax.errors import InputError
from wrapjax.io.storage import (
    Storage,
    find_columns,
    read_storage,
    read_storage_header,
    write_storage,
)

REPEATABLE = settings(
    deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

PLAIN = """walk
version=1
nRows=3
nColumns=3
inDegrees=no
endheader
time\thip_flexion_l\tknee_angle_l
0.0\t1.0\t-2.0
0.1\t3.5\t4e-3
0.25\t5\t+6
"""
TIME = [0.0, 0.1, 0.25]
VALUES = [[1.0, -2.0], [3.5, 0.004], [5.0, 6.0]]

LABEL = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), min_size=1, max_size=12).filter(
    lambda label: label == label.strip()
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def storage_fields(draw):
    columns = draw(
        st.lists(LABEL.filter(lambda label: label.lower() != "time"), min_size=1, max_size=4, unique=True)
    )
    steps = draw(arrays(float, st.integers(2, 6), elements=st.floats(1e-6, 10.0)))
    values = draw(arrays(float, (steps.size, len(columns)), elements=FINITE))
    return ("a table", tuple(columns), np.cumsum(steps), values, draw(st.booleans()))


@settings(REPEATABLE, max_examples=100)
@given(fields=storage_fields())
def test_writing_and_reading_preserves_all_digits(fields, tmp_path):
    storage = Storage(*fields)
    write_storage(tmp_path / "table.sto", storage)
    again = read_storage(tmp_path / "table.sto")
    assert again.columns == storage.columns
    assert again.in_degrees == storage.in_degrees
    np.testing.assert_array_equal(again.time, storage.time)
    np.testing.assert_array_equal(again.values, storage.values)


def test_opensim_reads_written_files(tmp_path):
    opensim = pytest.importorskip("opensim")
    values = np.random.default_rng(1).standard_normal((5, 2))
    time = np.array([0.0, 0.1, 0.25, 0.3, 1.0 / 3.0 + 1.0])
    write_storage(tmp_path / "table.sto", Storage("moments", ("a", "/path/b"), time, values, in_degrees=True))
    opensim.Logger.setLevelString("Off")
    table = opensim.TimeSeriesTable(str(tmp_path / "table.sto"))
    assert list(table.getColumnLabels()) == ["a", "/path/b"]
    assert table.getTableMetaDataString("inDegrees") == "yes"
    np.testing.assert_array_equal(table.getMatrix().to_numpy(), values)
    # Class that the OpenSim GUI uses to open files.
    old = opensim.Storage(str(tmp_path / "table.sto"))
    assert (old.getSize(), old.getColumnLabels().getSize(), old.isInDegrees()) == (5, 3, True)


def test_files_written_by_opensim_are_read(tmp_path):
    opensim = pytest.importorskip("opensim")
    opensim.Logger.setLevelString("Off")
    table = opensim.TimeSeriesTable()
    table.setColumnLabels(["a", "b"])
    for time, row in zip(TIME, VALUES, strict=True):
        table.appendRow(time, opensim.RowVector(row))
    table.addTableMetaDataString("inDegrees", "yes")
    opensim.STOFileAdapter.write(table, str(tmp_path / "table.sto"))
    read = read_storage(tmp_path / "table.sto")
    assert read.columns == ("a", "b") and read.in_degrees
    np.testing.assert_array_equal(read.time, TIME)
    np.testing.assert_array_equal(read.values, VALUES)


def test_invalid_labels_are_not_written(tmp_path):
    for label in ("a\tb", "a\nb", " "):
        with pytest.raises(ValueError, match="tabs or line breaks"):
            write_storage(tmp_path / "x.sto", Storage("x", (label,), np.array([0.0, 1.0]), np.zeros((2, 1))))
    assert list(tmp_path.iterdir()) == []


VARIANTS = {
    "plain": PLAIN,
    "spaces": PLAIN.replace("\t", "   "),
    "padded numbers": PLAIN.replace("\t", "\t      "),
    "trailing tabs": PLAIN.replace("\n", "\t\n").replace("endheader\t", "endheader"),
    "windows line ends": PLAIN.replace("\n", "\r\n"),
    "old mac line ends": PLAIN.replace("\n", "\r"),
    "byte order mark": "\ufeff" + PLAIN,
    "upper case": PLAIN.replace("endheader", "ENDHEADER").replace("nRows", "NROWS").replace("time", "Time"),
    "spaces around equals": PLAIN.replace("=", " = "),
    "no version": PLAIN.replace("version=1\n", ""),
    "no counts": PLAIN.replace("nRows=3\n", "").replace("nColumns=3\n", ""),
    "version 3": PLAIN.replace(
        "version=1", "DataType=double\nversion=3\nOpenSimVersion=4.5-2024-03-01-1daf88a4f"
    ),
    "no last line end": PLAIN.rstrip("\n"),
    "blank lines": PLAIN.replace(
        "endheader\n", "\nUnits are S.I. units (second, meters, Newtons, ...)\n\nendheader\n\n"
    )
    + "\n\n",
    "simm": PLAIN.replace(
        "version=1\nnRows=3\nnColumns=3\n", "datacolumns 3\ndatarows 3\notherdata 1\nrange 0 0.25\n"
    ),
    "latin-1 title": PLAIN.replace("walk", "Übung").encode("latin-1"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_header_dialects(name, tmp_path):
    content = VARIANTS[name]
    path = tmp_path / "table.sto"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    storage = read_storage(path)
    assert storage.columns == ("hip_flexion_l", "knee_angle_l")
    assert not storage.in_degrees
    assert storage.remarks == ()
    np.testing.assert_array_equal(storage.time, TIME)
    np.testing.assert_array_equal(storage.values, VALUES)
    header = read_storage_header(path)
    assert (header.columns, header.in_degrees) == (storage.columns, storage.in_degrees)


@pytest.mark.parametrize(
    ("suffix", "line", "in_degrees"),
    [
        (".sto", "inDegrees=yes", True),
        (".sto", "INDEGREES=YES", True),
        (".mot", "inDegrees=no", False),
        (".sto", "Angles are in degrees.", True),
        (".mot", "Angles are in radians.", False),
        # Where a file does not state it, OpenSim 4.6 assumes degrees in .mot and radians in .sto files.
        (".sto", "", False),
        (".mot", "", True),
    ],
)
def test_degrees_by_the_rule_of_opensim(suffix, line, in_degrees, tmp_path):
    path = tmp_path / f"angles{suffix}"
    path.write_text(PLAIN.replace("inDegrees=no", line))
    assert read_storage(path).in_degrees is in_degrees


def test_labels_may_contain_spaces(tmp_path):
    (tmp_path / "emg.sto").write_text(PLAIN.replace("hip_flexion_l", "Left Soleus"))
    assert read_storage(tmp_path / "emg.sto").columns == ("Left Soleus", "knee_angle_l")


def test_wrong_column_count_in_the_header_is_a_remark(tmp_path):
    """OpenSim ignores this number, and its example files have it wrong."""
    (tmp_path / "angles.sto").write_text(PLAIN.replace("nColumns=3", "nColumns=40"))
    storage = read_storage(tmp_path / "angles.sto")
    np.testing.assert_array_equal(storage.values, VALUES)
    assert "40 columns" in storage.remarks[0]


DAMAGED = {
    "empty": ("", ["empty"]),
    "only blanks": (" \n\n", ["empty"]),
    "binary": (bytes(range(256)) * 8, ["binary"]),
    "utf-16": (PLAIN.encode("utf-16"), ["binary"]),
    "no endheader": (PLAIN.replace("endheader\n", ""), ["endheader"]),
    "xml": ("<?xml version='1.0'?>\n<a/>\n", ["endheader", "XML"]),
    "csv": ("time,a\n0,1\n1,2\n", ["endheader", "comma-separated"]),
    "header only": (PLAIN.split("time")[0], ["endheader", "labels"]),
    "no rows": (PLAIN.split("0.0\t")[0], ["states 3 rows, found 0"]),
    "one row": (PLAIN.split("0.1\t")[0].replace("nRows=3\n", ""), ["at least 2 rows", "found 1"]),
    "rows missing": (PLAIN.split("0.25")[0], ["states 3 rows, found 2", "truncated"]),
    "rows too many": (PLAIN + "0.3\t1\t2\n", ["states 3 rows, found 4"]),
    "cut within a row": (
        PLAIN.replace("5\t+6\n", "5"),
        ["line 10", "expected 3 numbers, found 2", "truncated"],
    ),
    "row too long": (PLAIN.replace("3.5", "3.5\t9"), ["line 9", "expected 3 numbers, found 4"]),
    "cell missing": (PLAIN.replace("3.5", ""), ["line 9", "expected 3 numbers, found 2"]),
    "text": (PLAIN.replace("3.5", "oops"), ["line 9", "column hip_flexion_l", "'oops'"]),
    "decimal comma": (PLAIN.replace("3.5", "3,5"), ["line 9", "decimal point"]),
    "nan": (PLAIN.replace("3.5", "nan"), ["line 9", "column hip_flexion_l", "finite", "nan"]),
    "infinite": (PLAIN.replace("+6", "-inf"), ["line 10", "column knee_angle_l", "finite", "-inf"]),
    "nan as time": (PLAIN.replace("0.1\t", "NaN\t"), ["line 9", "column time", "finite"]),
    "time backwards": (
        PLAIN.replace("0.25\t", "0.05\t"),
        ["line 10", "time to increase", "0.05 s after 0.1 s"],
    ),
    "time stands": (PLAIN.replace("0.25\t", "0.1\t"), ["line 10", "time to increase"]),
    "time not first": (PLAIN.replace("time\thip", "hip\ttime"), ["line 7", "expected 'time'", "'hip'"]),
    "column twice": (
        PLAIN.replace("knee_angle_l", "hip_flexion_l"),
        ["column hip_flexion_l", "more than once"],
    ),
    "column without label": (PLAIN.replace("hip_flexion_l", " "), ["line 7", "column 2", "no label"]),
    "vectors": (PLAIN.replace("version=1", "DataType=Vec3"), ["DataType=double", "Vec3"]),
    "count is no number": (PLAIN.replace("nRows=3", "nRows=three"), ["header", "nrows", "'three'"]),
    "degrees neither": (PLAIN.replace("inDegrees=no", "inDegrees=perhaps"), ["inDegrees", "perhaps"]),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused(name, tmp_path):
    content, words = DAMAGED[name]
    path = tmp_path / "table.sto"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read_storage(path)
    for word in ["table.sto", *words]:
        assert word in str(caught.value)


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "angles.sto").write_text(PLAIN)
    with pytest.raises(InputError, match=r"does not exist; did you mean 'angles\.sto'"):
        read_storage(tmp_path / "angels.sto")
    with pytest.raises(InputError, match="is a folder"):
        read_storage(tmp_path)


def test_several_faults_of_a_file_are_reported_at_once(tmp_path):
    (tmp_path / "t.sto").write_text(PLAIN.replace("3.5", "nan").replace("+6", "inf").replace("0.25", "0.01"))
    with pytest.raises(InputError) as caught:
        read_storage(tmp_path / "t.sto")
    assert len(caught.value.problems) == 3


@settings(REPEATABLE, max_examples=200)
@given(place=st.integers(0, len(PLAIN)), rubbish=st.binary(max_size=20))
def test_any_damage_is_an_input_error_or_harmless(place, rubbish, tmp_path):
    path = tmp_path / "table.sto"
    path.write_bytes(PLAIN[:place].encode() + rubbish)
    try:
        storage = read_storage(path)
    except InputError:
        return
    assert np.isfinite(storage.values).all() and (np.diff(storage.time) > 0).all()
    assert storage.values.shape == (storage.time.size, len(storage.columns))


@pytest.mark.parametrize(
    ("columns", "name", "suffixes", "found"),
    [
        (("a", "hip_flexion_r"), "hip_flexion_r", ("",), [1]),
        (
            ("/jointset/hip_r/hip_flexion_r/value", "/jointset/hip_r/hip_flexion_r/speed"),
            "hip_flexion_r",
            ("",),
            [0],
        ),
        (("/jointset/hip_r/hip_flexion_r/speed",), "hip_flexion_r", ("",), []),
        (("hip_r/hip_flexion_r/value",), "hip_flexion_r", ("",), [0]),
        (("/forceset/soleus_r", "/forceset/gasmed_r/activation"), "soleus_r", ("",), [0]),
        (("/forceset/soleus_r", "/forceset/gasmed_r/activation"), "gasmed_r", ("",), [1]),
        (("knee_angle_r", "knee_angle_r_moment"), "knee_angle_r", ("_moment", "_force", ""), [1]),
        (("knee_angle_r",), "knee_angle_r", ("_moment", "_force", ""), [0]),
        (("/jointset/knee_r/knee_angle_r_moment",), "knee_angle_r", ("_moment",), [0]),
        (("hip_flexion_r", "/jointset/hip_r/hip_flexion_r/value"), "hip_flexion_r", ("",), [0, 1]),
        (("L/Soleus",), "L/Soleus", ("",), [0]),
        (("/",), "x", ("",), []),
    ],
)
def test_columns_are_found_by_name_or_path(columns, name, suffixes, found):
    assert find_columns(columns, name, suffixes) == found
