"""Small simulated subject with differing cycles, so that a diagnosis runs all its steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.subject.synthetic import CHANNELS, COORDINATES, angles, emg, moments, write_subject
from wrapjax.io.storage import Storage, write_storage

#: Duration of walking (s), and its cycles of length `tests.subject.synthetic.PERIOD`.
_DURATION, _CYCLES = 10.0, "[[0.5, 1.7], [1.7, 2.9], [2.9, 4.1], [4.1, 5.3], [5.3, 6.5]]"
_RATE = 100.0
#: Standard deviations of moments (N m) and of envelopes between cycles.
_MOMENT_SD, _EMG_SD = 1.0, 0.03


def write_walking_subject(folder: Path, seed: int) -> Path:
    """Write the subject of the tests (two coordinates, two muscles) with five noisy cycles.

    Returns
    -------
    Path
        Folder of the subject.
    """
    write_subject(folder)
    settings = folder / "subject.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace("[[0.5, 1.7], [1.7, 2.9]]", _CYCLES), encoding="utf-8")
    generator = np.random.default_rng(seed)
    time = np.arange(round(_DURATION * _RATE) + 1) / _RATE
    place = folder / "trials" / "walk_a"
    columns = tuple(f"{name}_moment" for name in COORDINATES)
    measured = moments(time) + _MOMENT_SD * _smooth_noise(generator, time, len(COORDINATES))
    drive = np.clip(emg(time) + _EMG_SD * _smooth_noise(generator, time, len(CHANNELS)), 0.0, 1.0)
    write_storage(place / "angles.sto", Storage("angles", COORDINATES, time, angles(time).T))
    write_storage(place / "moments.sto", Storage("moments", columns, time, measured.T))
    write_storage(place / "emg.sto", Storage("emg", tuple(CHANNELS), time, drive.T))
    return folder


def _smooth_noise(generator: np.random.Generator, time: np.ndarray, rows: int) -> np.ndarray:
    """Draw smooth noise of unit variance: sines with periods other than the gait cycle."""
    rates = generator.uniform(0.3, 4.0, (rows, 12, 1))
    phases = generator.uniform(0.0, 2.0 * np.pi, (rows, 12, 1))
    return np.sqrt(2.0 / 12.0) * np.sin(2.0 * np.pi * rates * time + phases).sum(axis=1)
