"""Marker trajectories: reading and writing of ``.trc`` files, checks, gap filling and filtering."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.files import read_content, write_text

#: Meters in each unit of length that files may name.
METERS_PER_UNIT = {"m": 1.0, "meters": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "millimeters": 0.001}
#: Longest gap of a marker that is filled by a spline, s; inverse kinematics does not use the marker in longer
#: ones.
MAX_GAP = 0.15
#: Limits of the extent of all markers of a person, m, which reveal a wrong unit of length.
MIN_EXTENT, MAX_EXTENT = 0.3, 4.0
#: Cut-off frequency of motion and forces times the gait period (Ao, Fregly et al.).
MOTION_HARMONIC = 7.0
#: Order of the Butterworth filter. Run forwards and backwards (zero lag) it has the fourth order that is
#: usual in gait laboratories.
FILTER_ORDER = 2


@dataclass(frozen=True)
class Markers:
    """Marker trajectories.

    Parameters
    ----------
    names
        Names of the markers.
    time
        Times of the frames, s, evenly spaced.
    positions
        Positions, m, in the axes of the file; NaN where a marker was not visible.
    """

    names: tuple[str, ...]
    time: Float[np.ndarray, " frame"]
    positions: Float[np.ndarray, "marker frame 3"]

    @property
    def rate(self) -> float:
        """Frame rate, Hz."""
        return float((self.time.size - 1) / (self.time[-1] - self.time[0]))

    def select(self, names: tuple[str, ...]) -> Markers:
        """Select some of the markers, in the order given."""
        rows = [self.names.index(name) for name in names]
        return replace(self, names=names, positions=self.positions[rows])

    def rotated(self, rotation: Float[np.ndarray, "3 3"]) -> Markers:
        """Rotate the positions into the axes that are the rows of ``rotation``."""
        return replace(self, positions=self.positions @ rotation.T)

    def during(self, start: float, end: float) -> Markers:
        """Select the frames from ``start`` to ``end``, s."""
        selected = (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        return replace(self, time=self.time[selected], positions=self.positions[:, selected])

    def filtered(self, cutoff_hz: float) -> Markers:
        """Fill short gaps and apply the low-pass filter; gaps longer than `MAX_GAP` remain NaN."""
        positions = np.array([_filter_marker(self.time, path, cutoff_hz) for path in self.positions])
        return replace(self, positions=positions)


def _filter_marker(
    time: Float[np.ndarray, " frame"], path: Float[np.ndarray, "frame 3"], cutoff_hz: float
) -> Float[np.ndarray, "frame 3"]:
    visible = np.isfinite(path).all(axis=1)
    if visible.sum() < 2:
        return np.full_like(path, np.nan)
    inside = np.clip(time, time[visible][0], time[visible][-1])
    filled = CubicSpline(time[visible], path[visible])(inside)
    smooth = low_pass(time, filled.T, cutoff_hz).T
    edges = np.flatnonzero(np.diff(np.concatenate([[True], visible, [True]]).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        at_end = first == 0 or last == time.size
        if at_end or time[last] - time[first - 1] > MAX_GAP:
            smooth[first:last] = np.nan
    return smooth


def read_trc(path: Path) -> Markers:
    """Read a ``.trc`` file.

    Returns
    -------
    Markers
        Trajectories in m; an empty cell means that the marker was not visible.

    Raises
    ------
    InputError
        With the faults of the file: missing, binary, truncated, without labels, in an unknown unit, not
        numeric, time not increasing, duplicate labels.
    """
    lines = _lines(path)
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        message = "does not begin with 'PathFileType', where a .trc file of markers was expected"
        raise InputError(Problem(str(path), message))
    keys = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    if keys.get("Units", "").strip().lower() not in METERS_PER_UNIT:
        # Some programs put several tabs and spaces between the values.
        keys = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    unit = keys.get("Units", "").strip().lower()
    if unit not in METERS_PER_UNIT:
        message = f"expected {', '.join(METERS_PER_UNIT)} as Units, found '{unit}'"
        raise InputError(Problem(str(path), message, "line 3"))
    labels = lines[3].rstrip().split("\t")
    names = tuple(label.strip().rsplit(":", 1)[-1] for label in labels[2::3])
    duplicates = [name for name, count in Counter(names).items() if count > 1]
    if not names or "" in names or duplicates:
        found = f"'{duplicates[0]}' twice" if duplicates else "none" if not names else "an empty one"
        raise InputError(Problem(str(path), f"expected a label for each marker, found {found}", "line 4"))
    rows = [(number, line) for number, line in enumerate(lines[5:], start=6) if line.strip()]
    width = 2 + 3 * len(names)
    table = np.array([_row(line, width, number, path) for number, line in rows]).reshape(-1, width)
    stated = keys.get("NumFrames", "").strip()
    if stated.isdecimal() and (stated.lstrip("0") or "0") != str(len(rows)):
        message = f"the header states {stated} frames, found {len(rows)}"
        raise InputError(Problem(str(path), message, hint="the file seems to be truncated"))
    return check_markers(
        Markers(
            names,
            table[:, 1],
            np.moveaxis(table[:, 2:].reshape(len(rows), len(names), 3), 0, 1) * METERS_PER_UNIT[unit],
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
    """Read the numbers of a frame; empty cells, and cells missing at its end, become NaN (not visible)."""
    cells = line.rstrip("\r\n").split("\t")
    # Many programs end each line with a tab.
    cells = (cells + [""] * count)[:count] if not any(cell.strip() for cell in cells[count:]) else cells
    try:
        values = [float(cell) if cell.strip() else np.nan for cell in cells]
    except ValueError as error:
        raise InputError(Problem(str(path), f"expected numbers ({error})", f"line {number}")) from None
    if len(values) != count:
        message = f"expected {count} numbers, found {len(values)}"
        raise InputError(Problem(str(path), message, f"line {number}"))
    return values


def check_markers(markers: Markers, path: Path) -> Markers:
    """Check the times and positions of markers, and return the markers.

    Raises
    ------
    InputError
        If there are too few frames, time does not increase evenly, a position is infinite, or the extent of
        the markers is not that of a person.
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
    infinite = np.isinf(markers.positions).any(axis=(1, 2))
    if infinite.any():
        label = markers.names[int(np.argmax(infinite))]
        problems.append(Problem(str(path), "expected finite positions, found infinity", f"marker {label}"))
    complete_frames = markers.positions[:, np.isfinite(markers.positions).all(axis=(0, 2))]
    if complete_frames.size:
        extent = float(np.median(np.ptp(complete_frames, axis=0).max(axis=-1)))
        if not MIN_EXTENT <= extent <= MAX_EXTENT:
            message = f"expected an extent of all markers of {MIN_EXTENT:g} to {MAX_EXTENT:g} m"
            message = f"{message}, found {extent:.4g} m"
            hint = "is the unit of length stated in the file that of its numbers?"
            problems.append(Problem(str(path), message, "Units", hint))
    if problems:
        raise InputError(problems)
    return markers


def write_trc(path: Path, markers: Markers) -> None:
    """Write a ``.trc`` file in m for OpenSim atomically; NaN becomes empty cells."""
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


def match_markers(
    markers: Markers, model_markers: tuple[str, ...], ignored: tuple[str, ...], path: Path
) -> tuple[str, ...]:
    """Find the markers of the model that were recorded, without the ignored ones.

    Raises
    ------
    InputError
        If there are fewer than three.
    """
    common = tuple(name for name in model_markers if name in markers.names and name not in ignored)
    if len(common) < 3:
        unknown = next((name for name in markers.names if name not in model_markers), "")
        message = f"expected the model's markers, found {len(common)} of {len(model_markers)}"
        raise InputError(Problem(str(path), message, hint=nearest_name(unknown, model_markers)))
    return common


def low_pass(
    time: Float[np.ndarray, " frame"], values: Float[np.ndarray, "channel frame"], cutoff_hz: float
) -> Float[np.ndarray, "channel frame"]:
    """Filter motion or forces by a zero-lag low-pass Butterworth filter of fourth order.

    Parameters
    ----------
    time
        Times, s, evenly spaced.
    values
        Finite values of each channel.
    cutoff_hz
        Cut-off frequency, Hz. At or above half the sampling rate, the values are returned unchanged.

    Returns
    -------
    Float[np.ndarray, "channel frame"]
        Filtered values.
    """
    rate = (time.size - 1) / (time[-1] - time[0])
    if cutoff_hz >= 0.5 * rate:
        return values
    sections = butter(FILTER_ORDER, cutoff_hz, "lowpass", fs=rate, output="sos")
    # Signals are extended at both ends by a period of the cut-off frequency, as forces can start in
    # mid-stance.
    padding = min(round(rate / cutoff_hz), time.size - 1)
    return sosfiltfilt(sections, values, axis=1, padlen=padding)
