"""Checks for incomplete and remaining files, and comparison of all numbers of two results."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from wrapjax.errors import InputError
from wrapjax.io.files import PART_SUFFIX
from wrapjax.io.json_and_arrays import load_arrays
from wrapjax.io.storage import read_storage

#: Entries that differ between any two runs: dates, durations, folders.
_RUN_SPECIFIC = {"seconds", "date", "folder", "model_file", "other_leg", "question"}


def incomplete_files(place: Path) -> list[str]:
    """List incomplete files except temporary ones; includes checkpoints and cache."""
    faults = []
    for file in _visible(place):
        try:
            _content(file)
        except (ValueError, InputError) as error:
            faults.append(f"{file.relative_to(place)} is incomplete: {error}")
    return faults


def remaining_files(place: Path) -> list[str]:
    """List files beside the result, and hidden files in it."""
    beside = [path for path in place.iterdir() if path.name not in ("out", "cache")]
    hidden = [path for path in (place / "out").rglob(".*")]
    return sorted(str(path.relative_to(place)) for path in (*beside, *hidden))


def largest_difference(expected: Path, found: Path) -> tuple[float, str]:
    """Compare all numbers of two results.

    Returns
    -------
    float, str
        The largest relative difference, and a description of any other difference; empty if there is none.
    """
    names = [sorted(str(path.relative_to(one)) for path in _visible(one)) for one in (expected, found)]
    if names[0] != names[1]:
        return math.inf, f"files {sorted(set(names[0]) ^ set(names[1]))} are in only one of the results"
    largest = 0.0
    for name in names[0]:
        try:
            largest = max(largest, _difference(_content(expected / name), _content(found / name)))
        except ValueError as error:
            return math.inf, f"{name}: {error}"
    return largest, ""


def _visible(place: Path) -> Iterator[Path]:
    """Iterate over files that are neither temporary nor compiled programs."""
    for path in sorted(place.rglob("*")):
        parts = path.relative_to(place).parts
        temporary = any(part.startswith(".") and PART_SUFFIX in part for part in parts)
        if path.is_file() and not temporary and "compiled" not in parts and not path.name.endswith(".lock"):
            yield path


def _content(file: Path) -> Any:
    """Read a complete file as nested containers of numbers and texts."""
    if file.suffix == ".json":
        return json.loads(file.read_text(encoding="utf-8"))
    if file.suffix == ".npz":
        return load_arrays(file)
    if file.suffix == ".npy":
        return np.load(file, allow_pickle=False)
    if file.suffix == ".sto":
        table = read_storage(file)
        return {"columns": list(table.columns), "time": table.time, "values": table.values}
    if file.suffix == ".csv":
        return [list(map(_number, row)) for row in csv.reader(file.read_text(encoding="utf-8").splitlines())]
    if file.suffix == ".html" and not file.read_text(encoding="utf-8").rstrip().endswith("</html>"):
        raise ValueError("no closing tag")
    return None


def _number(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def _difference(one: Any, other: Any) -> float:
    """Compute the largest relative difference of numbers; raise ValueError if anything else differs."""
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            raise ValueError(f"keys {sorted(one.keys() ^ other.keys())} are in only one of the results")
        return max(
            (_difference(one[key], other[key]) for key in one if key not in _RUN_SPECIFIC), default=0.0
        )
    if isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            raise ValueError(f"{len(one)} entries, expected {len(other)}")
        return max(map(_difference, one, other), default=0.0)
    if isinstance(one, np.ndarray) and one.dtype.kind in "fc":
        if one.shape != other.shape:
            raise ValueError(f"shape {other.shape} in place of {one.shape}")
        scale = np.maximum(np.abs(one), np.abs(other))
        off = np.abs(one - other) / np.where(scale > 0.0, scale, 1.0)
        return float(
            np.max(np.where((one == other) | (np.isnan(one) & np.isnan(other)), 0.0, off), initial=0.0)
        )
    if isinstance(one, np.ndarray):
        return 0.0 if np.array_equal(one, other) else math.inf
    if isinstance(one, float) and isinstance(other, float) and one != other and not math.isnan(one):
        return abs(one - other) / max(abs(one), abs(other))
    if one != other and not (isinstance(one, float) and math.isnan(one)):
        raise ValueError(f"{other!r} in place of {one!r}")
    return 0.0
