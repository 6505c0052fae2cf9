"""Reading of the signals of one recording, and checks of their units and ranges."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.errors import Problem, nearest_name
from wrapjax.io.model_file import CoordinateInfo
from wrapjax.io.storage import Storage, component_name, find_columns
from wrapjax.io.toml import collect_problems
from wrapjax.subject.external_loads import check_ground_loads
from wrapjax.subject.settings import Settings
from wrapjax.subject.trial_checks import check_moments, check_restoring_moments
from wrapjax.subject.trial_settings import TrialSettings
from wrapjax.subject.trials import GAIT, TIME_TOLERANCE
from wrapjax.subject.windows import WINDOW_SECONDS

#: Smallest number of samples in a gait cycle, which limits gaps to 1/20 of the cycle; with fewer samples the
#: signals within the cycle are not determined.
MIN_SAMPLES = 20
#: A file in degrees whose angles do not exceed this value (143 degrees, if in rad) is reported as one in
#: radians.
MAX_ANGLE_IF_RADIANS = 2.5
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
        Times, s, and joint moments, N m, in the order of the coordinates in the settings; NaN about those
        that were not measured, as by a dynamometer.
    emg_time, emg
        Times, s, and EMG as recorded, in the order of the channels in the settings; None of a passive trial
        without EMG.
    defaults
        Default values of the model's coordinates, rad or m.
    """

    trial: TrialSettings
    coordinates: tuple[str, ...]
    angle_time: Float[np.ndarray, " angle_sample"]
    angles: Float[np.ndarray, "coordinate angle_sample"]
    moment_time: Float[np.ndarray, " moment_sample"]
    moments: Float[np.ndarray, "moment_coordinate moment_sample"]
    emg_time: Float[np.ndarray, " emg_sample"] | None
    emg: Float[np.ndarray, "channel emg_sample"] | None
    defaults: dict[str, float]


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
        if path is None:
            continue
        with collect_problems(problems):
            tables[kind] = read(path)
            notes.extend(f"{path}: {remark}" for remark in tables[kind].remarks)
            _check_cycles(trial, path, tables[kind].time, problems)
    by_name = {info.name: info for info in model_coordinates}
    predicted = [by_name[name] for name in settings.coordinates if name in by_name]
    # A coordinate that the model lacks has been reported already; its column is not reported as missing.
    expected = tuple(info.name for info in predicted) if model_coordinates else settings.coordinates
    columns: dict[str, np.ndarray | None] = {}
    posture: dict[str, float] = {}
    if "angles" in tables:
        posture = _check_posture(trial, tables["angles"], by_name, settings, problems)
        recorded = [info for info in predicted if info.name not in posture]
        names = tuple(info.name for info in recorded)
        hint = "" if trial.task == GAIT else "posture = { %s = ... } states a coordinate that did not move"
        columns["angles"] = _columns(tables["angles"], names, ("",), trial.angles, problems, hint)
        check_angle_unit(tables["angles"], recorded, trial.angles, problems, moved=trial.task == GAIT)
    if "moments" in tables:
        suffixes = ("_moment", "_force", "")
        if trial.task == GAIT:
            moments = _columns(tables["moments"], expected, suffixes, trial.moments, problems)
        else:
            moments = _measured_moments(tables["moments"], expected, suffixes, trial, problems, notes)
        columns["moments"] = moments
        if moments is not None:
            check_moments(moments, expected, settings.mass_kg, trial, problems)
    if "emg" in tables and trial.emg is not None:
        columns["emg"] = _columns(tables["emg"], tuple(settings.channels), ("",), trial.emg, problems)
        if columns["emg"] is not None:
            _check_emg(tables["emg"].time, columns["emg"], settings, trial.emg, problems)
    complete = {kind: values for kind, values in columns.items() if values is not None}
    if len(complete) < (3 if trial.emg is not None else 2):
        return None
    coordinates, angles = select_angles(tables["angles"], model_coordinates, posture)
    signals = Signals(
        trial=trial,
        coordinates=coordinates,
        angle_time=tables["angles"].time,
        angles=angles,
        moment_time=tables["moments"].time,
        moments=complete["moments"],
        emg_time=tables["emg"].time if "emg" in tables else None,
        emg=complete.get("emg"),
        defaults={info.name: info.default_value for info in model_coordinates},
    )
    if trial.task == "passive" and model_coordinates:
        check_restoring_moments(trial.moments, expected, restoring_samples(signals, expected), problems)
    return signals


def within_intervals(signals: Signals) -> Bool[np.ndarray, " angle_sample"]:
    """Mark the samples of the angles within the cycles or intervals of a recording."""
    time = signals.angle_time
    inside = np.zeros(time.size, dtype=bool)
    for start, end in signals.trial.cycles:
        inside |= (time >= start) & (time <= end)
    return inside


def restoring_samples(signals: Signals, names: tuple[str, ...]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the angle (rad) and moment (N m) about each measured coordinate within the intervals."""
    time, inside = signals.angle_time, within_intervals(signals)
    return {
        name: (
            signals.angles[signals.coordinates.index(name), inside],
            np.interp(time[inside], signals.moment_time, moment),
        )
        for name, moment in zip(names, signals.moments, strict=True)
        if np.isfinite(moment).all()
    }


def _check_posture(
    trial: TrialSettings,
    table: Storage,
    by_name: dict[str, CoordinateInfo],
    settings: Settings,
    problems: list[Problem],
) -> dict[str, float]:
    """Return the stated values of coordinates, rad or m; report unknown coordinates and recorded ones."""
    found: dict[str, float] = {}
    place = f"[[trial]] '{trial.name}' posture"
    file = str(settings.file)
    for name, value in trial.posture:
        if not by_name:
            found[name] = value
        elif name not in by_name:
            message = f"coordinate '{name}' is not in the model"
            problems.append(Problem(file, message, place, nearest_name(name, tuple(by_name))))
        elif find_columns(table.columns, name):
            message = f"expected coordinates that the file of angles lacks, found '{name}', which it holds"
            problems.append(Problem(file, message, place))
        else:
            rotates = by_name[name].motion_type == "rotational"
            found[name] = float(np.deg2rad(value)) if rotates else value
    return found


def _measured_moments(
    table: Storage,
    names: tuple[str, ...],
    suffixes: tuple[str, ...],
    trial: TrialSettings,
    problems: list[Problem],
    notes: list[str],
) -> Float[np.ndarray, "moment_coordinate sample"] | None:
    """Select the moments that a table holds; NaN about coordinates that it lacks or that are zero throughout.

    None if it holds no moment about a coordinate of the subject.
    """
    moments = np.full((len(names), table.time.size), np.nan)
    for row, name in enumerate(names):
        found = find_columns(table.columns, name, suffixes)
        if len(found) > 1:
            labels = ", ".join(table.columns[place] for place in found)
            message = f"expected one column, found several: {labels}"
            problems.append(Problem(str(trial.moments), message, f"column {name}{suffixes[0]}"))
            return None
        if found and table.values[:, found[0]].any():
            moments[row] = table.values[:, found[0]]
    measured = np.isfinite(moments).all(axis=1)
    if not measured.any():
        known = tuple(component_name(label) for label in table.columns)
        message = "expected a moment that is not zero about one of the subject's coordinates, found none"
        hint = nearest_name(f"{names[0]}{suffixes[0]}", known) if names else ""
        problems.append(Problem(str(trial.moments), message, hint=hint))
        return None
    if not measured.all():
        kept = ", ".join(name for name, has in zip(names, measured, strict=True) if has)
        notes.append(f"trial '{trial.name}': moments were measured about {kept} alone")
    return moments


def _columns(
    table: Storage,
    names: tuple[str, ...],
    suffixes: tuple[str, ...],
    path: Path,
    problems: list[Problem],
    hint: str = "",
) -> Float[np.ndarray, "column sample"] | None:
    """Select the columns of these names; None if one is missing or ambiguous, with a hint if given."""
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
            advice = (hint % name) if hint else nearest_name(expected, known)
            problems.append(Problem(str(path), "is not in the file", f"column {expected}", advice))
    return table.values.T[places] if len(places) == len(names) else None


def _check_cycles(
    trial: TrialSettings, path: Path, time: Float[np.ndarray, " sample"], problems: list[Problem]
) -> None:
    """Report cycles and intervals that are not within the recording or have gaps in their samples."""
    noun = "cycle" if trial.task == GAIT else "interval"
    for order, (start, end) in enumerate(trial.cycles, start=1):
        place = f"trial '{trial.name}', {noun} {order} [{start:g}, {end:g}] s"
        if start < time[0] - TIME_TOLERANCE or end > time[-1] + TIME_TOLERANCE:
            message = f"the {noun} lies outside the recording, which spans {time[0]:g} to {time[-1]:g} s"
            problems.append(Problem(str(path), message, place))
            continue
        first = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
        last = int(np.searchsorted(time, end, side="left"))
        steps = np.diff(time[first : last + 1])
        duration = end - start if trial.task == GAIT else min(end - start, WINDOW_SECONDS)
        max_step = duration / MIN_SAMPLES
        if steps.max() > max_step * (1.0 + 1e-9):
            gap = time[first + int(np.argmax(steps))]
            found = f"found none for {steps.max():.3g} s after {gap:g} s"
            message = f"expected a sample at least every {max_step:.3g} s, {found}"
            problems.append(Problem(str(path), message, place))


def check_angle_unit(
    table: Storage,
    coordinates: list[CoordinateInfo],
    path: Path,
    problems: list[Problem],
    *,
    moved: bool = True,
) -> None:
    """Report angles in degrees that the file declares as radians, and the reverse.

    Small angles in degrees are not reported where the joint need not have ``moved``.
    """
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
    if moved and table.in_degrees and has_hip_or_knee and max(peaks.values()) <= MAX_ANGLE_IF_RADIANS:
        message = f"no angle exceeds {max(peaks.values()):.3g} degrees, which looks like {other_unit}"
        hint = "if the angles are in radians, write inDegrees=no in the header"
        problems.append(Problem(str(path), message, f"columns {', '.join(peaks)}", hint))


def select_angles(
    table: Storage, model_coordinates: tuple[CoordinateInfo, ...], posture: Mapping[str, float] | None = None
) -> tuple[tuple[str, ...], Float[np.ndarray, "coordinate sample"]]:
    """Select all coordinates of the model that a table of angles contains, and convert them to rad or m.

    As in OpenSim, only rotational coordinates are converted from degrees, not coupled ones. Coordinates of
    the posture (rad or m) are constant.

    Returns
    -------
    names, angles
        Names of the coordinates in the model's order, and their values.
    """
    names = []
    series = []
    for info in model_coordinates:
        found = find_columns(table.columns, info.name)
        if posture and info.name in posture:
            names.append(info.name)
            series.append(np.full(table.time.size, posture[info.name]))
        elif len(found) == 1:
            values = table.values[:, found[0]]
            names.append(info.name)
            series.append(
                np.deg2rad(values) if table.in_degrees and info.motion_type == "rotational" else values
            )
    return tuple(names), np.array(series).reshape(len(names), table.time.size)


def _check_emg(
    time: Float[np.ndarray, " sample"],
    emg: Float[np.ndarray, "channel sample"],
    settings: Settings,
    path: Path,
    problems: list[Problem],
) -> None:
    """Report raw EMG declared as envelopes, envelopes declared as raw EMG, and constant EMG."""
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
