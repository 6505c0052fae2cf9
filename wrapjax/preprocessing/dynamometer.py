"""Torque and angle of a dynamometer: units, signs, offset, and the weight of limb and lever arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.io.toml import TableReader
from wrapjax.preprocessing.files.c3d import is_c3d, read_c3d_analog
from wrapjax.preprocessing.files.dynamometer_files import read_device_columns
from wrapjax.preprocessing.files.markers import low_pass
from wrapjax.subject.emg_envelopes import resample_evenly
from wrapjax.subject.trial_checks import MAX_MOMENT_PER_MASS, check_restoring_moments
from wrapjax.subject.trial_settings import read_spans_of

#: N m in each unit of torque that the settings may name, and rad in each unit of angle.
TORQUE_UNITS = {"N m": 1.0, "N cm": 0.01, "lbf ft": 1.3558179483314004}
ANGLE_UNITS = {"deg": math.pi / 180.0, "rad": 1.0}
#: Fastest rotation of a gravity trial that counts (rad/s), and the smallest range that it must cover (rad).
SLOW, LEAST_RANGE = math.radians(30.0), math.radians(20.0)
#: Correlation below which the angle of the device and that of the motion have opposite signs.
_OPPOSITE = -0.7
# Degree of the polynomial of the weight through still samples.
_DEGREE = 3


@dataclass(frozen=True)
class DynamometerSettings:
    """Table ``dynamometer`` of a trial.

    Parameters
    ----------
    file
        File of the device; of a ``.c3d`` file, its analog channels.
    coordinate
        Coordinate about whose axis the device measures.
    time, angle, torque
        Names of its columns, variables or channels; ``time`` is empty where the rate is given, and in a
        ``.c3d`` file.
    rate_hz
        Sampling rate, Hz; NaN where there is a column of times or the file states it.
    start
        Time of the first sample, s, by the clock of the other files (with a column of times: added to it).
    torque_unit, angle_unit
        Of `TORQUE_UNITS` and `ANGLE_UNITS`.
    torque_scale, angle_scale
        Torque and angle, in these units, for a value of 1 in the file, as for a channel in V.
    torque_sign, angle_sign
        1 where the device has the signs of the model's coordinate, else -1.
    angle_offset
        Value of the coordinate where the device's angle is zero, rad.
    weight_trial
        File of a gravity trial with the same columns; None without.
    still
        Intervals (s) in which the relaxed limb was held still.
    """

    file: Path
    coordinate: str
    time: str
    angle: str
    torque: str
    rate_hz: float
    start: float
    torque_unit: str
    angle_unit: str
    torque_sign: int
    angle_sign: int
    angle_offset: float
    weight_trial: Path | None
    still: tuple[tuple[float, float], ...]
    torque_scale: float = 1.0
    angle_scale: float = 1.0


def read_dynamometer(reader: TableReader, folder: Path) -> DynamometerSettings | None:
    """Read the table ``dynamometer`` of a trial; None where there is none or a required key is missing."""
    table = reader.raw("dynamometer")
    if table is None:
        return None
    own = TableReader(table, reader.file, f"{reader.place} dynamometer", reader.problems)
    before = len(reader.problems)
    files = {}
    for key in ("file", "weight_trial"):
        name = own.text(key, required=key == "file")
        files[key] = None if name is None else folder / name
        if name is not None and not (folder / name).is_file():
            own.add_problem(key, f"expected a file, found no {folder / name}")
    kinds = {path.suffix.lower() for path in files.values() if path is not None}
    if len(kinds) > 1:
        own.add_problem("weight_trial", f"expected a file of the same kind as file, found {sorted(kinds)}")
    coordinate = own.text("coordinate")
    time = own.text("time", required=False)
    angle, torque = own.text("angle"), own.text("torque")
    rate = own.number("rate_hz", lowest=5.0, highest=1e5, unit="Hz", required=False)
    if files["file"] is not None and is_c3d(files["file"]):
        if time is not None or rate is not None:
            own.add_problem("time", "expected neither time nor rate_hz, as a C3D file states its rate")
    elif (time is None) == (rate is None):
        own.add_problem("time", "expected either a column of times or rate_hz")
    start = own.number("start_s", lowest=-1e6, highest=1e6, unit="s", required=False)
    torque_unit = own.text("torque_unit", required=False, choices=tuple(TORQUE_UNITS))
    angle_unit = own.text("angle_unit", required=False, choices=tuple(ANGLE_UNITS))
    signs = [
        own.number(key, lowest=-1, highest=1, unit="", required=False)
        for key in ("torque_sign", "angle_sign")
    ]
    for key, sign in zip(("torque_sign", "angle_sign"), signs, strict=True):
        if sign is not None and abs(sign) != 1.0:
            own.add_problem(key, f"expected 1 or -1, found {sign:g}")
    scales = [
        own.number(key, lowest=1e-6, highest=1e6, unit="per unit of the file", required=False)
        for key in ("torque_scale", "angle_scale")
    ]
    offset = own.number("angle_offset_deg", lowest=-360.0, highest=360.0, unit="degrees", required=False)
    still = read_spans_of(own, "still") if own.has("still") else ()
    if still and files["weight_trial"] is not None:
        own.add_problem("still", "expected either still intervals or weight_trial, found both")
    own.report_unknown_keys()
    file = files["file"]
    if len(reader.problems) > before or file is None or coordinate is None or angle is None or torque is None:
        return None
    return DynamometerSettings(
        file=file,
        coordinate=coordinate,
        time=time or "",
        angle=angle,
        torque=torque,
        rate_hz=math.nan if rate is None else rate,
        start=start or 0.0,
        torque_unit=torque_unit or "N m",
        angle_unit=angle_unit or "deg",
        torque_sign=int(signs[0] or 1),
        angle_sign=int(signs[1] or 1),
        angle_offset=math.radians(offset or 0.0),
        weight_trial=files["weight_trial"],
        still=still,
        torque_scale=scales[0] or 1.0,
        angle_scale=scales[1] or 1.0,
    )


@dataclass(frozen=True)
class DeviceTrial:
    """Angle and moment about one coordinate by a dynamometer.

    Parameters
    ----------
    time
        Times, s, evenly spaced.
    angle, moment
        Value of the coordinate (rad) and moment about it (N m), with the model's signs, filtered alike.
    notes
        What was done: units, signs, offset and the weight that was subtracted.
    """

    time: Float[np.ndarray, " sample"]
    angle: Float[np.ndarray, " sample"]
    moment: Float[np.ndarray, " sample"]
    notes: tuple[str, ...]


def read_device_trial(
    settings: DynamometerSettings,
    task: str,
    mass_kg: float,
    intervals: Sequence[tuple[float, float]],
    cutoff: float,
) -> DeviceTrial:
    """Read a trial of a dynamometer, subtract the weight of limb and lever arm, and filter.

    Parameters
    ----------
    settings
        Table of the trial.
    task
        Task of the trial.
    mass_kg
        Body mass, kg, which limits what a torque can be.
    intervals
        Intervals of the trial, s.
    cutoff
        Cut-off frequency of the low-pass filter of angle and torque, Hz.

    Raises
    ------
    InputError
        If a file is invalid, the torque is larger than of any person, or a passive torque assists stretch.
    """
    time, angle, torque = _read(settings, settings.file)
    notes = [_conversion_note(settings)]
    limit = MAX_MOMENT_PER_MASS[task] * mass_kg
    inside = _within(time, intervals)
    if not inside.any():
        covered = f"{time[0]:g} to {time[-1]:g} s"
        message = f"expected the intervals of the trial within its samples, found samples from {covered}"
        raise InputError(Problem(str(settings.file), message, "intervals"))
    peak = float(np.abs(torque[inside]).max())
    if peak > limit:
        message = (
            f"expected {settings.torque_unit}, found {peak:.4g} N m, more than {MAX_MOMENT_PER_MASS[task]:g} "
            f"N m per kg of body mass in a trial of task '{task}'"
        )
        hint = 'is the torque in N cm? Write torque_unit = "N cm"'
        raise InputError(Problem(str(settings.file), message, f"column {settings.torque}", hint))
    torque = torque - _weight(settings, task, time, angle, torque, notes)
    if task == "passive":
        problems: list[Problem] = []
        name = settings.coordinate
        check_restoring_moments(settings.file, (name,), {name: (angle[inside], torque[inside])}, problems)
        if problems:
            raise InputError(problems)
    even, values = resample_evenly(time, np.array([angle, torque]))
    smooth = low_pass(even, values, cutoff)
    return DeviceTrial(even, smooth[0], smooth[1], tuple(notes))


def compare_angles(
    settings: DynamometerSettings,
    device: DeviceTrial,
    time: Float[np.ndarray, " frame"],
    angle: Float[np.ndarray, " frame"],
) -> str:
    """Compare the device's angle with that of the motion; return a note, or raise an error if opposite.

    Parameters
    ----------
    settings, device
        Table of the trial, and what the device measured.
    time, angle
        Times, s, and values of the coordinate by the motion, rad.
    """
    at = np.interp(time, device.time, device.angle)
    if np.ptp(at) < LEAST_RANGE or np.ptp(angle) < LEAST_RANGE:
        return f"{settings.file}: the joint hardly moved, so that its angle was not compared with the motion"
    correlation = float(np.corrcoef(at, angle)[0, 1])
    if correlation < _OPPOSITE:
        message = (
            f"expected an angle that rises with {settings.coordinate} of the motion, found the opposite sign "
            f"(correlation {correlation:.2f})"
        )
        hint = f"write angle_sign = {-settings.angle_sign}, and check torque_sign"
        raise InputError(Problem(str(settings.file), message, f"column {settings.angle}", hint))
    difference = math.degrees(float(np.sqrt(np.mean((at - angle) ** 2))))
    return (
        f"{settings.file}: {settings.coordinate} is that of the motion; the device's differs by "
        f"{difference:.1f} degrees (root mean square)"
    )


def _read(settings: DynamometerSettings, file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Read time (s), angle (rad) and torque (N m), with the model's signs."""
    names = (settings.angle, settings.torque, *([settings.time] if settings.time else []))
    if is_c3d(file):
        time, (angle, torque) = _read_analog(file, names)
        time = settings.start + time
    else:
        angle, torque, *times = read_device_columns(file, names)
        time = settings.start + (times[0] if times else np.arange(angle.size) / settings.rate_hz)
    if (np.diff(time) <= 0.0).any():
        place = int(np.argmax(np.diff(time) <= 0.0))
        message = f"expected rising times, found {time[place]:g} and then {time[place + 1]:g} s"
        raise InputError(Problem(str(file), message, f"column {settings.time}"))
    turned = settings.angle_sign * ANGLE_UNITS[settings.angle_unit] * settings.angle_scale
    pushed = settings.torque_sign * TORQUE_UNITS[settings.torque_unit] * settings.torque_scale
    angle = turned * angle + settings.angle_offset
    if np.abs(angle).max() > 2.0 * np.pi:
        message = f"found {np.abs(angle).max():.4g} rad, more than a full turn"
        raise InputError(Problem(str(file), message, f"column {settings.angle}", "is angle_unit right?"))
    return time, angle, pushed * torque


def _read_analog(
    file: Path, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "name sample"]]:
    """Read analog channels of a C3D file, and the times of their samples, s."""
    table = read_c3d_analog(file)
    problems = [
        Problem(str(file), "is not in the file", f"channel {name}", nearest_name(name, table.columns))
        for name in names
        if name not in table.columns
    ]
    if problems:
        raise InputError(problems)
    return table.time, table.values.T[[table.columns.index(name) for name in names]]


def _conversion_note(settings: DynamometerSettings) -> str:
    signs = {1: "as the device has it", -1: "of opposite sign"}
    torque, angle = (
        unit if scale == 1.0 else f"{scale:g} {unit}"
        for scale, unit in (
            (settings.torque_scale, settings.torque_unit),
            (settings.angle_scale, settings.angle_unit),
        )
    )
    return (
        f"{settings.file}: torque about {settings.coordinate} in {torque}, {signs[settings.torque_sign]}; "
        f"angle in {angle}, {signs[settings.angle_sign]}, plus "
        f"{math.degrees(settings.angle_offset):g} degrees"
    )


def _within(time: np.ndarray, intervals: Sequence[tuple[float, float]]) -> np.ndarray:
    inside = np.zeros(time.size, dtype=bool)
    for start, end in intervals:
        inside |= (time >= start) & (time <= end)
    return inside


def _weight(
    settings: DynamometerSettings,
    task: str,
    time: np.ndarray,
    angle: np.ndarray,
    torque: np.ndarray,
    notes: list[str],
) -> Float[np.ndarray, " sample"]:
    """Compute the torque of the weight of limb and lever arm at each sample, N m."""
    if settings.weight_trial is not None:
        return _weight_of_gravity_trial(settings, angle, notes)
    if settings.still:
        if task == "passive":
            message = (
                "expected weight_trial, found still intervals: a curve through still samples of a passive "
                "trial is its passive moment, and would be subtracted with the weight"
            )
            raise InputError(Problem(str(settings.file), message, "still"))
        return _weight_of_still_samples(settings, time, angle, torque, notes)
    notes.append(f"{settings.file}: no weight of limb and lever arm was subtracted, as none is stated")
    return np.zeros(angle.size)


def _weight_of_gravity_trial(
    settings: DynamometerSettings, angle: np.ndarray, notes: list[str]
) -> Float[np.ndarray, " sample"]:
    """Fit ``a cos q + b sin q + c`` to the slow samples of a gravity trial: a weight turned about an axis."""
    file = settings.weight_trial
    assert file is not None, "called where it is given"
    time, turned, measured = _read(settings, file)
    slow = np.abs(np.gradient(turned, time)) <= SLOW
    if slow.sum() < 10 or np.ptp(turned[slow]) < LEAST_RANGE:
        message = (
            f"expected slow rotation through {math.degrees(LEAST_RANGE):.0f} degrees or more, found "
            f"{math.degrees(float(np.ptp(turned[slow])) if slow.any() else 0.0):.0f}"
        )
        raise InputError(Problem(str(file), message, f"column {settings.angle}"))

    def waves(at: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(at), np.sin(at), np.ones_like(at)], axis=1)

    found = np.linalg.lstsq(waves(turned[slow]), measured[slow], rcond=None)[0]
    left = measured[slow] - waves(turned[slow]) @ found
    notes.append(
        f"{file}: weight of limb and lever arm {np.hypot(*found[:2]):.3g} N m, offset of the torque "
        f"{found[2]:.3g} N m, subtracted; {np.sqrt(np.mean(left**2)):.2g} N m of the gravity trial remain"
    )
    return np.asarray(waves(angle) @ found)


def _weight_of_still_samples(
    settings: DynamometerSettings, time: np.ndarray, angle: np.ndarray, torque: np.ndarray, notes: list[str]
) -> Float[np.ndarray, " sample"]:
    """Fit a polynomial of the angle, a cubic from four angles, to the means of the still intervals."""
    held = [_within(time, (span,)) for span in settings.still]
    if not all(inside.any() for inside in held):
        message = "expected still intervals within the samples of the file, found one outside"
        raise InputError(Problem(str(settings.file), message, "still"))
    at = np.array([angle[inside].mean() for inside in held])
    mean = np.array([torque[inside].mean() for inside in held])
    different = len(np.unique(np.round(np.degrees(at))))
    degree = min(_DEGREE, different - 1)
    curve = np.polynomial.Polynomial.fit(at, mean, degree) if degree else None
    notes.append(
        f"{settings.file}: weight of limb and lever arm by a polynomial of degree {degree} through "
        f"{len(at)} still intervals at {different} angles, {mean.min():.3g} to {mean.max():.3g} N m, "
        "subtracted"
    )
    # Beyond the still angles the nearest one counts: a cubic does not extrapolate.
    nearest = np.clip(angle, at.min(), at.max())
    return np.full(angle.size, mean.mean()) if curve is None else np.asarray(curve(nearest))
