"""What OpenSim's tools have in common: they talk, they read and write files, and they fail in C++."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.osim.loading import failure_reason, import_opensim


@contextmanager
def running(tool: str, file: Path | str) -> Iterator[Path]:
    """Run one of OpenSim's tools: yields a folder for its files, which is gone afterwards.

    Parameters
    ----------
    tool
        What runs, in words, for the message.
    file
        The file to name if it fails.

    Raises
    ------
    InputError
        If OpenSim gives up.
    """
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        try:
            with _silent():
                yield Path(folder)
        except RuntimeError as error:
            message = f"OpenSim's {tool} stopped ({failure_reason(error)})"
            raise InputError(Problem(str(file), message)) from error


@contextmanager
def _silent() -> Iterator[None]:
    """Drop what OpenSim prints past its logger, straight to the process's standard output."""
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def read_table(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, " frame"], np.ndarray]:
    """Read a table that a tool has written: labels, time in s, values (frame, column) in its own units."""
    table = import_opensim().TimeSeriesTable(str(path))
    return (
        tuple(table.getColumnLabels()),
        np.array(table.getIndependentColumn()),
        table.getMatrix().to_numpy(),
    )


def write_table(
    path: Path,
    names: Sequence[str],
    time: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, "column frame"],
) -> None:
    """Write a table in SI units and radians for a tool to read."""
    opensim = import_opensim()
    table = opensim.TimeSeriesTable(time.tolist(), opensim.Matrix.createFromMat(values.T.copy()), list(names))
    table.addTableMetaDataString("inDegrees", "no")
    opensim.STOFileAdapter.write(table, str(path))


def string_array(names: Sequence[str]) -> Any:
    """Make an OpenSim array of strings."""
    array = import_opensim().ArrayStr()
    for name in names:
        array.append(name)
    return array
