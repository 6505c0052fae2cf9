"""Laboratory settings, the TOML file of `wrapjax prepare`: its allowed keys, their checks, and the values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.toml import TableReader, describe_value, parse_toml, read_toml_text
from wrapjax.preprocessing.dynamometer import DynamometerSettings, read_dynamometer
from wrapjax.preprocessing.gait.force_plates import SIDES, ForceColumns
from wrapjax.subject.settings import read_channels
from wrapjax.subject.trial_settings import (
    TrialSettings,
    read_cycles,
    read_intervals,
    read_posture,
    read_spans_of,
    read_task,
)
from wrapjax.subject.trials import GAIT

#: Volts in each unit of EMG that the settings may name.
VOLTS_PER_UNIT = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
#: Directions of the laboratory's axes that the settings may name.
_AXES = ("x", "-x", "y", "-y", "z", "-z")


@dataclass(frozen=True)
class LaboratoryTrial:
    """Recording of a laboratory (table ``[[trial]]``).

    Parameters
    ----------
    name
        Name, unique among the trials.
    use
        ``calibration`` or ``validation``.
    speed
        Walking speed in m/s, NaN if not given.
    markers, angles
        File of marker positions (``.trc``, ``.c3d``) or of joint angles (``.sto``, ``.mot``); one of them is
        None.
    forces
        File of ground reaction forces (``.mot``, ``.sto``, ``.c3d``); None where moments are given.
    emg
        File of EMG (``.sto``, ``.mot``, ``.c3d``); None of a passive trial, whose muscles are at rest.
    cycles
        Start and end of each gait cycle in s; if empty, they are found from the vertical force. Of other
        tasks, start and end of each interval.
    task, condition, posture
        As in the subject folder; see `TrialSettings`.
    moments
        File of joint moments that the laboratory computed (``.sto``, ``.mot``); None to compute them.
    moments_low_pass
        Cut-off frequency at which the laboratory filtered these moments, Hz, so that they are not filtered
        again; NaN to filter them like the motion.
    low_pass
        Cut-off frequency for motion and forces, Hz; NaN for the usual one.
    steps
        Intervals (s) of steps in gait with flight phases, by side, whose foot a person has stated.
    dynamometer
        Dynamometer that measured the moment, and the angle where there are neither markers nor angles; None
        without one.
    """

    name: str
    use: str
    speed: float
    markers: Path | None
    angles: Path | None
    forces: Path | None
    emg: Path | None
    cycles: tuple[tuple[float, float], ...]
    task: str = GAIT
    condition: str = ""
    posture: tuple[tuple[str, float], ...] = ()
    moments: Path | None = None
    moments_low_pass: float = math.nan
    low_pass: float = math.nan
    steps: dict[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    dynamometer: DynamometerSettings | None = None

    @property
    def motion(self) -> Path:
        """File of the motion: markers, joint angles, or those of a dynamometer."""
        device = None if self.dynamometer is None else self.dynamometer.file
        file = self.markers or self.angles or device
        assert file is not None
        return file


@dataclass(frozen=True)
class LaboratorySettings:
    """Content of the laboratory settings.

    Parameters
    ----------
    file
        Settings file.
    text
        Text of the settings file.
    name
        Name of the person.
    mass_kg
        Body mass, kg.
    side
        Side of the leg, ``l`` or ``r``.
    paretic
        Whether the leg is paretic, None if unknown.
    model_file
        OpenSim model (``.osim``).
    coordinates
        Coordinates whose moments are predicted.
    muscle_parameters
        CSV file of muscle parameters, None if those of the model are used.
    joints
        ``joints.json`` of ``wrapjax joints`` that wrote the model, None if not given.
    scaling
        Setup file of OpenSim's scale tool, None if the model is scaled already.
    scales_masses
        Whether only the masses of the model are scaled to the person's.
    forward, up
        Axes of the laboratory, for ``.trc`` and ``.c3d`` files.
    ignored_markers
        Markers that inverse kinematics does not use.
    marker_weights
        Weights of markers in inverse kinematics that differ from 1, by marker.
    inverse_kinematics
        Whose inverse kinematics is used: ``opensim`` or ``wrapjax``.
    feet
        Body, and columns or force plates, of each measured foot, by side.
    channels
        Muscles that each EMG channel drives, by channel.
    emg_kind
        ``raw`` or ``envelope``.
    volts
        Volts at the electrode per unit of the raw EMG file: unit over gain.
    accepted
        Channels that are used despite faults.
    maximal_contractions
        Recordings of maximal voluntary contractions, which normalise raw EMG; empty if not given.
    trials
        Trials, in the order of the file.
    """

    file: Path
    text: str
    name: str
    mass_kg: float
    side: str
    paretic: bool | None
    model_file: Path
    coordinates: tuple[str, ...]
    muscle_parameters: Path | None
    joints: Path | None
    scaling: Path | None
    scales_masses: bool
    forward: str
    up: str
    ignored_markers: tuple[str, ...]
    marker_weights: dict[str, float]
    inverse_kinematics: str
    feet: dict[str, ForceColumns]
    channels: dict[str, tuple[str, ...]]
    emg_kind: str
    volts: float
    accepted: tuple[str, ...]
    maximal_contractions: tuple[Path, ...]
    trials: tuple[LaboratoryTrial, ...]


def read_laboratory_settings(file: Path) -> LaboratorySettings:
    """Read laboratory settings; paths in the file are relative to its folder.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    file = Path(file)
    problems: list[Problem] = []
    text = read_toml_text(file)
    top = TableReader(parse_toml(text, file), file, "", problems)

    subject = TableReader(top.table("subject"), file, "[subject]", problems)
    name = subject.text("name") or ""
    mass = subject.number("mass_kg", lowest=5.0, highest=400.0, unit="kg")
    side = subject.text("side", choices=("l", "r")) or ""
    paretic = subject.boolean("paretic")
    subject.report_unknown_keys()

    model = TableReader(top.table("model"), file, "[model]", problems)
    model_file = existing_file(model, "file")
    coordinates = model.names("coordinates") or ()
    muscle_parameters = existing_file(model, "muscle_parameters", required=False)
    joints = existing_file(model, "joints", required=False)
    scaling = existing_file(model, "scaling", required=False)
    masses = model.boolean("scale_masses") or False
    if masses and scaling is not None:
        model.add_problem("scale_masses", "expected either scaling or scale_masses, found both")
    model.report_unknown_keys()

    laboratory = TableReader(top.raw("laboratory") or {}, file, "[laboratory]", problems)
    forward = laboratory.text("forward", required=False, choices=_AXES) or "x"
    up = laboratory.text("up", required=False, choices=_AXES) or "y"
    if forward[-1] == up[-1]:
        laboratory.add_problem("up", f"expected another axis than forward, found '{forward}' and '{up}'")
    laboratory.report_unknown_keys()

    markers = TableReader(top.raw("markers") or {}, file, "[markers]", problems)
    ignored = markers.names("ignore", required=False)
    weights = read_marker_weights(markers, problems)
    solver = markers.text("inverse_kinematics", required=False, choices=("opensim", "wrapjax"))
    markers.report_unknown_keys()

    feet = _read_feet(top, file, side, problems)

    emg = TableReader(top.table("emg"), file, "[emg]", problems)
    kind = emg.text("kind", required=False, choices=("raw", "envelope")) or "raw"
    unit = emg.text(
        "unit",
        required=kind == "raw",
        choices=tuple(VOLTS_PER_UNIT),
        if_missing='of envelopes, write kind = "envelope" in its place',
    )
    gain = emg.number("gain", lowest=1e-3, highest=1e7, unit="", required=False)
    if kind == "envelope" and (emg.has("unit") or emg.has("gain")):
        emg.add_problem(
            "", "expected no unit and no gain of envelopes, which are normalised to about 1, found one"
        )
    contractions = tuple(
        _file_beside(emg, "maximal_contractions", name)
        for name in emg.names("maximal_contractions", required=False) or ()
    )
    if contractions and kind == "envelope":
        emg.add_problem("maximal_contractions", "expected none of envelopes, which are normalised already")
    accepted = emg.names("accept", required=False)
    channels = read_channels(emg.table("channels"), file, problems)
    emg.report_unknown_keys()

    tables = top.tables("trial")
    trials = [_read_trial(table, number, file, problems) for number, table in enumerate(tables, start=1)]
    # `wrapjax joints` reads this table from the same file.
    top.raw("joints")
    top.report_unknown_keys()
    if problems:
        raise InputError(problems)
    assert mass is not None and model_file is not None and (unit is not None or kind == "envelope")
    return LaboratorySettings(
        file=file,
        text=text,
        name=name,
        mass_kg=mass,
        side=side,
        paretic=paretic,
        model_file=model_file,
        coordinates=coordinates,
        muscle_parameters=muscle_parameters,
        joints=joints,
        scaling=scaling,
        scales_masses=masses,
        forward=forward,
        up=up,
        ignored_markers=ignored or (),
        marker_weights=weights,
        inverse_kinematics=solver or "opensim",
        feet=feet,
        channels=channels,
        emg_kind=kind,
        volts=1.0 if unit is None else VOLTS_PER_UNIT[unit] / (gain or 1.0),
        accepted=accepted or (),
        maximal_contractions=tuple(path for path in contractions if path is not None),
        trials=tuple(trial for trial in trials if trial is not None),
    )


def existing_file(
    reader: TableReader, key: str, *, required: bool = True, if_missing: str = ""
) -> Path | None:
    """Read the path of a file, which may be outside the folder of the settings, and check that it exists."""
    value = reader.text(key, required=required, if_missing=if_missing)
    return None if value is None else _file_beside(reader, key, value)


def _file_beside(reader: TableReader, key: str, value: str) -> Path | None:
    """Return the path of a file, relative to the settings; report one that does not exist."""
    path = reader.file.parent / value
    try:
        exists = path.is_file()
    except OSError:  # an impossible file name, such as one that is too long
        exists = False
    if not exists:
        reader.add_problem(key, f"expected a file, found no {path}")
        return None
    return path


def read_marker_weights(markers: TableReader, problems: list[Problem]) -> dict[str, float]:
    """Read the weights of markers that differ from 1."""
    table = markers.raw("weights")
    if table is None:
        return {}
    reader = TableReader(table, markers.file, "[markers.weights]", problems)
    weights = {name: reader.number(name, lowest=1e-6, highest=1e6, unit="") for name in _keys(table)}
    return {name: weight for name, weight in weights.items() if weight is not None}


def _keys(table: object) -> list[str]:
    return list(table) if isinstance(table, dict) else []


def _read_feet(top: TableReader, file: Path, leg: str, problems: list[Problem]) -> dict[str, ForceColumns]:
    reader = TableReader(top.table("forces"), file, "[forces]", problems)
    feet = {}
    for side in SIDES:
        if not reader.has(side):
            continue
        foot = TableReader(reader.table(side), file, f"[forces.{side}]", problems)
        body = foot.text("body") or ""
        plates = foot.raw("plates")
        if plates is not None:
            if (
                not isinstance(plates, list)
                or not plates
                or not all(isinstance(n, int) and n > 0 for n in plates)
            ):
                foot.add_problem("plates", f"expected numbers from 1, found {describe_value(plates)}")
            else:
                feet[side] = ForceColumns(body, plates=tuple(plates))
        else:
            force, point = foot.text("force") or "", foot.text("point") or ""
            feet[side] = ForceColumns(body, force, point, foot.text("torque", required=False) or "")
        foot.report_unknown_keys()
    if leg and not reader.has(leg) and not reader.silent:
        message = f"expected [forces.{leg}], the ground reaction force on the leg's foot, found none"
        reader.add_problem("", message)
    reader.report_unknown_keys()
    return feet


def _read_trial(table: object, number: int, file: Path, problems: list[Problem]) -> LaboratoryTrial | None:
    reader = TableReader(table, file, f"[[trial]] number {number}", problems)
    name = reader.text("name")
    if name is not None and not TrialSettings.is_valid_name(name):
        reader.add_problem("name", f"expected letters, digits, '_', '-', '+' and '.', found '{name}'")
    use = reader.text("use", choices=("calibration", "validation"))
    speed = reader.number("speed_m_s", lowest=0.0, highest=15.0, unit="m/s", required=False)
    device = reader.has("dynamometer")
    if reader.has("markers") == reader.has("angles") and (reader.has("markers") or not device):
        found = "both" if reader.has("markers") else "neither"
        reader.add_problem("markers", f"expected either markers or angles, found {found}")
    markers, angles = (existing_file(reader, key, required=False) for key in ("markers", "angles"))
    task = read_task(reader)
    dynamometer = read_dynamometer(reader, file.parent)
    if device and task == GAIT:
        reader.add_problem("dynamometer", "is for other tasks than gait; state task and interval")
    if device and (reader.has("moments") or reader.has("forces")):
        reader.add_problem("dynamometer", "expected no moments and no forces beside a dynamometer")
    given = reader.has("moments") or device
    moments = existing_file(reader, "moments", required=False)
    moments_low_pass, low_pass = (
        reader.number(key, lowest=0.5, highest=100.0, unit="Hz", required=False)
        for key in ("moments_low_pass_hz", "low_pass_hz")
    )
    if moments_low_pass is not None and not given:
        reader.add_problem("moments_low_pass_hz", "states the filter of moments, of which no file is given")
    instead = 'or state moments = "FILE", the laboratory\'s inverse dynamics, with the cycles'
    forces = existing_file(reader, "forces", required=not given, if_missing=instead)
    at_rest = task == "passive" and not reader.has("emg")
    emg = None if at_rest else existing_file(reader, "emg")
    if task != GAIT:
        cycles = read_intervals(reader)
    else:
        listed = reader.has("cycles") or reader.has("cycle") or not reader.has("forces")
        cycles = read_cycles(reader) if listed else ()
        reader.raw("cycle"), reader.raw("cycles")
    posture, condition = read_posture(reader), reader.text("condition", required=False)
    steps = _read_steps(reader, problems)
    reader.report_unknown_keys()
    if name is None or use is None or task is None or (device and dynamometer is None):
        return None
    if (markers is None) == (angles is None) and not device:
        return None
    if (forces is None and moments is None and not device) or (emg is None and not at_rest):
        return None
    return LaboratoryTrial(
        name,
        use,
        math.nan if speed is None else speed,
        markers,
        angles,
        forces,
        emg,
        cycles,
        task,
        condition or "",
        posture,
        moments,
        math.nan if moments_low_pass is None else moments_low_pass,
        math.nan if low_pass is None else low_pass,
        steps,
        dynamometer,
    )


def _read_steps(reader: TableReader, problems: list[Problem]) -> dict[str, tuple[tuple[float, float], ...]]:
    """Read ``steps = { l = [[t0, t1], ...], r = [...] }``: steps whose foot a person states."""
    table = reader.raw("steps")
    if table is None:
        return {}
    own = TableReader(table, reader.file, f"{reader.place} steps", problems)
    found = {side: read_spans_of(own, side) for side in SIDES if own.has(side)}
    own.report_unknown_keys()
    return found


def named_rotation(forward: str, up: str) -> Float[np.ndarray, "3 3"]:
    """Compute `laboratory_rotation` from axes that a user has named.

    Raises
    ------
    InputError
        If a name is unknown or both name the same axis.
    """
    problems = [
        Problem(f"--{key}", f"expected one of {', '.join(_AXES)}, found '{name}'")
        for key, name in (("forward", forward), ("up", up))
        if name not in _AXES
    ]
    if not problems and forward[-1] == up[-1]:
        message = f"expected another axis than forward, found '{forward}' and '{up}'"
        problems = [Problem("--up", message)]
    if problems:
        raise InputError(problems)
    return laboratory_rotation(forward, up)


def laboratory_rotation(forward: str, up: str) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation from a laboratory's axes to OpenSim's: x forward, y up, z to the right.

    Parameters
    ----------
    forward, up
        Axes of the laboratory that point forward and up: ``x``, ``-x``, ``y``, ``-y``, ``z`` or ``-z``.

    Returns
    -------
    Float[np.ndarray, "3 3"]
        Rotation matrix; it multiplies column vectors in laboratory axes.
    """
    x_axis, y_axis = (_unit_vector(name) for name in (forward, up))
    return np.array([x_axis, y_axis, np.cross(x_axis, y_axis)])


def _unit_vector(name: str) -> Float[np.ndarray, " 3"]:
    axis = np.zeros(3)
    axis["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return axis
