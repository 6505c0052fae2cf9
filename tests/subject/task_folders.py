"""Synthetic subject folders with trials of other tasks than gait."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.subject.synthetic import CHANNELS, COORDINATES, RATE, write_subject
from wrapjax.io.storage import Storage, write_storage

#: Duration of the recordings of tasks, s.
DURATION = 6.0
#: Settings of each trial besides its files; without "emg = rest" it has EMG.
PASSIVE = 'task = "passive"\nposture = { hip_flexion_l = 10.0 }\ninterval = [1.0, 4.7]'
SQUAT = 'task = "movement"\nintervals = [[2.5, 5.0], [5.2, 5.6]]'
ISOMETRIC = 'task = "isometric"\ninterval = [2.6, 5.3]'


def time_of() -> np.ndarray:
    return np.arange(round(DURATION * RATE) + 1) / RATE


def slow_angles(time: np.ndarray) -> np.ndarray:
    """Compute joint angles of a slow movement in rad, one row per coordinate."""
    return np.array([0.3 + 0.5 * np.sin(1.1 * time), 0.7 + 0.6 * np.sin(1.1 * time)])


def slow_emg(time: np.ndarray) -> np.ndarray:
    """Compute irregular EMG envelopes, one row per channel, between 0 and 1."""
    return 0.4 + np.array([0.3 * np.sin(2.3 * time + 0.4), 0.25 * np.cos(3.1 * time) ** 3])


def slow_moments(time: np.ndarray) -> np.ndarray:
    """Compute joint moments in N m, one row per coordinate; the second falls as its angle rises."""
    return np.array([15.0 * np.cos(1.7 * time), -12.0 * np.sin(1.1 * time)])


def add_trial(
    folder: Path,
    name: str,
    settings: str,
    *,
    use: str = "calibration",
    angles=slow_angles,
    moments=slow_moments,
    emg=slow_emg,
    angle_columns: tuple[str, ...] = COORDINATES,
    moment_columns: tuple[str, ...] = COORDINATES,
) -> Path:
    """Add a trial; ``emg`` is None for a passive trial without EMG. Columns select signals by coordinate."""
    time, place = time_of(), folder / "trials" / name
    files = {
        "angles": (angle_columns, angles(time)[[COORDINATES.index(one) for one in angle_columns]]),
        "moments": (
            tuple(f"{one}_moment" for one in moment_columns),
            moments(time)[[COORDINATES.index(one) for one in moment_columns]],
        ),
    }
    if emg is not None:
        files["emg"] = (tuple(CHANNELS), emg(time))
    lines = [f'{kind} = "trials/{name}/{kind}.sto"' for kind in files]
    for kind, (columns, values) in files.items():
        write_storage(place / f"{kind}.sto", Storage(kind, columns, time, values.T))
    table = "\n".join(["", "[[trial]]", f'name = "{name}"', f'use = "{use}"', *lines, settings, ""])
    file = folder / "subject.toml"
    file.write_text(file.read_text() + table)
    return folder


def write_mixed_subject(folder: Path) -> Path:
    """Write walking, a passive rotation of the knee, and a squat; one moment in the passive trial."""
    write_subject(folder)
    knee = ("knee_angle_l",)
    add_trial(folder, "knee", PASSIVE, emg=None, angle_columns=knee, moment_columns=knee)
    return add_trial(folder, "squat", SQUAT)


def without_gait(folder: Path) -> Path:
    """Remove the walking trials from a folder's settings."""
    file = folder / "subject.toml"
    text = file.read_text()
    start = text.index("[[trial]]")
    others = text[start:].split("[[trial]]")[3:]
    file.write_text(text[:start] + "".join(f"[[trial]]{one}" for one in others))
    return folder
