"""Settings of joint personalisation: model, marker files, what is freed; read from TOML.

The file may be the laboratory settings of ``wrapjax prepare``: tables that say nothing about markers are left
alone, and a table ``[joints]`` says what to free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem
from wrapjax.io.toml import TableReader, describe_value, read_toml
from wrapjax.joints.freed_parameters import FreedParameter, PriorWidths
from wrapjax.preprocessing.files.laboratory_settings import (
    existing_file,
    laboratory_rotation,
    read_marker_weights,
)

#: Name of the settings in a subject folder.
SETTINGS_FILE = "joints.toml"
_AXES = ("x", "-x", "y", "-y", "z", "-z")
#: Default root mean square of the movement of a marker with the joint angles, m. Skin moves by 3 to 30 mm
#: against the bone, most on the thigh (Leardini et al. 2005, doi:10.1016/j.gaitpost.2004.05.002; Peters et
#: al. 2010, Gait Posture 31:1); clusters move together, and less.
SKIN_MOVEMENT = 0.005
#: Default number of frames that take part in the estimation; all frames take part in the errors.
FRAMES = 100
#: Share of the last frames of each trial that is held out, where no trial is for validation.
HELD_OUT_SHARE = 0.25
#: Largest time in an interval, s.
MAX_TIME = 1e6


@dataclass(frozen=True)
class MarkerTrial:
    """Recording of markers.

    Parameters
    ----------
    name
        Name, unique among the trials.
    file
        File of the markers (``.trc``, ``.c3d``).
    use
        ``calibration`` or ``validation``.
    weight
        Weight of the trial in the cost.
    interval
        Start and end, s; None for the whole file.
    markers
        Names of the markers to use; None for all.
    """

    name: str
    file: Path
    use: str = "calibration"
    weight: float = 1.0
    interval: tuple[float, float] | None = None
    markers: tuple[str, ...] | None = None


@dataclass(frozen=True)
class JointSettings:
    """Settings of joint personalisation.

    Parameters
    ----------
    file
        Settings file, for messages.
    name
        Name of the person.
    model_file
        OpenSim model (``.osim``), scaled to the person or generic.
    trials
        Recordings of markers.
    marker_set
        Marker set to add to the model (``.xml``), or None.
    rotation
        Rotation from the laboratory's axes to OpenSim's.
    ignored_markers
        Markers that are not used.
    marker_weights
        Weights of markers that differ from 1.
    joints
        Names of the joints to free; None for all with markers enough on both sides.
    scales
        ``none``, ``uniform`` or ``axes``.
    free_markers
        Whether markers move on their bodies.
    parameters
        Freed parameters one by one, in place of ``joints``, ``scales`` and ``free_markers``.
    widths
        Prior standard deviations.
    prior_factor
        Factor on all prior standard deviations.
    skin_movement
        Root mean square movement of a marker with the joint angles, m; 0 for none.
    symmetric
        Whether changes of joints and scales of one side are those of the other, mirrored.
    frames
        Largest number of frames that take part in the estimation.
    """

    file: Path
    name: str
    model_file: Path
    trials: tuple[MarkerTrial, ...]
    marker_set: Path | None = None
    rotation: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    ignored_markers: tuple[str, ...] = ()
    marker_weights: dict[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] | None = None
    scales: str = "uniform"
    free_markers: bool = True
    parameters: tuple[FreedParameter, ...] | None = None
    widths: PriorWidths = field(default_factory=PriorWidths)
    prior_factor: float = 1.0
    skin_movement: float = SKIN_MOVEMENT
    symmetric: bool = False
    frames: int = FRAMES


def read_joint_settings(file: Path | str) -> JointSettings:
    """Read settings from TOML, or from a folder that holds ``joints.toml``; paths are relative to the file.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    file = Path(file)
    if file.is_dir():
        if not (file / SETTINGS_FILE).is_file():
            message = f"expected {SETTINGS_FILE} in the folder, which names its marker files, found none"
            raise InputError(Problem(str(file), message))
        file = file / SETTINGS_FILE
    problems: list[Problem] = []
    top = TableReader(read_toml(file), file, "", problems)
    subject = TableReader(top.raw("subject") or {}, file, "[subject]", problems)
    model = TableReader(top.table("model"), file, "[model]", problems)
    model_file, marker_set = existing_file(model, "file"), existing_file(model, "marker_set", required=False)
    laboratory = TableReader(top.raw("laboratory") or {}, file, "[laboratory]", problems)
    forward = laboratory.text("forward", required=False, choices=_AXES) or "x"
    up = laboratory.text("up", required=False, choices=_AXES) or "y"
    if forward[-1] == up[-1]:
        laboratory.add_problem("up", f"expected another axis than forward, found '{forward}' and '{up}'")
    markers = TableReader(top.raw("markers") or {}, file, "[markers]", problems)
    ignored = markers.names("ignore", required=False) or ()
    weights = read_marker_weights(markers, problems)
    joints = _read_joints(top.raw("joints") or {}, file, problems)
    trials = _read_trials(top, file, problems)
    if problems:
        raise InputError(problems)
    assert model_file is not None
    return JointSettings(
        file=file,
        name=subject.text("name", required=False) or file.resolve().parent.name,
        model_file=model_file,
        trials=trials,
        marker_set=marker_set,
        rotation=laboratory_rotation(forward, up),
        ignored_markers=ignored,
        marker_weights=weights,
        **joints,
    )


def _read_joints(table: Any, file: Path, problems: list[Problem]) -> dict[str, Any]:
    """Read ``[joints]``."""
    reader = TableReader(table, file, "[joints]", problems)
    found: dict[str, Any] = {
        "joints": reader.names("free", required=False),
        "scales": reader.text("scales", required=False, choices=("none", "uniform", "axes")) or "uniform",
    }
    move = reader.boolean("markers")
    found["free_markers"] = True if move is None else move
    found["symmetric"] = bool(reader.boolean("symmetric"))
    factor = reader.number("prior_factor", lowest=1e-3, highest=1e6, unit="", required=False)
    found["prior_factor"] = 1.0 if factor is None else factor
    skin = reader.number("skin_movement_mm", lowest=0.0, highest=50.0, unit="mm", required=False)
    found["skin_movement"] = SKIN_MOVEMENT if skin is None else 1e-3 * skin
    frames = reader.number("frames", lowest=10, highest=100_000, unit="", required=False)
    found["frames"] = FRAMES if frames is None else int(frames)
    reader.report_unknown_keys()
    return found


def _read_trials(top: TableReader, file: Path, problems: list[Problem]) -> tuple[MarkerTrial, ...]:
    """Read the trials that have markers; those of joint angles are left alone."""
    trials: list[MarkerTrial] = []
    for number, table in enumerate(top.tables("trial"), start=1):
        reader = TableReader(table, file, f"[[trial]] number {number}", problems)
        if not reader.has("markers"):
            continue
        name = reader.text("name") or ""
        path = existing_file(reader, "markers")
        use = reader.text("use", required=False, choices=("calibration", "validation")) or "calibration"
        weight = reader.number("weight", lowest=1e-6, highest=1e6, unit="", required=False)
        interval = reader.raw("interval")
        if interval is not None and not _is_interval(interval):
            reader.add_problem("interval", f"expected [start, end] in s, found {describe_value(interval)}")
            interval = None
        if any(trial.name == name for trial in trials):
            reader.add_problem("name", f"expected another name than those of other trials, found '{name}'")
        if path is not None:
            span = None if interval is None else (float(interval[0]), float(interval[1]))
            trials.append(MarkerTrial(name, path, use, 1.0 if weight is None else weight, span))
    if not any(trial.use == "calibration" for trial in trials) and not problems:
        message = 'expected a [[trial]] with markers and use = "calibration", found none'
        problems.append(Problem(str(file), message))
    return tuple(trials)


def _is_interval(value: Any) -> bool:
    numbers = isinstance(value, list) and len(value) == 2 and all(type(n) in (int, float) for n in value)
    return bool(numbers and -MAX_TIME < value[0] < value[1] < MAX_TIME)
