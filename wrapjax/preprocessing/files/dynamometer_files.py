"""Tables of a dynamometer: comma-separated text (``.csv``), and variables of MATLAB (``.mat``)."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content

#: Largest file, bytes.
MAX_BYTES = 256 << 20
_DELIMITERS = ",;\t"


def read_device_columns(file: Path, names: tuple[str, ...]) -> Float[np.ndarray, "name sample"]:
    """Read columns of a dynamometer's file.

    Parameters
    ----------
    file
        ``.csv`` with a line of names, separated by commas, semicolons or tabs, or ``.mat`` of a version
        before 7.3.
    names
        Names of the columns, or of the variables; ``trial.torque`` is field ``torque`` of variable ``trial``.

    Returns
    -------
    Float[np.ndarray, "name sample"]
        The columns, in the order of the names.

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing, not a number or of another length.
    """
    if file.suffix.lower() == ".mat":
        columns = _matlab_variables(file, names)
    else:
        columns = _text_columns(file, names)
    lengths = {name: len(column) for name, column in zip(names, columns, strict=True)}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {count}" for name, count in lengths.items())
        raise InputError(Problem(str(file), f"expected columns of equal length, found {shown} samples"))
    for name, column in zip(names, columns, strict=True):
        missing = np.flatnonzero(~np.isfinite(column))
        if missing.size:
            message = f"expected numbers, found none in sample {missing[0] + 1}"
            raise InputError(Problem(str(file), message, f"column {name}"))
    return np.array(columns)


def _text_columns(file: Path, names: tuple[str, ...]) -> list[Float[np.ndarray, " sample"]]:
    try:
        text = read_content(file, "comma-separated text", max_bytes=MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(Problem(str(file), "expected text (.csv) or MATLAB's .mat, found neither")) from None
    first = text.split("\n", 1)[0]
    delimiter = max(_DELIMITERS, key=first.count)
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if any(row)]
    if len(rows) < 3:
        raise InputError(
            Problem(str(file), f"expected a line of names and two samples, found {len(rows)} lines")
        )
    header = [name.strip() for name in rows[0]]
    columns = []
    for name in names:
        if name not in header:
            hint = nearest_name(name, tuple(header))
            raise InputError(Problem(str(file), "is not in the file", f"column {name}", hint))
        place = header.index(name)
        columns.append([row[place].strip() if place < len(row) else "" for row in rows[1:]])
    return [_numbers(file, name, column, delimiter) for name, column in zip(names, columns, strict=True)]


def _numbers(file: Path, name: str, column: list[str], delimiter: str) -> Float[np.ndarray, " sample"]:
    """Convert a column; with another delimiter, a comma separates decimals."""
    values = np.full(len(column), np.nan)
    for place, entry in enumerate(column):
        try:
            values[place] = float(entry if delimiter == "," else entry.replace(",", "."))
        except ValueError:
            if entry:
                message = f"expected a number in line {place + 2}, found '{entry[:40]}'"
                raise InputError(Problem(str(file), message, f"column {name}")) from None
    return values


def _matlab_variables(file: Path, names: tuple[str, ...]) -> list[Float[np.ndarray, " sample"]]:
    from scipy.io import loadmat

    content = read_content(file, "MATLAB's .mat", max_bytes=MAX_BYTES)
    try:
        variables = loadmat(io.BytesIO(content), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        message = "was saved by MATLAB in version 7.3, which is not read"
        raise InputError(Problem(str(file), message, hint="save it with '-v7'")) from None
    # Damaged files raise nearly anything.
    except Exception as error:
        raise InputError(Problem(str(file), f"is no MATLAB file, or a damaged one ({error})")) from None
    return [_variable(file, variables, name) for name in names]


def _variable(file: Path, variables: dict[str, Any], name: str) -> Float[np.ndarray, " sample"]:
    found: Any = variables
    known: tuple[str, ...] = ()
    for part in name.split("."):
        known = tuple(found if isinstance(found, dict) else getattr(found, "_fieldnames", ()))
        if part not in known:
            visible = tuple(one for one in known if not one.startswith("__"))
            hint = nearest_name(part, visible)
            raise InputError(Problem(str(file), "is not in the file", f"variable {name}", hint))
        found = found[part] if isinstance(found, dict) else getattr(found, part)
    values = np.asarray(found)
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        shown = f"an array of {values.dtype} with {values.ndim} axes"
        raise InputError(
            Problem(str(file), f"expected one column of numbers, found {shown}", f"variable {name}")
        )
    return values.astype(float)
