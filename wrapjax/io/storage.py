"""OpenSim's tables in text: ``.sto`` and ``.mot`` files, read strictly and written whole.

The format is ten years of habits: ``key=value`` lines or SIMM's ``key value`` lines, comments and blank
lines up to a line ``endheader``, then the column labels and the numbers. The rows the header promises and
the labels above the numbers are checked against the body, so that a truncated file is never used. OpenSim
itself does not rely on ``nColumns``, and files from its own distribution have it wrong: that is a remark.

Column labels: plain names, or full paths of components, as OpenSim writes them since version 4.
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

#: A header longer than this is no header. Real ones have 5 to 20 lines.
MAX_HEADER_LINES = 200
_CONTROL_CHARACTER = re.compile(r"[\x00-\x08\x0b\x0e-\x1f]")
_KEY_VALUE = re.compile(r"\s*(\w+)\s*(?:=|\s)\s*(\S.*?)\s*$")


@dataclass(frozen=True)
class StorageHeader:
    """What stands above the numbers.

    Parameters
    ----------
    name
        The first line of the file.
    columns
        Labels of all columns but the first, which is time.
    in_degrees
        Whether angles are in degrees. Where the file does not say, OpenSim's rule: ``.mot`` yes, ``.sto`` no.
    row_count
        Rows promised, None where the file does not say.
    body_line
        Lines of the file above the first row of numbers.
    remarks
        What is odd about the file but does no harm.
    """

    name: str
    columns: tuple[str, ...]
    in_degrees: bool
    row_count: int | None
    body_line: int
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Storage:
    """A table over time, in the units of its file.

    Parameters
    ----------
    name
        Title of the table.
    columns
        Labels of the columns, time not among them.
    time
        Time in s, strictly increasing.
    values
        The numbers, finite.
    in_degrees
        Whether angles are in degrees.
    remarks
        What was odd about the file read but does no harm.
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
        The file.
    trust_row_count
        Refuse a file that has another number of rows than its header promises; else that is a remark.

    Returns
    -------
    Storage
        Time in s and the values in the file's own units (see `Storage.in_degrees`).

    Raises
    ------
    InputError
        With everything wrong in this file: missing, empty, binary, truncated, not numeric, not finite, time
        not strictly increasing, a column twice.
    """
    path = Path(path)
    lines = _read_lines(path)
    header = _parse_header(lines, path)
    promised = header.row_count
    if not trust_row_count:
        header = replace(header, row_count=None)
    rows, line_numbers = _split_rows(lines[header.body_line :], header, path)
    if promised not in (None, len(rows)):
        remark = f"the header promises {promised} rows, found {len(rows)}"
        header = replace(header, remarks=(*header.remarks, remark))
    table = _numbers(rows, line_numbers, header, path)
    _check_table(table, line_numbers, header, path)
    return Storage(header.name, header.columns, table[:, 0], table[:, 1:], header.in_degrees, header.remarks)


def read_storage_header(path: str | Path) -> StorageHeader:
    """Read only the header and the column labels, for files whose numbers are not needed.

    Raises
    ------
    InputError
        If the file is missing, empty, binary, or has no proper header.
    """
    path = Path(path)
    return _parse_header(_read_lines(path, limit=MAX_HEADER_LINES + 2), path)


def write_storage(path: str | Path, storage: Storage) -> None:
    """Write a ``.sto`` or ``.mot`` file that OpenSim opens, whole or not at all, without loss of digits.

    Raises
    ------
    ValueError
        If a label cannot stand in a tab-separated line, or the shapes disagree.
    """
    labels = ("time", *storage.columns)
    if storage.values.shape != (storage.time.size, len(storage.columns)):
        raise ValueError(f"values are {storage.values.shape}, not (frames, columns) of time and labels")
    unfit = [label for label in (storage.name, *labels) if re.search(r"[\t\r\n]", label) or not label.strip()]
    if unfit:
        raise ValueError(f"labels may be neither empty nor hold tabs or line breaks: {unfit!r}")
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
    """Read the lines of a text file, line ends removed; all of them or the first few."""
    content = read_content(path, "a .sto or .mot table", limit)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Titles typed on old systems; every byte is a letter there, so binary content is caught below.
        text = content.decode("latin-1")
    if _CONTROL_CHARACTER.search(text):
        raise InputError(
            Problem(str(path), "is binary, where a .sto or .mot table in plain text was expected")
        )
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _parse_header(lines: list[str], path: Path) -> StorageHeader:
    """Read what stands above the numbers; raises with everything wrong there."""
    problems: list[Problem] = []
    ends = [
        number for number, line in enumerate(lines[:MAX_HEADER_LINES]) if line.strip().lower() == "endheader"
    ]
    if not ends:
        raise InputError(
            Problem(
                str(path),
                "has no line 'endheader', where a .sto or .mot table was expected",
                hint=_kind(lines),
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
        remarks = (f"the header promises {column_count} columns, the labels name {len(labels)}",)
    if "" in labels:
        problems.append(Problem(str(path), f"column {labels.index('') + 1} has no label", place))
    twice = [label for label, count in Counter(labels).items() if count > 1 and label]
    problems += [
        Problem(str(path), "the column stands there more than once", f"column {label}") for label in twice
    ]
    if problems:
        raise InputError(problems)
    return StorageHeader(lines[0].strip(), tuple(labels[1:]), in_degrees, row_count, start + 1, remarks)


def _kind(lines: list[str]) -> str:
    """Guess what a file without a header is."""
    first = lines[0].lstrip()
    if first.startswith("<"):
        return "it looks like XML"
    if "," in first and "\t" not in first:
        return "it looks like a comma-separated file"
    return "is the file complete?"


def _count(keys: dict[str, str], names: tuple[str, ...], path: Path, problems: list[Problem]) -> int | None:
    for name in names:
        if name in keys:
            # Longer than any number of rows, and at some length more than Python turns into a number.
            if keys[name].isdecimal() and len(keys[name]) < 20:
                return int(keys[name])
            message = f"expected a whole number for {name}, found '{keys[name]}'"
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
    """Split the body into cells and say on which line of the file each row stands."""
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
            hint = "the file seems cut off there" if number == line_numbers[-1] else "; ".join(header.remarks)
            problems.append(Problem(str(path), message, f"line {number}", hint))
            break
    if header.row_count is not None and header.row_count != len(rows):
        message = f"the header promises {header.row_count} rows, found {len(rows)}"
        hint = "the file seems cut off" if len(rows) < header.row_count else ""
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
        # Not by NumPy: it gives every text the room of the longest.
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
        message = (
            f"expected finite numbers, found {table[row, column]} ({bad[:, column].sum()} such in the column)"
        )
        problems.append(Problem(str(path), message, f"line {line_numbers[row]}, column {label}"))
    if not bad[:, 0].any():
        backwards = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
        if backwards.size:
            row = int(backwards[0])
            message = f"expected time to increase, found {table[row + 1, 0]:g} s after {table[row, 0]:g} s"
            problems.append(Problem(str(path), message, f"line {line_numbers[row + 1]}, column time"))
    if problems:
        raise InputError(problems)


#: The last segment of a full path that says which quantity of a component a column holds.
_QUANTITIES = ("value", "activation", "excitation")


def find_column(columns: tuple[str, ...], name: str, suffixes: tuple[str, ...] = ("",)) -> list[int]:
    """Find the columns that hold a quantity of a component, by plain label or full path.

    Parameters
    ----------
    columns
        Labels of a file.
    name
        A component, such as ``hip_flexion_r``.
    suffixes
        What may follow the name in the label, such as ``("_moment",)``; earlier ones win.

    Returns
    -------
    list of int
        Positions of the columns that match: none, one, or several where the file is ambiguous.
        ``/jointset/hip_r/hip_flexion_r/value`` matches; ``.../speed`` does not.
    """
    for suffix in suffixes:
        wanted = name + suffix
        found = [place for place, label in enumerate(columns) if wanted in (label, component_name(label))]
        if found:
            return found
    return []


def component_name(label: str) -> str:
    """Name the component that a column label is about: ``hip_flexion_r`` for its full path.

    Returns the label itself where it is a plain name or holds another quantity (``.../speed``).
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
