"""Settings of one trial of a subject folder (table ``[[trial]]``): files, task, and cycles or intervals."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from pathlib import Path

from wrapjax.errors import Problem
from wrapjax.io.toml import TableReader, describe_value
from wrapjax.subject.trials import GAIT, TASKS, TIME_TOLERANCE

#: Valid names of trials, which are used as names of result files.
_TRIAL_NAME = re.compile(r"[\w.+-]+( [\w.+-]+)*")


@dataclass(frozen=True)
class TrialSettings:
    """Recording and its gait cycles, or intervals of another task (table ``[[trial]]``).

    Parameters
    ----------
    name
        Name, unique among the trials of the subject.
    use
        ``calibration`` or ``validation``.
    angles, moments, emg
        Files (``.sto`` or ``.mot``) of joint angles, joint moments and EMG. Without EMG, muscles are at rest.
    cycles
        Start and end of each gait cycle, or of each interval of another task, in s.
    speed
        Walking speed in m/s, NaN if not given.
    ground_forces
        File (``.sto`` or ``.mot``) of ground reaction forces, None if not given.
    external_loads
        OpenSim's XML file that assigns the ground reaction forces to bodies, None if not given.
    task
        What was recorded, one of `TASKS`.
    posture
        Values of coordinates that the file of angles lacks: degrees, or m for translations.
    condition
        What distinguishes the recording from others of the person, such as ``brace``; empty if not given.
    effective_samples
        Number of independent samples that each cycle or interval counts for in a calibration; NaN to estimate
        it.
    emg_low_pass
        Cut-off frequency of the low-pass filter of raw EMG, Hz; NaN for the task's usual one.
    """

    name: str
    use: str
    angles: Path
    moments: Path
    emg: Path | None
    cycles: tuple[tuple[float, float], ...]
    speed: float = math.nan
    ground_forces: Path | None = None
    external_loads: Path | None = None
    task: str = GAIT
    posture: tuple[tuple[str, float], ...] = ()
    condition: str = ""
    effective_samples: float = math.nan
    emg_low_pass: float = math.nan

    @staticmethod
    def is_valid_name(name: str) -> bool:
        """Return whether a name is valid for a trial, and thus for its result files."""
        return bool(_TRIAL_NAME.fullmatch(name) and name.strip("."))


def read_trial(
    table: object, number: int, file: Path, folder: Path, problems: list[Problem]
) -> TrialSettings | None:
    """Read a table ``[[trial]]``; None if a required key is missing or invalid."""
    label = table.get("name") if isinstance(table, dict) else None
    place = f"[[trial]] '{label}'" if isinstance(label, str) and label else f"[[trial]] number {number}"
    reader = TableReader(table, file, place, problems)
    name = reader.text("name")
    if name is not None and not TrialSettings.is_valid_name(name):
        reader.add_problem("name", f"expected letters, digits, '_', '-', '+' and '.', found '{name}'")
        name = None
    use = reader.text("use", choices=("calibration", "validation"))
    task = read_task(reader)
    angles, moments = (reader.path(key, folder) for key in ("angles", "moments"))
    at_rest = task == "passive" and not reader.has("emg")
    emg = None if at_rest else reader.path("emg", folder)
    extra = [reader.path(key, folder, required=False) for key in ("ground_forces", "external_loads")]
    speed = reader.number("speed_m_s", lowest=0.0, highest=15.0, unit="m/s", required=False)
    cycles = read_cycles(reader) if task == GAIT else read_intervals(reader)
    posture = read_posture(reader)
    condition = reader.text("condition", required=False)
    samples = reader.number(
        "effective_samples", lowest=0.0, highest=1e6, unit="independent samples", required=False
    )
    low_pass = reader.number("emg_low_pass_hz", lowest=0.5, highest=100.0, unit="Hz", required=False)
    reader.report_unknown_keys()
    if name is None or use is None or task is None or angles is None or moments is None:
        return None
    if emg is None and not at_rest:
        return None
    return TrialSettings(
        name=name,
        use=use,
        angles=angles,
        moments=moments,
        emg=emg,
        cycles=cycles,
        speed=math.nan if speed is None else speed,
        ground_forces=extra[0],
        external_loads=extra[1],
        task=task,
        posture=posture,
        condition=condition or "",
        effective_samples=math.nan if samples is None else samples,
        emg_low_pass=math.nan if low_pass is None else low_pass,
    )


def read_task(reader: TableReader) -> str | None:
    """Read the task of a trial; gait where cycles are given."""
    others = tuple(task for task in TASKS if task != GAIT)
    if not reader.has("task") and (reader.has("interval") or reader.has("intervals")):
        found = "an interval without it"
        reader.add_problem("task", f"expected {' or '.join(repr(task) for task in others)}, found {found}")
        reader.raw("task")
        return None
    return reader.text("task", choices=TASKS) if reader.has("task") else GAIT


def read_posture(reader: TableReader) -> tuple[tuple[str, float], ...]:
    """Read ``posture = {coordinate = value}``: degrees, or m for translations; faults are reported."""
    table = reader.raw("posture")
    if table is None:
        return ()
    if not isinstance(table, dict):
        expected = "expected a table such as { knee_angle_r = 0.0 }, in degrees"
        reader.add_problem("posture", f"{expected}, found {describe_value(table)}")
        return ()
    found = []
    for name, value in table.items():
        if not _is_time(value) or abs(value) > 360.0:
            expected = "expected a number from -360 to 360 degrees"
            reader.add_problem(f"posture {name}", f"{expected}, found {describe_value(value)}")
        else:
            found.append((name, float(value)))
    return tuple(found)


def read_intervals(reader: TableReader) -> tuple[tuple[float, float], ...]:
    """Read ``interval = [t0, t1]`` or ``intervals = [[t0, t1], ...]``, s, which must not overlap."""
    intervals = _read_spans(reader, "interval")
    for first, second in itertools.pairwise(sorted(intervals)):
        if second[0] < first[1] - TIME_TOLERANCE:
            shown = " and ".join(f"[{start:g}, {end:g}]" for start, end in (first, second))
            reader.add_problem("intervals", f"expected intervals that do not overlap, found {shown}")
    for key in ("cycle", "cycles"):
        if reader.has(key):
            reader.raw(key)
            reader.add_problem(key, "is for gait; a trial of another task has interval or intervals")
    return intervals


def read_cycles(reader: TableReader) -> tuple[tuple[float, float], ...]:
    """Read ``cycle = [t0, t1]`` or ``cycles = [[t0, t1], ...]``, s; invalid ones are reported and omitted."""
    for key in ("interval", "intervals"):
        if reader.has(key):
            reader.raw(key)
            reader.add_problem(key, "is for tasks other than gait; a gait trial has cycle or cycles")
    return _read_spans(reader, "cycle")


def _read_spans(reader: TableReader, one: str) -> tuple[tuple[float, float], ...]:
    """Read ``one = [t0, t1]`` or ``ones = [[t0, t1], ...]``, s; invalid ones are reported and omitted."""
    many = f"{one}s"
    if reader.has(one) == reader.has(many):
        found = "both" if reader.has(one) else "neither"
        reader.add_problem(
            one, f"expected either {one} = [t0, t1] or {many} = [[t0, t1], ...], found {found}"
        )
    single, several = reader.raw(one), reader.raw(many)
    if single is not None and several is not None:
        return ()
    if several is not None:
        return read_spans_of(reader, many)
    return () if single is None else _check_spans(reader, one, [single], numbered=False)


def read_spans_of(reader: TableReader, key: str) -> tuple[tuple[float, float], ...]:
    """Read ``key = [[t0, t1], ...]``, s; invalid spans are reported and omitted."""
    listed = reader.raw(key)
    if not isinstance(listed, list) or not listed:
        reader.add_problem(key, f"expected [[t0, t1], ...], found {describe_value(listed)}")
        return ()
    return _check_spans(reader, key, listed, numbered=True)


def _check_spans(
    reader: TableReader, key: str, listed: list, *, numbered: bool
) -> tuple[tuple[float, float], ...]:
    spans = []
    for order, entry in enumerate(listed, start=1):
        place = f"{key} {order}" if numbered else key
        if not (isinstance(entry, list) and len(entry) == 2 and all(map(_is_time, entry))):
            reader.add_problem(place, f"expected [t0, t1] in s, found {describe_value(entry)}")
        elif entry[0] >= entry[1]:
            reader.add_problem(place, f"expected t0 before t1, found [{entry[0]:g}, {entry[1]:g}]")
        else:
            spans.append((float(entry[0]), float(entry[1])))
    return tuple(spans)


def _is_time(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the range of floating-point numbers
        return False
