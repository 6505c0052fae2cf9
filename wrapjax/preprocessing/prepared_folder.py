"""A prepared leg, written as a subject folder."""

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
from wrapjax.io.toml import quoted, quoted_list
from wrapjax.preprocessing.alignment import Check
from wrapjax.preprocessing.force_plates import FootForces, write_forces
from wrapjax.preprocessing.joint_angles import Motion
from wrapjax.preprocessing.laboratory_settings import RawSettings, RawTrial
from wrapjax.subject.settings import SETTINGS_FILE

MODEL_FILE = "model.osim"
PARAMETERS_FILE = "muscle_parameters.csv"
#: What the laboratory's settings said, word for word; paths in it start from where they were.
PREPARED_FROM = "prepared_from.toml"


@dataclass(frozen=True)
class PreparedTrial:
    """A recording made ready.

    Parameters
    ----------
    trial
        What the settings say of it.
    cycles
        Start and end of each gait cycle in s.
    cutoff_hz
        Of the low-pass filter of motion and forces.
    motion
        All coordinates, filtered.
    moments
        Series by OpenSim's label (``hip_flexion_l_moment``), N m or N, at the times of ``motion``.
    forces
        On the feet, filtered.
    needed_time, needed_force
        s; upward force that bears and accelerates all bodies of the model in this motion, N.
    emg_time, volts
        s; raw EMG at the electrode (V), or envelopes without unit, one row a channel in the order of the
        settings.
    checks
        What was compared, with numbers.
    notes
        What was repaired, or is worth knowing.
    """

    trial: RawTrial
    cycles: tuple[tuple[float, float], ...]
    cutoff_hz: float
    motion: Motion
    moments: dict[str, Float[np.ndarray, " frame"]]
    forces: FootForces
    needed_time: Float[np.ndarray, " needed_frame"]
    needed_force: Float[np.ndarray, " needed_frame"]
    emg_time: Float[np.ndarray, " sample"]
    volts: Float[np.ndarray, "channel sample"]
    checks: tuple[Check, ...]
    notes: tuple[str, ...]


def write_folder(
    folder: Path, settings: RawSettings, model_file: Path, trials: Sequence[PreparedTrial]
) -> None:
    """Fill an empty folder: settings, what they were made of, model, trials."""
    shutil.copyfile(model_file, folder / MODEL_FILE)
    if settings.muscle_parameters is not None:
        shutil.copyfile(settings.muscle_parameters, folder / PARAMETERS_FILE)
    for prepared in trials:
        _write_trial(folder / "trials" / prepared.trial.name, settings, prepared)
    write_text(folder / SETTINGS_FILE, _settings_text(settings, trials))
    write_text(folder / PREPARED_FROM, settings.text)


def _write_trial(folder: Path, settings: RawSettings, prepared: PreparedTrial) -> None:
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
    title = "raw EMG in V" if settings.emg_kind == "raw" else "EMG envelopes"
    volts = Storage(title, tuple(settings.channels), prepared.emg_time, prepared.volts.T)
    write_storage(folder / "emg.sto", volts)
    write_forces(folder, prepared.forces, settings.feet)


def _settings_text(settings: RawSettings, trials: Sequence[PreparedTrial]) -> str:
    lines = [
        f"# Written by 'wrapjax prepare' by {PREPARED_FROM}; what was checked is in preparation.json.",
        "[subject]",
        f"name = {quoted(settings.name)}",
        f"mass_kg = {settings.mass_kg!r}",
        f'side = "{settings.side}"',
        *([] if settings.paretic is None else [f"paretic = {str(settings.paretic).lower()}"]),
        "",
        "[model]",
        f'file = "{MODEL_FILE}"',
        f"coordinates = {quoted_list(settings.coordinates)}",
        *([f'muscle_parameters = "{PARAMETERS_FILE}"'] if settings.muscle_parameters else []),
        "",
        "[emg]",
        f'kind = "{settings.emg_kind}"',
        "[emg.channels]",
        *(f"{quoted(channel)} = {quoted_list(muscles)}" for channel, muscles in settings.channels.items()),
    ]
    for prepared in trials:
        trial = prepared.trial
        files = {kind: f"{kind}.sto" for kind in ("angles", "moments", "emg")}
        files |= {"ground_forces": "ground_forces.mot", "external_loads": "external_loads.xml"}
        lines += ["", "[[trial]]", f"name = {quoted(trial.name)}", f'use = "{trial.use}"']
        lines += [] if math.isnan(trial.speed) else [f"speed_m_s = {trial.speed!r}"]
        lines += [f"{kind} = {quoted(f'trials/{trial.name}/{file}')}" for kind, file in files.items()]
        cycles = ", ".join(f"[{start!r}, {end!r}]" for start, end in prepared.cycles)
        lines.append(f"cycles = [{cycles}]")
    return "\n".join(lines) + "\n"
