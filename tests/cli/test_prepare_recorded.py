"""``wrapjax prepare`` on recorded walking: accepted unchanged, refused with a simulated error.

Angles and forces are recorded; raw EMG is simulated from the recorded envelopes.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.preprocessing.synthetic_emg import emg_noise
from wrapjax.io.storage import Storage, read_storage, write_storage

RATE = 1000.0
#: What the labels of forces, points and torques start with, by side.
LABELS = {
    "healthy_overground": {side: f"ground_{{}}_{side}_" for side in "lr"},
    "healthy_treadmill": {"l": "1_ground_{}_", "r": "ground_{}_"},
}


def write_laboratory(folder, source, cycles=""):
    """Write a laboratory's files, and return its settings."""
    walk = source / "trials" / "walk"
    for name in ("angles.sto", "ground_forces.mot"):
        (folder / name).write_bytes((walk / name).read_bytes())
    (folder / "model.osim").write_bytes((source / "model.osim").read_bytes())
    envelopes = read_storage(walk / "emg.sto")
    time = np.arange(envelopes.time[0], envelopes.time[-1], 1.0 / RATE)
    generator = np.random.default_rng(0)
    shape = np.array([np.interp(time, envelopes.time, np.maximum(row, 0.0)) for row in envelopes.values.T])
    volts = 3e-4 * shape * emg_noise(generator, shape.shape, RATE)
    volts += 2e-6 * generator.standard_normal(shape.shape)
    write_storage(folder / "emg.sto", Storage("raw", envelopes.columns, time, volts.T))
    subject = (source / "subject.toml").read_text()
    head, rest = subject.split("[emg]")
    channels = rest[rest.index("[emg.channels]") :].split("[[trial]]")[0]
    feet = "".join(
        f'[forces.{side}]\nbody = "calcn_{side}"\nforce = "{label.format("force")}v"\n'
        f'point = "{label.format("force")}p"\ntorque = "{label.format("torque")}"\n'
        for side, label in LABELS[source.name].items()
    )
    settings = folder / "prepare.toml"
    settings.write_text(
        f'{head}{feet}[emg]\nunit = "V"\n{channels}[[trial]]\nname = "walk"\nuse = "calibration"\n'
        f'angles = "angles.sto"\nforces = "ground_forces.mot"\nemg = "emg.sto"\n{cycles}\n'
    )
    return settings


@pytest.fixture
def overground(data_folder, tmp_path):
    return write_laboratory(tmp_path, data_folder / "healthy_overground", "cycles = [[0.45, 1.41]]")


def test_forces_50_ms_late_are_refused_with_the_lag(run, overground):
    file = overground.parent / "ground_forces.mot"
    forces = read_storage(file)
    write_storage(file, replace(forces, time=forces.time + 0.05))
    outcome = run("prepare", overground, "--out", overground.parent / "out")
    assert outcome.status == 2
    (line,) = (line for line in outcome.progress.splitlines() if line.startswith("error"))
    assert "timing of forces" in line and "as 50 ms late" in line


@pytest.mark.parametrize(("shift", "said"), [(0.0, ""), (0.05, "ms late"), (-0.05, "ms early")])
def test_one_measured_foot_detects_a_shift_of_50_ms(run, overground, shift, said):
    text = overground.read_text()
    start, end = text.index("[forces.l]"), text.index("[forces.r]")
    overground.write_text(text[:start] + text[end:])
    file = overground.parent / "ground_forces.mot"
    forces = read_storage(file)
    write_storage(file, replace(forces, time=forces.time + shift))
    outcome = run("prepare", overground, "--out", overground.parent / "out")
    assert outcome.status == (2 if said else 0), outcome.progress
    assert said in outcome.progress and ("timing of forces" in outcome.progress) == bool(said)


def test_swapped_legs_are_refused(run, overground):
    text = overground.read_text()
    for old, new in (("_r_", "_?_"), ("_l_", "_r_"), ("_?_", "_l_")):
        text = text.replace(f'"ground_force{old}', f'"ground_force{new}')
    overground.write_text(text)
    outcome = run("prepare", overground, "--out", overground.parent / "out")
    assert outcome.status == 2 and outcome.progress.count("the legs are swapped") == 2


def test_recorded_walking_is_accepted(run, overground):
    outcome = run("prepare", overground, "--out", overground.parent / "out")
    assert outcome.status == 0, outcome.progress
    assert outcome.output.count("is in degrees") == 2  # the patellae
    assert "forces agree best with motion as recorded" in outcome.output


def test_a_minute_on_a_treadmill_gives_its_53_cycles(run, data_folder, tmp_path):
    """Two have moments unlike all others, by 18.9 N m at the ankle and 14.3 at the knee: they are named."""
    settings = write_laboratory(tmp_path, data_folder / "healthy_treadmill")
    outcome = run("prepare", settings, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.progress
    assert (tmp_path / "out" / "subject.toml").read_text().count("], [") == 52 - 2
    notes = (tmp_path / "out" / "preparation.json").read_text()
    assert notes.count("s dropped: ") == 2
    assert "cycle 3.22 to 4.3 s dropped: ankle_angle_l_moment" in notes
    assert "cycle 58.84 to 59.94 s dropped: knee_angle_l_moment" in notes
