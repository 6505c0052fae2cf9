"""Reading of the signals of one recording or passive trial, and checks of their units and ranges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import Problem, nearest_name
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import Storage, component_name, find_columns
from wrapjax.io.toml import collect_problems
from wrapjax.subject.external_loads import check_ground_loads
from wrapjax.subject.settings import PassiveSettings, Settings, TrialSettings
from wrapjax.subject.trials import TIME_TOLERANCE

#: Smallest number of samples in a gait cycle, which limits gaps to 1/20 of the cycle; with fewer samples the
#: signals within the cycle are not determined.
MIN_SAMPLES = 20
#: A file in degrees whose angles do not exceed this value (143 degrees, if in rad) is reported as one in
#: radians.
MAX_ANGLE_IF_RADIANS = 2.5
#: Limits of the peak moment per body mass, N m/kg. Walking peaks near 2 and running near 4. Larger values
#: mean another unit (N mm) or failed inverse dynamics; smaller ones mean moments that were divided by body
#: mass.
MAX_MOMENT_PER_MASS = 10.0
MIN_MOMENT_PER_MASS = 0.05
#: Largest value of a normalised envelope, which peaks at about 1. Larger values are in percent or microvolts.
MAX_ENVELOPE = 10.0
#: Lowest sampling rate of raw EMG, Hz: its power extends beyond 100 Hz.
MIN_RAW_EMG_RATE = 200.0

#: Function that reads a table; it usually caches tables, as trials can share files.
Reader = Callable[[Path], Storage]


@dataclass(frozen=True)
class Signals:
    """Signals of a recording at their own sampling rates, in SI units and radians.

    Parameters
    ----------
    trial
        Settings of the recording.
    coordinates
        Coordinates of the model found in the angle file, in the model's order.
    angle_time, angles
        Times, s, and joint angles, rad (m for translations).
    moment_time, moments
        Times, s, and joint moments, N m, in the order of the coordinates in the settings.
    emg_time, emg
        Times, s, and EMG as recorded, in the order of the channels in the settings.
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
    """Read and check the signals of a recording.

    Parameters
    ----------
    trial
        Settings of the recording.
    settings
        Settings of the subject.
    model_coordinates
        All coordinates of the model; empty if the model could not be read, and then angles are not checked.
    read
        Function that reads a table.
    problems, notes
        Lists to which faults and remarks are added.

    Returns
    -------
    Signals or None
        None if a file or a column is missing.
    """
    # Ground forces are used only by later steps, so that they are checked here but not kept.
    check_ground_loads(trial, problems)
    tables = {}
    for kind, path in (("angles", trial.angles), ("moments", trial.moments), ("emg", trial.emg)):
        with collect_problems(problems):
            tables[kind] = read(path)
            notes.extend(f"{path}: {remark}" for remark in tables[kind].remarks)
            _check_cycles(trial, path, tables[kind].time, problems)
    by_name = {info.name: info for info in model_coordinates}
    predicted = [by_name[name] for name in settings.coordinates if name in by_name]
    columns: dict[str, np.ndarray | None] = {}
    if "angles" in tables:
        names = tuple(info.name for info in predicted)
        columns["angles"] = _columns(tables["angles"], names, ("",), trial.angles, problems)
        check_angle_unit(tables["angles"], predicted, trial.angles, problems)
    if "moments" in tables:
        # A coordinate that the model lacks has been reported already; its column is not reported as missing.
        expected = tuple(info.name for info in predicted) if model_coordinates else settings.coordinates
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
    complete = {kind: values for kind, values in columns.items() if values is not None}
    if len(complete) < 3:
        return None
    coordinates, angles = select_angles(tables["angles"], model_coordinates)
    return Signals(
        trial=trial,
        coordinates=coordinates,
        angle_time=tables["angles"].time,
        angles=angles,
        moment_time=tables["moments"].time,
        moments=complete["moments"],
        emg_time=tables["emg"].time,
        emg=complete["emg"],
    )


def _columns(
    table: Storage, names: tuple[str, ...], suffixes: tuple[str, ...], path: Path, problems: list[Problem]
) -> Float[np.ndarray, "column sample"] | None:
    """Select the columns of these names; None if one is missing or ambiguous."""
    places = []
    for name in names:
        found = find_columns(table.columns, name, suffixes)
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
    """Report cycles that are not within the recording or have gaps in their samples."""
    for order, (start, end) in enumerate(trial.cycles, start=1):
        place = f"trial '{trial.name}', cycle {order} [{start:g}, {end:g}] s"
        if start < time[0] - TIME_TOLERANCE or end > time[-1] + TIME_TOLERANCE:
            message = f"the cycle lies outside the recording, which spans {time[0]:g} to {time[-1]:g} s"
            problems.append(Problem(str(path), message, place))
            continue
        first = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
        last = int(np.searchsorted(time, end, side="left"))
        steps = np.diff(time[first : last + 1])
        max_step = (end - start) / MIN_SAMPLES
        if steps.max() > max_step * (1.0 + 1e-9):
            gap = time[first + int(np.argmax(steps))]
            found = f"found none for {steps.max():.3g} s after {gap:g} s"
            message = f"expected a sample at least every {max_step:.3g} s, {found}"
            problems.append(Problem(str(path), message, place))


def check_angle_unit(
    table: Storage, coordinates: list[CoordinateInfo], path: Path, problems: list[Problem]
) -> None:
    """Report angles in degrees that the file declares as radians, and the reverse."""
    peaks = {}
    for info in coordinates:
        found = find_columns(table.columns, info.name)
        if info.motion_type == "rotational" and len(found) == 1:
            peaks[info.name] = float(np.abs(table.values[:, found[0]]).max())
    unit, full_turn, other_unit = (
        ("degrees", 360.0, "radians") if table.in_degrees else ("radians", 2.0 * np.pi, "degrees")
    )
    for name, peak in peaks.items():
        if peak > full_turn:
            message = f"found {peak:.4g} {unit}, more than a full turn"
            hint = (
                "are the angles in degrees? Then write inDegrees=yes in the header"
                if unit == "radians"
                else ""
            )
            problems.append(Problem(str(path), message, f"column {name}", hint))
    has_hip_or_knee = any("hip" in name or "knee" in name for name in peaks)
    if table.in_degrees and has_hip_or_knee and max(peaks.values()) <= MAX_ANGLE_IF_RADIANS:
        message = f"no angle exceeds {max(peaks.values()):.3g} degrees, which looks like {other_unit}"
        hint = "if the angles are in radians, write inDegrees=no in the header"
        problems.append(Problem(str(path), message, f"columns {', '.join(peaks)}", hint))


def select_angles(
    table: Storage, model_coordinates: tuple[CoordinateInfo, ...]
) -> tuple[tuple[str, ...], Float[np.ndarray, "coordinate sample"]]:
    """Select all coordinates of the model that a table of angles contains, and convert them to rad or m.

    As in OpenSim, only rotational coordinates are converted from degrees, not coupled ones.

    Returns
    -------
    names, angles
        Names of the coordinates in the model's order, and their values.
    """
    names = []
    series = []
    for info in model_coordinates:
        found = find_columns(table.columns, info.name)
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
    """Report moments that are zero throughout or in another unit."""
    peaks = np.abs(moments).max(axis=1)
    for name, peak in zip(names, peaks, strict=True):
        if peak == 0.0:
            problems.append(
                Problem(str(path), "expected joint moments, found zero throughout", f"column {name}_moment")
            )
        elif peak > MAX_MOMENT_PER_MASS * mass_kg:
            message = (
                f"expected N m, found {peak:.4g}, more than {MAX_MOMENT_PER_MASS:g} N m per kg of body mass"
            )
            problems.append(Problem(str(path), message, f"column {name}_moment", "are the moments in N mm?"))
    if peaks.size and 0.0 < peaks.max() < MIN_MOMENT_PER_MASS * mass_kg:
        message = f"expected N m, found no moment above {peaks.max():.3g}"
        problems.append(Problem(str(path), message, hint="are the moments divided by body mass?"))


def _check_emg(
    time: Float[np.ndarray, " sample"],
    emg: Float[np.ndarray, "channel sample"],
    settings: Settings,
    trial: TrialSettings,
    problems: list[Problem],
) -> None:
    """Report raw EMG declared as envelopes, envelopes declared as raw EMG, and constant EMG."""
    path = trial.emg
    if settings.emg_kind == "raw":
        rate = (time.size - 1) / (time[-1] - time[0])
        if rate < MIN_RAW_EMG_RATE:
            message = f"expected raw EMG at {MIN_RAW_EMG_RATE:g} Hz or more, found {rate:.4g} Hz"
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
            elif signal.max() > MAX_ENVELOPE:
                message = f"expected an envelope normalised to about 1, found a peak of {signal.max():.4g}"
                problems.append(Problem(str(path), message, place, "divide each channel by its maximum"))


@dataclass(frozen=True)
class PassiveTrial:
    """Recording of a leg with relaxed muscles.

    Parameters
    ----------
    name
        Name of the trial.
    coordinates
        Coordinates of the model in the file; the others have the model's default values.
    angles
        Values of the coordinates, rad or m.
    moment_coordinates
        Coordinates about which moments were recorded.
    moments
        Joint moments, N m, with OpenSim's signs.
    """

    name: str
    coordinates: tuple[str, ...]
    angles: Float[np.ndarray, "coordinate sample"]
    moment_coordinates: tuple[str, ...]
    moments: Float[np.ndarray, "moment_coordinate sample"]


def read_passive_trial(
    trial: PassiveSettings,
    settings: Settings,
    model_coordinates: tuple[CoordinateInfo, ...],
    read: Reader,
    problems: list[Problem],
) -> PassiveTrial | None:
    """Read and check a passive trial and add its faults to ``problems``.

    A column of moments that is zero throughout means that no moment was recorded about that coordinate.

    Returns
    -------
    PassiveTrial or None
        None if a file or a column is missing.
    """
    tables = {}
    for kind, path in (("angles", trial.angles), ("moments", trial.moments)):
        with collect_problems(problems):
            tables[kind] = read(path)
    if len(tables) < 2:
        return None
    angles, moments = tables["angles"], tables["moments"]
    predicted = [info for info in model_coordinates if info.name in settings.coordinates]
    check_angle_unit(angles, predicted, trial.angles, problems)
    inside = (angles.time >= moments.time[0]) & (angles.time <= moments.time[-1])
    if not inside.any():
        message = (
            f"expected the times of the angles, {angles.time[0]:g} to {angles.time[-1]:g} s, found "
            f"{moments.time[0]:g} to {moments.time[-1]:g} s"
        )
        problems.append(Problem(str(trial.moments), message))
        return None
    coordinates, values = select_angles(angles, model_coordinates)
    recorded: dict[str, Float[np.ndarray, " sample"]] = {}
    for name in settings.coordinates:
        columns = [
            moments.values[:, place]
            for place in find_columns(moments.columns, name, ("_moment", "_force", ""))
        ]
        if len(columns) > 1:
            problems.append(Problem(str(trial.moments), "expected one column, found several", f"of {name}"))
        elif columns and columns[0].any():
            peak = float(np.abs(columns[0]).max())
            if peak > MAX_MOMENT_PER_MASS * settings.mass_kg:
                limit = f"{MAX_MOMENT_PER_MASS:g} N m per kg of body mass"
                message = f"expected N m, found {peak:.4g}, more than {limit}"
                hint = "are the moments in N mm?"
                problems.append(Problem(str(trial.moments), message, f"column {name}_moment", hint))
            recorded[name] = np.interp(angles.time[inside], moments.time, columns[0])
    missing = [name for name in recorded if name not in coordinates]
    for name in missing:
        problems.append(
            Problem(
                str(trial.angles),
                "is not in the file, although moments about it were recorded",
                f"column {name}",
            )
        )
    if not recorded:
        message = "expected a moment that is not zero about one of the subject's coordinates, found none"
        problems.append(Problem(str(trial.moments), message))
    if missing or not recorded:
        return None
    return PassiveTrial(
        name=trial.name,
        coordinates=coordinates,
        angles=values[:, inside],
        moment_coordinates=tuple(recorded),
        moments=np.array(list(recorded.values())),
    )
