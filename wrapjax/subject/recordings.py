"""The signals of one trial, read from its files and checked against the subject's settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem, nearest_name
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import Storage, component_name, find_column
from wrapjax.io.toml import collecting
from wrapjax.subject.external_loads import check_ground_loads
from wrapjax.subject.settings import Settings, TrialSettings
from wrapjax.subject.trials import TIME_TOLERANCE

#: Samples a cycle must hold, and so the longest gap: with fewer, the shape of a gait cycle is guessed.
MIN_SAMPLES = 20
#: Largest amplitude in a file marked as degrees that is taken for radians, about 143 degrees.
LARGEST_IF_RADIANS = 2.5
#: Moments per body mass in N m/kg. Walking peaks near 2 and running near 4; anything above the first limit is
#: another unit (N mm) or a failed inverse dynamics, and anything below the second was divided by the mass.
MOST_MOMENT_PER_MASS = 10.0
LEAST_MOMENT_PER_MASS = 0.05
#: Envelopes are normalised to about 1. Above this they are in percent or microvolts.
MOST_ENVELOPE = 10.0
#: Raw EMG needs at least this rate in Hz: its power reaches beyond 100 Hz.
LEAST_RAW_RATE = 200.0

Reader = Callable[[Path], Storage]


@dataclass(frozen=True)
class Signals:
    """The signals of a trial at their own rates, in SI units and radians.

    Parameters
    ----------
    trial
        The settings they belong to.
    coordinates
        Coordinates of the model found in the angle file, in the model's order.
    angle_time, angles
        s; rad or m.
    moment_time, moments
        s; N m, in the order of the settings' coordinates.
    emg_time, emg
        s; as recorded, in the order of the settings' channels.
    """

    trial: TrialSettings
    coordinates: tuple[str, ...]
    angle_time: Float[np.ndarray, " angle_sample"]
    angles: Float[np.ndarray, "coordinate angle_sample"]
    moment_time: Float[np.ndarray, " moment_sample"]
    moments: Float[np.ndarray, "moment_coordinate moment_sample"]
    emg_time: Float[np.ndarray, " emg_sample"]
    emg: Float[np.ndarray, "channel emg_sample"]


def read_signals(
    trial: TrialSettings,
    settings: Settings,
    model_coordinates: tuple[CoordinateInfo, ...],
    read: Reader,
    problems: list[Problem],
    notes: list[str],
) -> Signals | None:
    """Read and check the signals of a trial, adding everything wrong to ``problems``.

    Parameters
    ----------
    trial, settings
        What the subject's settings say.
    model_coordinates
        All coordinates of the model; empty where it could not be read, and then angles are not checked.
    read
        Reads a table; trials often share files, so that it pays to remember them.
    problems, notes
        Lists to add to.

    Returns
    -------
    Signals or None
        None where anything is missing.
    """
    # Only later steps use them: it is enough to know that they can.
    check_ground_loads(trial, problems)
    tables = {}
    for kind, path in (("angles", trial.angles), ("moments", trial.moments), ("emg", trial.emg)):
        with collecting(problems):
            tables[kind] = read(path)
            notes.extend(f"{path}: {remark}" for remark in tables[kind].remarks)
            _check_cycles(trial, path, tables[kind].time, problems)
    by_name = {info.name: info for info in model_coordinates}
    wanted = [by_name[name] for name in settings.coordinates if name in by_name]
    columns: dict[str, np.ndarray | None] = {}
    if "angles" in tables:
        names = tuple(info.name for info in wanted)
        columns["angles"] = _columns(tables["angles"], names, ("",), trial.angles, problems)
        check_angle_unit(tables["angles"], wanted, trial.angles, problems)
    if "moments" in tables:
        # A coordinate that the model lacks has been reported; its column need not be missed as well.
        expected = tuple(info.name for info in wanted) if model_coordinates else settings.coordinates
        moment_columns = _columns(
            tables["moments"], expected, ("_moment", "_force", ""), trial.moments, problems
        )
        columns["moments"] = moment_columns
        if moment_columns is not None:
            _check_moments(moment_columns, expected, settings.mass_kg, trial.moments, problems)
    if "emg" in tables:
        columns["emg"] = _columns(tables["emg"], tuple(settings.channels), ("",), trial.emg, problems)
        if columns["emg"] is not None:
            _check_emg(tables["emg"].time, columns["emg"], settings, trial, problems)
    found = {kind: values for kind, values in columns.items() if values is not None}
    if len(found) < 3:
        return None
    coordinates, angles = all_angles(tables["angles"], model_coordinates)
    return Signals(
        trial=trial,
        coordinates=coordinates,
        angle_time=tables["angles"].time,
        angles=angles,
        moment_time=tables["moments"].time,
        moments=found["moments"],
        emg_time=tables["emg"].time,
        emg=found["emg"],
    )


def _columns(
    table: Storage, names: tuple[str, ...], suffixes: tuple[str, ...], path: Path, problems: list[Problem]
) -> Float[np.ndarray, "column sample"] | None:
    """Take the columns of these names, None where one is missing or ambiguous."""
    places = []
    for name in names:
        found = find_column(table.columns, name, suffixes)
        expected = name + suffixes[0]
        if len(found) == 1:
            places.append(found[0])
        elif found:
            labels = ", ".join(table.columns[place] for place in found)
            problems.append(
                Problem(str(path), f"expected one column, found several: {labels}", f"column {expected}")
            )
        else:
            known = tuple(component_name(label) for label in table.columns)
            problems.append(
                Problem(str(path), "is not in the file", f"column {expected}", nearest_name(expected, known))
            )
    return table.values.T[places] if len(places) == len(names) else None


def _check_cycles(
    trial: TrialSettings, path: Path, time: Float[np.ndarray, " sample"], problems: list[Problem]
) -> None:
    """Report cycles that the recording does not cover, or covers with too few samples."""
    for order, (start, end) in enumerate(trial.cycles, start=1):
        place = f"trial '{trial.name}', cycle {order} [{start:g}, {end:g}] s"
        if start < time[0] - TIME_TOLERANCE or end > time[-1] + TIME_TOLERANCE:
            message = f"the cycle lies outside the recording, which spans {time[0]:g} to {time[-1]:g} s"
            problems.append(Problem(str(path), message, place))
            continue
        first = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
        last = int(np.searchsorted(time, end, side="left"))
        steps = np.diff(time[first : last + 1])
        longest = (end - start) / MIN_SAMPLES
        if steps.max() > longest * (1.0 + 1e-9):
            gap = time[first + int(np.argmax(steps))]
            found = f"found none for {steps.max():.3g} s after {gap:g} s"
            message = f"expected a sample at least every {longest:.3g} s, {found}"
            problems.append(Problem(str(path), message, place))


def check_angle_unit(
    table: Storage, wanted: list[CoordinateInfo], path: Path, problems: list[Problem]
) -> None:
    """Report degrees taken for radians, and radians taken for degrees."""
    peaks = {}
    for info in wanted:
        found = find_column(table.columns, info.name)
        if info.motion_type == "rotational" and len(found) == 1:
            peaks[info.name] = float(np.abs(table.values[:, found[0]]).max())
    unit, turn, other = (
        ("degrees", 360.0, "radians") if table.in_degrees else ("radians", 2.0 * np.pi, "degrees")
    )
    for name, peak in peaks.items():
        if peak > turn:
            message = f"found {peak:.4g} {unit}, more than a full turn"
            hint = (
                "are the angles in degrees? Then write inDegrees=yes in the header"
                if unit == "radians"
                else ""
            )
            problems.append(Problem(str(path), message, f"column {name}", hint))
    large_in_gait = any("hip" in name or "knee" in name for name in peaks)
    if table.in_degrees and large_in_gait and max(peaks.values()) <= LARGEST_IF_RADIANS:
        message = f"no angle exceeds {max(peaks.values()):.3g} degrees, which looks like {other}"
        hint = "if the angles are in radians, write inDegrees=no in the header"
        problems.append(Problem(str(path), message, f"columns {', '.join(peaks)}", hint))


def all_angles(
    table: Storage, model_coordinates: tuple[CoordinateInfo, ...]
) -> tuple[tuple[str, ...], Float[np.ndarray, "coordinate sample"]]:
    """Take every coordinate of the model that the file holds, in rad or m.

    As in OpenSim, degrees concern rotational coordinates only, not coupled ones.
    """
    names = []
    series = []
    for info in model_coordinates:
        found = find_column(table.columns, info.name)
        if len(found) == 1:
            values = table.values[:, found[0]]
            names.append(info.name)
            series.append(
                np.deg2rad(values) if table.in_degrees and info.motion_type == "rotational" else values
            )
    return tuple(names), np.array(series).reshape(len(names), table.time.size)


def _check_moments(
    moments: Float[np.ndarray, "moment_coordinate sample"],
    names: tuple[str, ...],
    mass_kg: float,
    path: Path,
    problems: list[Problem],
) -> None:
    """Report moments that are all zero, or in another unit."""
    peaks = np.abs(moments).max(axis=1)
    for name, peak in zip(names, peaks, strict=True):
        if peak == 0.0:
            problems.append(
                Problem(str(path), "expected joint moments, found zero throughout", f"column {name}_moment")
            )
        elif peak > MOST_MOMENT_PER_MASS * mass_kg:
            message = (
                f"expected N m, found {peak:.4g}, more than {MOST_MOMENT_PER_MASS:g} N m per kg of body mass"
            )
            problems.append(Problem(str(path), message, f"column {name}_moment", "are the moments in N mm?"))
    if peaks.size and 0.0 < peaks.max() < LEAST_MOMENT_PER_MASS * mass_kg:
        message = f"expected N m, found no moment above {peaks.max():.3g}"
        problems.append(Problem(str(path), message, hint="are the moments divided by body mass?"))


def _check_emg(
    time: Float[np.ndarray, " sample"],
    emg: Float[np.ndarray, "channel sample"],
    settings: Settings,
    trial: TrialSettings,
    problems: list[Problem],
) -> None:
    """Report raw EMG taken for envelopes, envelopes taken for raw EMG, and EMG that is none."""
    path = trial.emg
    if settings.emg_kind == "raw":
        rate = (time.size - 1) / (time[-1] - time[0])
        if rate < LEAST_RAW_RATE:
            message = f"expected raw EMG at {LEAST_RAW_RATE:g} Hz or more, found {rate:.4g} Hz"
            problems.append(
                Problem(str(path), message, hint='are these envelopes? Then write kind = "envelope"')
            )
    if not np.ptp(emg, axis=1).any():
        problems.append(Problem(str(path), "expected EMG, found every channel constant"))
    for channel, signal in zip(settings.channels, emg, strict=True):
        place = f"column {channel}"
        if settings.emg_kind == "envelope":
            if signal.min() < -0.5 * signal.max() and signal.mean() < 0.2 * signal.std():
                message = f"expected an envelope, found values from {signal.min():.3g} to {signal.max():.3g}"
                problems.append(
                    Problem(str(path), message, place, 'is this raw EMG? Then write kind = "raw"')
                )
            elif signal.max() > MOST_ENVELOPE:
                message = f"expected an envelope normalised to about 1, found a peak of {signal.max():.4g}"
                problems.append(Problem(str(path), message, place, "divide each channel by its maximum"))
