"""OpenSim's ``.sto`` and ``.mot`` tables: reading with checks, writing, and finding columns by name.

The header has ``key=value`` lines or SIMM's ``key value`` lines, comments and blank lines up to a line
``endheader``; column labels and numbers follow. The number of rows in the header and the number of labels are
compared with the numbers, so that a truncated file is refused. A wrong ``nColumns`` is a remark only, since
OpenSim ignores it and files of its own distribution have it wrong. Column labels are plain names, or the full
paths of components that OpenSim writes since version 4.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.files import read_content, write_text

#: Largest number of header lines. Usual headers have 5 to 20 lines.
MAX_HEADER_LINES = 200
_CONTROL_CHARACTER = re.compile(r"[\x00-\x08\x0b\x0e-\x1f]")
_KEY_VALUE = re.compile(r"\s*(\w+)\s*(?:=|\s)\s*(\S.*?)\s*$")


@dataclass(frozen=True)
class StorageHeader:
    """Header and column labels of a table.

    Parameters
    ----------
    name
        First line of the file.
    columns
        Labels of all columns except the first, which is time.
    in_degrees
        Whether angles are in degrees. Where the file does not state it, OpenSim's rule: ``.mot`` yes,
        ``.sto`` no.
    row_count
        Number of rows by the header; None where the header does not state it.
    body_line
        Number of lines above the first row of numbers.
    remarks
        Harmless irregularities of the file.
    """

    name: str
    columns: tuple[str, ...]
    in_degrees: bool
    row_count: int | None
    body_line: int
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Storage:
    """Table over time, in the units of its file.

    Parameters
    ----------
    name
        Title of the table.
    columns
        Labels of the columns without time.
    time
        Time in s, strictly increasing.
    values
        Values, finite, in the units of the file.
    in_degrees
        Whether angles are in degrees.
    remarks
        Harmless irregularities of the file.
    """

    name: str
    columns: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    values: Float[np.ndarray, "frame column"]
    in_degrees: bool = False
    remarks: tuple[str, ...] = ()


def read_storage(path: str | Path, *, trust_row_count: bool = True) -> Storage:
    """Read a ``.sto`` or ``.mot`` file.

    Parameters
    ----------
    path
        File to read.
    trust_row_count
        Refuse a file whose number of rows differs from that in its header; otherwise this is a remark.

    Returns
    -------
    Storage
        Time in s, values in the units of the file (see `Storage.in_degrees`).

    Raises
    ------
    InputError
        With all faults of the file: missing, empty, binary, truncated, not numeric, not finite, time not
        strictly increasing, duplicate columns.
    """
    path = Path(path)
    lines = _read_lines(path)
    header = _parse_header(lines, path)
    stated = header.row_count
    if not trust_row_count:
        header = replace(header, row_count=None)
    rows, line_numbers = _split_rows(lines[header.body_line :], header, path)
    if stated not in (None, len(rows)):
        remark = f"the header states {stated} rows, found {len(rows)}"
        header = replace(header, remarks=(*header.remarks, remark))
    table = _numbers(rows, line_numbers, header, path)
    _check_table(table, line_numbers, header, path)
    return Storage(header.name, header.columns, table[:, 0], table[:, 1:], header.in_degrees, header.remarks)


def read_storage_header(path: str | Path) -> StorageHeader:
    """Read the header and the column labels only.

    Raises
    ------
    InputError
        If the file is missing, empty, binary, or has no valid header.
    """
    path = Path(path)
    return _parse_header(_read_lines(path, limit=MAX_HEADER_LINES + 2), path)


def write_storage(path: str | Path, storage: Storage) -> None:
    """Write a ``.sto`` or ``.mot`` file for OpenSim atomically, with all digits.

    Raises
    ------
    ValueError
        If a label is empty or holds tabs or line breaks, or the shapes disagree.
    """
    labels = ("time", *storage.columns)
    if storage.values.shape != (storage.time.size, len(storage.columns)):
        raise ValueError(f"values are {storage.values.shape}, not (frames, columns) of time and labels")
    invalid = [
        label for label in (storage.name, *labels) if re.search(r"[\t\r\n]", label) or not label.strip()
    ]
    if invalid:
        raise ValueError(f"labels must not be empty or hold tabs or line breaks: {invalid!r}")
    head = [
        storage.name,
        "version=1",
        f"nRows={storage.time.size}",
        f"nColumns={len(labels)}",
        f"inDegrees={'yes' if storage.in_degrees else 'no'}",
        "endheader",
        "\t".join(labels),
    ]
    table = np.column_stack([storage.time, storage.values])
    body = ["\t".join(map(repr, row)) for row in table.tolist()]
    write_text(Path(path), "\n".join([*head, *body]) + "\n")


def _read_lines(path: Path, limit: int | None = None) -> list[str]:
    """Read all lines of a text file, or the first ones, without line ends."""
    content = read_content(path, "a .sto or .mot table", limit)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Titles in an 8-bit encoding. Latin-1 decodes any byte, so that binary content is detected below.
        text = content.decode("latin-1")
    if _CONTROL_CHARACTER.search(text):
        raise InputError(
            Problem(str(path), "is binary, where a .sto or .mot table in plain text was expected")
        )
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _parse_header(lines: list[str], path: Path) -> StorageHeader:
    """Parse the header and the column labels; raise an error with all faults."""
    problems: list[Problem] = []
    ends = [
        number for number, line in enumerate(lines[:MAX_HEADER_LINES]) if line.strip().lower() == "endheader"
    ]
    if not ends:
        raise InputError(
            Problem(
                str(path),
                "has no line 'endheader', where a .sto or .mot table was expected",
                hint=_guess_format(lines),
            )
        )
    keys: dict[str, str] = {}
    comments = []
    for line in lines[: ends[0]]:
        match = _KEY_VALUE.match(line)
        if match:
            keys.setdefault(match[1].lower(), match[2])
        comments.append(line.strip().lower())

    row_count = _count(keys, ("nrows", "datarows"), path, problems)
    column_count = _count(keys, ("ncolumns", "datacolumns"), path, problems)
    data_type = keys.get("datatype", "double")
    if data_type.lower() != "double":
        problems.append(Problem(str(path), f"expected DataType=double, found {data_type}", "header"))
    in_degrees = _in_degrees(keys, comments, path, problems)

    start = ends[0] + 1
    while start < len(lines) and not lines[start].strip():
        start += 1
    if start == len(lines):
        problems.append(Problem(str(path), "ends after 'endheader', where column labels were expected"))
        raise InputError(problems)
    label_line = lines[start].strip()
    labels = label_line.split("\t") if "\t" in label_line else label_line.split()
    labels = [label.strip() for label in labels]
    place = f"line {start + 1}"
    if labels[0].lower() != "time":
        problems.append(
            Problem(str(path), f"expected 'time' as the first column, found '{labels[0]}'", place)
        )
    remarks: tuple[str, ...] = ()
    if column_count is not None and column_count != len(labels):
        remarks = (f"the header states {column_count} columns, found {len(labels)} labels",)
    if "" in labels:
        problems.append(Problem(str(path), f"column {labels.index('') + 1} has no label", place))
    duplicates = [label for label, count in Counter(labels).items() if count > 1 and label]
    problems += [
        Problem(str(path), "the column occurs more than once", f"column {label}") for label in duplicates
    ]
    if problems:
        raise InputError(problems)
    return StorageHeader(lines[0].strip(), tuple(labels[1:]), in_degrees, row_count, start + 1, remarks)


def _guess_format(lines: list[str]) -> str:
    """Guess the format of a file without a header."""
    first = lines[0].lstrip()
    if first.startswith("<"):
        return "it looks like XML"
    if "," in first and "\t" not in first:
        return "it looks like a comma-separated file"
    return "is the file complete?"


def _count(keys: dict[str, str], names: tuple[str, ...], path: Path, problems: list[Problem]) -> int | None:
    for name in names:
        if name in keys:
            # Longer ones exceed any number of rows, and Python refuses to convert very long ones.
            if keys[name].isdecimal() and len(keys[name]) < 20:
                return int(keys[name])
            message = f"expected an integer for {name}, found '{keys[name]}'"
            problems.append(Problem(str(path), message, "header"))
    return None


def _in_degrees(keys: dict[str, str], comments: list[str], path: Path, problems: list[Problem]) -> bool:
    if "indegrees" in keys:
        answer = keys["indegrees"].lower()
        if answer not in ("yes", "no"):
            problems.append(Problem(str(path), f"expected inDegrees=yes or no, found '{answer}'", "header"))
        return answer == "yes"
    if "angles are in degrees." in comments:
        return True
    if "angles are in radians." in comments:
        return False
    return path.suffix.lower() == ".mot"


def _split_rows(body: list[str], header: StorageHeader, path: Path) -> tuple[list[list[str]], list[int]]:
    """Split the rows of numbers into cells; also return the line number of each row in the file."""
    rows = []
    line_numbers = []
    for number, line in enumerate(body, start=header.body_line + 1):
        cells = line.split()
        if cells:
            rows.append(cells)
            line_numbers.append(number)
    expected = len(header.columns) + 1
    problems = []
    for cells, number in zip(rows, line_numbers, strict=True):
        if len(cells) != expected:
            message = f"expected {expected} numbers, found {len(cells)}"
            hint = (
                "the file seems to be truncated there"
                if number == line_numbers[-1]
                else "; ".join(header.remarks)
            )
            problems.append(Problem(str(path), message, f"line {number}", hint))
            break
    if header.row_count is not None and header.row_count != len(rows):
        message = f"the header states {header.row_count} rows, found {len(rows)}"
        hint = "the file seems to be truncated" if len(rows) < header.row_count else ""
        problems.append(Problem(str(path), message, hint=hint))
    elif len(rows) < 2:
        problems.append(Problem(str(path), f"expected at least 2 rows of numbers, found {len(rows)}"))
    if problems:
        raise InputError(problems)
    return rows, line_numbers


def _numbers(
    rows: list[list[str]], line_numbers: list[int], header: StorageHeader, path: Path
) -> Float[np.ndarray, "frame all_columns"]:
    try:
        # NumPy would allocate for every cell the length of the longest one.
        return np.array([list(map(float, cells)) for cells in rows])
    except ValueError:
        pass
    labels = ("time", *header.columns)
    problems = {}
    for cells, number in zip(rows, line_numbers, strict=True):
        for label, cell in zip(labels, cells, strict=True):
            if label not in problems and not _is_number(cell):
                hint = "use a decimal point, not a comma" if _is_number(cell.replace(",", ".")) else ""
                place = f"line {number}, column {label}"
                problems[label] = Problem(str(path), f"expected a number, found '{cell[:40]}'", place, hint)
    raise InputError(problems.values())


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_table(
    table: Float[np.ndarray, "frame all_columns"], line_numbers: list[int], header: StorageHeader, path: Path
) -> None:
    """Raise unless every number is finite and time strictly increases."""
    problems = []
    bad = ~np.isfinite(table)
    for column in np.flatnonzero(bad.any(axis=0)):
        row = int(np.argmax(bad[:, column]))
        label = ("time", *header.columns)[column]
        message = f"expected finite numbers, found {table[row, column]}"
        message = f"{message} ({bad[:, column].sum()} such values in the column)"
        problems.append(Problem(str(path), message, f"line {line_numbers[row]}, column {label}"))
    if not bad[:, 0].any():
        backwards = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
        if backwards.size:
            row = int(backwards[0])
            message = f"expected time to increase, found {table[row + 1, 0]:g} s after {table[row, 0]:g} s"
            problems.append(Problem(str(path), message, f"line {line_numbers[row + 1]}, column time"))
    if problems:
        raise InputError(problems)


#: Last segments of full paths that name a quantity of a component.
_QUANTITIES = ("value", "activation", "excitation")


def find_columns(columns: tuple[str, ...], name: str, suffixes: tuple[str, ...] = ("",)) -> list[int]:
    """Find the columns of a component, by plain label or full path.

    Parameters
    ----------
    columns
        Labels of the columns.
    name
        Name of a component, such as ``hip_flexion_r``.
    suffixes
        Allowed suffixes of the name, such as ``("_moment",)``; earlier ones take precedence.

    Returns
    -------
    list of int
        Positions of the matching columns: none, one, or several where the file is ambiguous.
        ``/jointset/hip_r/hip_flexion_r/value`` matches; ``.../speed`` does not.
    """
    for suffix in suffixes:
        expected = name + suffix
        found = [place for place, label in enumerate(columns) if expected in (label, component_name(label))]
        if found:
            return found
    return []


def component_name(label: str) -> str:
    """Extract a component's name from a column label: ``hip_flexion_r`` from its full path.

    A plain name, and the path of another quantity (``.../speed``), is returned unchanged.
    """
    if "/" not in label:
        return label
    segments = [segment for segment in label.split("/") if segment]
    if not segments:
        return label
    last = segments[-1]
    if last in _QUANTITIES and len(segments) > 1:
        return segments[-2]
    return label if last == "speed" else last
