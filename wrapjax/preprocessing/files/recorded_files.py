"""Files of one recording of a laboratory: motion, forces and EMG, read as recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.errors import InputError, Problem, nearest_name
from wrapjax.geometry.skeleton.model_description import Coordinate
from wrapjax.io.model_file import ModelFile
from wrapjax.io.storage import Storage, read_storage
from wrapjax.preprocessing.checks.emg_quality import emg_faults, envelope_faults
from wrapjax.preprocessing.files.c3d import is_c3d, read_c3d_analog, read_c3d_markers, read_plates
from wrapjax.preprocessing.files.joint_angles import Motion, read_motion
from wrapjax.preprocessing.files.laboratory_settings import (
    LaboratorySettings,
    LaboratoryTrial,
    laboratory_rotation,
)
from wrapjax.preprocessing.files.markers import Markers, match_markers, read_trc
from wrapjax.preprocessing.gait.force_plates import FootForces, read_force_columns
from wrapjax.subject.emg_envelopes import resample_evenly, sampling_rate
from wrapjax.subject.recordings import MIN_RAW_EMG_RATE


@dataclass(frozen=True)
class PreparationModel:
    """Scaled model for the preparation of all trials.

    Parameters
    ----------
    path
        File of the model (``.osim``).
    file
        Content of the file.
    coupled
        Coupled coordinates, from `find_coupled_coordinates`.
    markers
        Names of its markers.
    """

    path: Path
    file: ModelFile
    coupled: Mapping[str, Coordinate]
    markers: tuple[str, ...]


@dataclass(frozen=True)
class RecordedFiles:
    """Content of a recording's files, as recorded.

    Parameters
    ----------
    motion
        Markers, or joint angles that the laboratory computed.
    forces
        Ground reaction forces, None if there are none.
    emg_time, volts
        Times, s, and raw EMG at the electrode (V) or envelopes, None if there is none.
    notes
        Remarks for the user.
    """

    motion: Markers | Motion
    forces: FootForces | None
    emg_time: Float[np.ndarray, " sample"] | None
    volts: Float[np.ndarray, "channel sample"] | None
    notes: tuple[str, ...]

    @property
    def covered(self) -> dict[str, tuple[float, float]]:
        """First and last time of each kind of signal, s."""
        times = {
            "motion": self.motion.time,
            "forces": None if self.forces is None else self.forces.time,
            "EMG": self.emg_time,
        }
        return {kind: (float(time[0]), float(time[-1])) for kind, time in times.items() if time is not None}


def read_files(
    trial: LaboratoryTrial, settings: LaboratorySettings, model: PreparationModel
) -> RecordedFiles:
    """Read the files of a recording.

    Raises
    ------
    InputError
        With all faults of a file.
    """
    forces = None if trial.forces is None else _read_forces(trial.forces, settings)
    emg_time, volts = (None, None) if trial.emg is None else read_emg(trial.emg, settings)
    notes: list[str] = []
    recorded = _read_recorded_motion(trial, settings, model, notes)
    return RecordedFiles(recorded, forces, emg_time, volts, tuple(notes))


def _read_forces(path: Path, settings: LaboratorySettings) -> FootForces:
    plates = is_c3d(path)
    key = "plates" if plates else "force"
    problems = [
        Problem(str(settings.file), f"expected {key}, needed to read {path}", f"[forces.{side}]")
        for side, foot in settings.feet.items()
        if bool(foot.plates) != plates
    ]
    if problems:
        raise InputError(problems)
    if plates:
        return read_plates(path, settings.feet, laboratory_rotation(settings.forward, settings.up))
    return read_force_columns(path, settings.feet)


def _read_recorded_motion(
    trial: LaboratoryTrial, settings: LaboratorySettings, model: PreparationModel, notes: list[str]
) -> Markers | Motion:
    """Read joint angles, or the markers that the model has."""
    if trial.dynamometer is not None and trial.markers is None and trial.angles is None:
        # The device's angle is read with its torque.
        start, end = min(one[0] for one in trial.cycles), max(one[1] for one in trial.cycles)
        return Motion((), np.array([start, end]), np.zeros((0, 2)))
    if trial.angles is not None:
        return read_motion(trial.angles, model.file.coordinates, model.coupled, settings.coordinates, notes)
    assert trial.markers is not None
    read = read_c3d_markers if is_c3d(trial.markers) else read_trc
    markers = read(trial.markers).rotated(laboratory_rotation(settings.forward, settings.up))
    names = match_markers(markers, model.markers, settings.ignored_markers, trial.markers)
    missing = [name for name in model.markers if name not in names and name not in settings.ignored_markers]
    if missing:
        notes.append(f"{trial.markers}: lacks the markers {', '.join(missing)} of the model")
    return markers.select(names)


def read_emg(
    path: Path, settings: LaboratorySettings
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "channel sample"]]:
    """Read raw EMG at the electrode (V) or envelopes, and raise an error for faulty channels.

    Parameters
    ----------
    path
        Table, or C3D file with the channels.
    settings
        Laboratory settings, with channels and unit.

    Returns
    -------
    time, emg
        Times, s, evenly spaced, and the channels in the order of the settings.

    Raises
    ------
    InputError
        With all faults of the file.
    """
    table: Storage = read_c3d_analog(path) if is_c3d(path) else read_storage(path, trust_row_count=False)
    missing = [name for name in settings.channels if name not in table.columns]
    problems = [
        Problem(str(path), "is not in the file", f"column {name}", nearest_name(name, table.columns))
        for name in missing
    ]
    rate = sampling_rate(table.time)
    raw = settings.emg_kind == "raw"
    if raw and rate < MIN_RAW_EMG_RATE:
        message = f"expected raw EMG at {MIN_RAW_EMG_RATE:g} Hz or more, found {rate:.4g} Hz"
        problems.append(Problem(str(path), message, hint='are these envelopes? Write kind = "envelope"'))
    if problems:
        raise InputError(problems)
    columns = [table.columns.index(name) for name in settings.channels]
    time, volts = resample_evenly(table.time, table.values.T[columns] * settings.volts)
    names = tuple(settings.channels)
    found = emg_faults(names, volts, rate) if raw else envelope_faults(names, volts)
    faults = [
        Problem(str(path), message, f"channel {channel}", hint)
        for channel, message, hint in found
        if channel not in settings.accepted
    ]
    if faults:
        raise InputError(faults)
    return time, volts
