"""Writing of prepared trials as a subject folder."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.io.files import write_text
from wrapjax.io.storage import Storage, write_storage
from wrapjax.io.toml import toml_list, toml_string
from wrapjax.preprocessing.checks.consistency_checks import Check
from wrapjax.preprocessing.files.joint_angles import Motion
from wrapjax.preprocessing.files.laboratory_settings import LaboratorySettings, LaboratoryTrial
from wrapjax.preprocessing.gait.force_plates import FootForces, write_forces
from wrapjax.subject.joint_spread import JOINTS_FILE
from wrapjax.subject.settings import SETTINGS_FILE
from wrapjax.subject.trials import GAIT

#: Names of files in the subject folder.
MODEL_FILE = "model.osim"
PARAMETERS_FILE = "muscle_parameters.csv"
#: Copy of the laboratory settings; its paths are relative to the folder of the original file.
PREPARED_FROM = "prepared_from.toml"
#: Title of tables of raw EMG.
RAW_TITLE = "raw EMG in V"
#: Folder of recordings of maximal contractions.
CONTRACTIONS = "maximal_contractions"


@dataclass(frozen=True)
class PreparedTrial:
    """Recording with solved motion and moments.

    Parameters
    ----------
    trial
        Settings of the recording.
    cycles
        Start and end of each gait cycle in s.
    cutoff_hz
        Cut-off frequency of the low-pass filter of motion and forces, Hz.
    motion
        All coordinates, filtered.
    moments
        Generalised forces of inverse dynamics, N m or N, at the times of ``motion``, by OpenSim's label
        (``hip_flexion_l_moment``).
    forces
        Ground reaction forces on the feet, filtered; None if there are none.
    required_time, required_force
        Times, s, and the upward force that supports and accelerates all bodies of the model, N.
    emg_time, volts
        Times, s, and raw EMG at the electrode, V, or dimensionless envelopes, in the order of the channels in
        the settings; None if there is none.
    checks
        Results of the checks.
    notes
        Repairs and remarks for the user.
    """

    trial: LaboratoryTrial
    cycles: tuple[tuple[float, float], ...]
    cutoff_hz: float
    motion: Motion
    moments: dict[str, Float[np.ndarray, " frame"]]
    forces: FootForces | None
    required_time: Float[np.ndarray, " required_frame"]
    required_force: Float[np.ndarray, " required_frame"]
    emg_time: Float[np.ndarray, " sample"] | None
    volts: Float[np.ndarray, "channel sample"] | None
    checks: tuple[Check, ...]
    notes: tuple[str, ...]


def write_subject_folder(
    folder: Path,
    settings: LaboratorySettings,
    model_file: Path,
    trials: Sequence[PreparedTrial],
    contractions: Sequence[Storage],
) -> None:
    """Write settings, laboratory settings, model, trials and maximal contractions into an empty folder."""
    shutil.copyfile(model_file, folder / MODEL_FILE)
    if settings.muscle_parameters is not None:
        shutil.copyfile(settings.muscle_parameters, folder / PARAMETERS_FILE)
    if settings.joints is not None:
        shutil.copyfile(settings.joints, folder / JOINTS_FILE)
    for prepared in trials:
        _write_trial(folder / "trials" / prepared.trial.name, settings, prepared)
    for number, contraction in enumerate(contractions, start=1):
        (folder / CONTRACTIONS).mkdir(exist_ok=True)
        write_storage(folder / _contraction(number), contraction)
    write_text(folder / SETTINGS_FILE, _settings_text(settings, trials, len(contractions)))
    write_text(folder / PREPARED_FROM, settings.text)


def _write_trial(folder: Path, settings: LaboratorySettings, prepared: PreparedTrial) -> None:
    folder.mkdir(parents=True)
    motion = prepared.motion
    write_storage(
        folder / "angles.sto", Storage("Coordinates", motion.coordinates, motion.time, motion.values.T)
    )
    moments = Storage(
        "Inverse Dynamics Generalized Forces",
        tuple(prepared.moments),
        motion.time,
        np.array(list(prepared.moments.values())).T,
    )
    write_storage(folder / "moments.sto", moments)
    if prepared.emg_time is not None and prepared.volts is not None:
        title = RAW_TITLE if settings.emg_kind == "raw" else "EMG envelopes"
        volts = Storage(title, tuple(settings.channels), prepared.emg_time, prepared.volts.T)
        write_storage(folder / "emg.sto", volts)
    if prepared.forces is not None:
        write_forces(folder, prepared.forces, settings.feet)


def _contraction(number: int) -> str:
    return f"{CONTRACTIONS}/{number:02d}.sto"


def _settings_text(settings: LaboratorySettings, trials: Sequence[PreparedTrial], contractions: int) -> str:
    normalising = [_contraction(number) for number in range(1, contractions + 1)]
    lines = [
        f"# Written by 'wrapjax prepare' from {PREPARED_FROM}; the checks are in preparation.json.",
        "[subject]",
        f"name = {toml_string(settings.name)}",
        f"mass_kg = {settings.mass_kg!r}",
        f'side = "{settings.side}"',
        *([] if settings.paretic is None else [f"paretic = {str(settings.paretic).lower()}"]),
        "",
        "[model]",
        f'file = "{MODEL_FILE}"',
        f"coordinates = {toml_list(settings.coordinates)}",
        *([f'muscle_parameters = "{PARAMETERS_FILE}"'] if settings.muscle_parameters else []),
        *([f'joints = "{JOINTS_FILE}"'] if settings.joints else []),
        "",
        "[emg]",
        f'kind = "{settings.emg_kind}"',
        *([f"maximal_contractions = {toml_list(normalising)}"] if normalising else []),
        "[emg.channels]",
        *(f"{toml_string(channel)} = {toml_list(muscles)}" for channel, muscles in settings.channels.items()),
    ]
    for prepared in trials:
        trial = prepared.trial
        files = {kind: f"{kind}.sto" for kind in ("angles", "moments")}
        files |= {} if prepared.volts is None else {"emg": "emg.sto"}
        if prepared.forces is not None:
            files |= {"ground_forces": "ground_forces.mot", "external_loads": "external_loads.xml"}
        lines += ["", "[[trial]]", f"name = {toml_string(trial.name)}", f'use = "{trial.use}"']
        lines += [] if math.isnan(trial.speed) else [f"speed_m_s = {trial.speed!r}"]
        lines += [f"{kind} = {toml_string(f'trials/{trial.name}/{file}')}" for kind, file in files.items()]
        cycles = ", ".join(f"[{start!r}, {end!r}]" for start, end in prepared.cycles)
        if trial.task == GAIT:
            lines.append(f"cycles = [{cycles}]")
        else:
            lines += [f'task = "{trial.task}"', f"intervals = [{cycles}]"]
        if trial.condition:
            lines.append(f"condition = {toml_string(trial.condition)}")
        if trial.posture:
            stated = ", ".join(f"{toml_string(name)} = {value!r}" for name, value in trial.posture)
            lines.append(f"posture = {{ {stated} }}")
    return "\n".join(lines) + "\n"
