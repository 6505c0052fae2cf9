"""Recorded markers: ``.trc`` files read strictly and written whole, gaps and filters."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content, write_text
from wrapjax.preprocessing.filters import low_pass

#: Meters in each unit of length that files name.
METERS = {"m": 1.0, "meters": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "millimeters": 0.001}
#: Gaps up to this, in s, are bridged by a spline; in longer ones the marker is not followed.
LONGEST_GAP = 0.15
#: Extent of all markers of a person in m, head to foot or toe to heel.
LEAST_EXTENT, MOST_EXTENT = 0.3, 4.0


@dataclass(frozen=True)
class Markers:
    """Markers over time.

    Parameters
    ----------
    names
        Labels.
    time
        s, even.
    positions
        m, in the axes of the file; NaN where a marker was not seen.
    """

    names: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    positions: Float[np.ndarray, "marker frame 3"]

    @property
    def rate(self) -> float:
        """Frames a second."""
        return float((self.time.size - 1) / (self.time[-1] - self.time[0]))

    def select(self, names: tuple[str, ...]) -> Markers:
        """Keep some markers, in the order given."""
        rows = [self.names.index(name) for name in names]
        return replace(self, names=names, positions=self.positions[rows])

    def turned(self, rotation: Float[np.ndarray, "3 3"]) -> Markers:
        """Give positions in other axes, the rows of ``rotation``."""
        return replace(self, positions=self.positions @ rotation.T)

    def during(self, start: float, end: float) -> Markers:
        """Keep frames from ``start`` to ``end`` in s."""
        kept = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        return replace(self, time=self.time[kept], positions=self.positions[:, kept])

    def filtered(self, cutoff_hz: float) -> Markers:
        """Bridge short gaps and filter low-pass; where a gap is longer than `LONGEST_GAP`, NaN stays."""
        positions = np.array([_filtered(self.time, path, cutoff_hz) for path in self.positions])
        return replace(self, positions=positions)


def _filtered(
    time: Float[np.ndarray, " frame"], path: Float[np.ndarray, "frame 3"], cutoff_hz: float
) -> Float[np.ndarray, "frame 3"]:
    seen = np.isfinite(path).all(axis=1)
    if seen.sum() < 2:
        return np.full_like(path, np.nan)
    inside = np.clip(time, time[seen][0], time[seen][-1])
    bridged = CubicSpline(time[seen], path[seen])(inside)
    smooth = low_pass(time, bridged.T, cutoff_hz).T
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]]).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        at_end = first == 0 or last == time.size
        if at_end or time[last] - time[first - 1] > LONGEST_GAP:
            smooth[first:last] = np.nan
    return smooth


def read_trc(path: Path) -> Markers:
    """Read a ``.trc`` file.

    Returns
    -------
    Markers
        In m. Empty cells are markers not seen.

    Raises
    ------
    InputError
        With everything wrong: missing, binary, cut off, without labels, in an unknown unit, not numeric,
        time going backwards, a label twice.
    """
    lines = _lines(path)
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        message = "has no first line 'PathFileType', where a .trc file of markers was expected"
        raise InputError(Problem(str(path), message))
    keys = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    unit = keys.get("Units", "").strip().lower()
    if unit not in METERS:
        message = f"expected {', '.join(METERS)} as Units, found '{unit}'"
        raise InputError(Problem(str(path), message, "line 3"))
    labels = lines[3].rstrip().split("\t")
    names = tuple(label.strip().rsplit(":", 1)[-1] for label in labels[2::3])
    twice = [name for name, count in Counter(names).items() if count > 1]
    if not names or "" in names or twice:
        found = f"'{twice[0]}' twice" if twice else "none" if not names else "one that is empty"
        raise InputError(Problem(str(path), f"expected a label for each marker, found {found}", "line 4"))
    rows = [(number, line) for number, line in enumerate(lines[5:], start=6) if line.strip()]
    width = 2 + 3 * len(names)
    table = np.array([_row(line, width, number, path) for number, line in rows]).reshape(-1, width)
    promised = keys.get("NumFrames", "").strip()
    if promised.isdecimal() and (promised.lstrip("0") or "0") != str(len(rows)):
        message = f"the header promises {promised} frames, found {len(rows)}"
        raise InputError(Problem(str(path), message, hint="the file seems cut off"))
    return checked(
        Markers(
            names,
            table[:, 1],
            np.moveaxis(table[:, 2:].reshape(len(rows), len(names), 3), 0, 1) * METERS[unit],
        ),
        path,
    )


def _lines(path: Path) -> list[str]:
    try:
        return read_content(path, "a .trc file of markers").decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        message = "is binary, where a .trc file of markers in plain text was expected"
        raise InputError(Problem(str(path), message)) from None


def _row(line: str, count: int, number: int, path: Path) -> list[float]:
    """Read a frame; cells that are empty, or missing at its end, are markers not seen."""
    cells = line.rstrip("\r\n").split("\t")
    # Many programs end each line by a tab.
    cells = (cells + [""] * count)[:count] if not any(cell.strip() for cell in cells[count:]) else cells
    try:
        values = [float(cell) if cell.strip() else np.nan for cell in cells]
    except ValueError as error:
        raise InputError(Problem(str(path), f"expected numbers ({error})", f"line {number}")) from None
    if len(values) != count:
        message = f"expected {count} numbers, found {len(values)}"
        raise InputError(Problem(str(path), message, f"line {number}"))
    return values


def checked(markers: Markers, path: Path) -> Markers:
    """Check what no file of a walking person may have, and return the markers.

    Raises
    ------
    InputError
        If there are too few frames, time does not increase evenly, or markers are no person's.
    """
    problems = []
    step = np.diff(markers.time)
    if markers.time.size < 10 or not np.isfinite(markers.time).all() or (step <= 0.0).any():
        message = f"expected at least 10 frames in order of time, found {markers.time.size}"
        raise InputError(Problem(str(path), message, "Time"))
    if step.max() > 1.5 * np.median(step):
        at = markers.time[int(np.argmax(step))]
        message = (
            f"expected even frames {np.median(step):.4g} s apart, found {step.max():.4g} s after {at:g} s"
        )
        problems.append(Problem(str(path), message, "Time"))
    lost = np.isinf(markers.positions).any(axis=(1, 2))
    if lost.any():
        label = markers.names[int(np.argmax(lost))]
        problems.append(Problem(str(path), "expected finite positions, found infinity", f"marker {label}"))
    seen = markers.positions[:, np.isfinite(markers.positions).all(axis=(0, 2))]
    if seen.size:
        spread = float(np.median(np.ptp(seen, axis=0).max(axis=-1)))
        if not LEAST_EXTENT <= spread <= MOST_EXTENT:
            message = f"expected markers {LEAST_EXTENT:g} to {MOST_EXTENT:g} m apart, found {spread:.4g} m"
            hint = "is the unit of length in the file the one that its numbers are in?"
            problems.append(Problem(str(path), message, "Units", hint))
    if problems:
        raise InputError(problems)
    return markers


def write_trc(path: Path, markers: Markers) -> None:
    """Write a ``.trc`` file in m that OpenSim opens, whole or not at all; NaN becomes empty cells."""
    count, rate = markers.time.size, repr(markers.rate)
    numbered = "\t".join(f"{axis}{order}" for order in range(1, len(markers.names) + 1) for axis in "XYZ")
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{count}\t{len(markers.names)}\tm\t{rate}\t1\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(markers.names) + "\t\t",
        "\t\t" + numbered,
        "",
    ]
    table = np.moveaxis(markers.positions, 0, 1).reshape(count, -1)
    body = [
        "\t".join([str(order), repr(at), *("" if np.isnan(cell) else repr(cell) for cell in row)])
        for order, (at, row) in enumerate(zip(markers.time.tolist(), table.tolist(), strict=True), start=1)
    ]
    write_text(path, "\n".join([*head, *body]) + "\n")


def follow(
    markers: Markers, model_markers: tuple[str, ...], ignored: tuple[str, ...], path: Path
) -> tuple[str, ...]:
    """Name the markers that the model has and the recording shows.

    Raises
    ------
    InputError
        If fewer than three are in both.
    """
    both = tuple(name for name in model_markers if name in markers.names and name not in ignored)
    if len(both) < 3:
        stranger = next((name for name in markers.names if name not in model_markers), "")
        message = f"expected the model's markers, found {len(both)} of {len(model_markers)}"
        raise InputError(Problem(str(path), message, hint=nearest_name(stranger, model_markers)))
    return both
