"""``wrapjax prepare`` beyond walking: other tasks, a laboratory's own moments, and recorded running."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.preprocessing import walker
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """The walker's files with angles in place of markers, and moments that a laboratory computed."""
    return walker.write_laboratory_with_angles(tmp_path_factory.mktemp("lab"))


@pytest.fixture(scope="module")
def walked(run, laboratory, tmp_path_factory):
    folder = tmp_path_factory.mktemp("prepared") / "walker"
    outcome = run("prepare", laboratory, "--out", folder)
    assert outcome.status == 0, outcome.progress
    return folder


def prepare(run, laboratory, folder, *changes):
    text = laboratory.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    settings = laboratory.parent / f"{folder.name}.toml"
    settings.write_text(text)
    return run("prepare", settings, "--out", folder)


def test_a_laboratory_s_moments_replace_inverse_dynamics(run, laboratory, walked, tmp_path):
    """Moments whose filter is stated are taken unchanged; forces are not needed, and cycles are listed."""
    given = read_storage(walked / "trials" / "walk" / "moments.sto")
    write_storage(laboratory.parent / "id.sto", given)
    cycles = json.loads((walked / "preparation.json").read_text())["trials"]["walk"]["cycles"]
    lines = f'moments = "id.sto"\nmoments_low_pass_hz = 6\ncycles = {cycles}'
    outcome = prepare(run, laboratory, tmp_path / "own", ('forces = "forces.mot"', lines))
    assert outcome.status == 0, outcome.progress
    assert "low-passed by it at 6 Hz and not again" in outcome.output
    found, expected = load_subject(tmp_path / "own").trials, load_subject(walked).trials
    np.testing.assert_allclose(found.moments, expected.moments, atol=0.02)
    assert "ground_forces" not in (tmp_path / "own" / "subject.toml").read_text()
    filtered = lines.replace("moments_low_pass_hz = 6\n", "")
    outcome = prepare(run, laboratory, tmp_path / "alike", ('forces = "forces.mot"', filtered))
    assert outcome.status == 0 and "like the motion" in outcome.output
    change = load_subject(tmp_path / "alike").trials.moments - expected.moments
    assert 0.02 < np.abs(change).max() < 15.0


def test_moments_that_do_not_cover_the_cycles_are_refused(run, laboratory, walked, tmp_path):
    given = read_storage(walked / "trials" / "walk" / "moments.sto")
    half = given.time < 2.0
    write_storage(
        laboratory.parent / "short.sto", replace(given, time=given.time[half], values=given.values[half])
    )
    lines = 'moments = "short.sto"\ncycles = [[0.5, 1.6], [1.6, 2.7]]'
    outcome = prepare(run, laboratory, tmp_path / "short", ('forces = "forces.mot"', lines))
    assert outcome.status == 2 and "expected moments from 0.5 to 2.7 s" in outcome.progress
    renamed = replace(
        given, columns=tuple(name.replace("knee_angle_l_m", "knee_m") for name in given.columns)
    )
    write_storage(laboratory.parent / "short.sto", renamed)
    outcome = prepare(run, laboratory, tmp_path / "named", ('forces = "forces.mot"', lines))
    assert outcome.status == 2 and "column knee_angle_l_moment: is not in the file" in outcome.progress


def test_an_interval_of_a_movement_is_prepared(run, laboratory, tmp_path):
    lines = 'task = "movement"\ncondition = "brace"\ninterval = [0.9, 3.4]\nforces = "forces.mot"'
    outcome = prepare(run, laboratory, tmp_path / "squat", ('forces = "forces.mot"', lines))
    assert outcome.status == 0, outcome.progress
    trials = load_subject(tmp_path / "squat").trials
    assert set(trials.tasks) == {"movement"} and set(trials.conditions) == {"brace"}
    assert trials.counted.sum() == 251
    content = json.loads((tmp_path / "squat" / "preparation.json").read_text())["trials"]["walk"]
    assert content["motion_and_force_low_pass_hz"] == 6.0
    assert "support" in [check["what"] for check in content["checks"]]


def test_a_movement_with_a_foot_beside_its_plate_is_refused(run, laboratory, tmp_path):
    file = laboratory.parent / "forces.mot"
    table = read_storage(file)
    right = [place for place, name in enumerate(table.columns) if name.startswith("right_v")]
    values = table.values.copy()
    values[:, right] *= (table.time < 1.6)[:, None]
    write_storage(laboratory.parent / "beside.mot", replace(table, values=values))
    lines = 'task = "movement"\ninterval = [0.9, 3.4]\nforces = "beside.mot"'
    outcome = prepare(run, laboratory, tmp_path / "beside", ('forces = "forces.mot"', lines))
    assert outcome.status == 2
    assert "expected all contact with the ground on plates" in outcome.progress
    assert not (tmp_path / "beside").exists()


BAD = {
    "moments and no filter": ("moments_low_pass_hz = 6\nforces =", "of which no file is given"),
    "no forces and no moments": ("#", "forces: expected"),
    "foot of a step": ("steps = { x = [[1.0, 2.0]] }\nforces =", "steps x: is not a known key"),
    "interval outside": ('task = "movement"\ninterval = [1.0, 9.0]\nforces =', "expected intervals that all"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_settings_are_named(run, laboratory, tmp_path, case):
    lines, words = BAD[case]
    outcome = prepare(run, laboratory, tmp_path / "bad", ('forces = "forces.mot"', f'{lines} "forces.mot"'))
    assert outcome.status == 2 and words in outcome.progress, outcome.progress


RUNNER = """[subject]
name = "runner"
mass_kg = 58.03
side = "r"
[model]
file = "{source}/model.osim"
coordinates = ["knee_angle_r", "ankle_angle_r"]
[forces.r]
body = "calcn_r"
force = "ground_force_v"
point = "ground_force_p"
torque = "ground_torque_"
[forces.l]
body = "calcn_l"
force = "l_ground_force_v"
point = "l_ground_force_p"
torque = "l_ground_torque_"
[emg]
kind = "envelope"
[emg.channels]
soleus_r = ["soleus_r"]
vas_lat_r = ["vas_lat_r"]
[[trial]]
name = "run"
use = "calibration"
angles = "ik.sto"
forces = "XLD.mot"
emg = "emgFilt.sto"
"""


def test_recorded_running_is_prepared(run, data_folder, tmp_path):
    """All steps of 10 s of running, some of them on both belts, give cycles."""
    source = data_folder / "healthy_running"
    for name in ("ik.sto", "XLD.mot", "emgFilt.sto"):
        table = read_storage(source / "lab" / name)
        keep = table.time < 10.0
        write_storage(tmp_path / name, replace(table, time=table.time[keep], values=table.values[keep]))
    settings = tmp_path / "prepare.toml"
    settings.write_text(RUNNER.format(source=source))
    outcome = run("prepare", settings, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.progress
    assert "gait with flight phases" in outcome.output and "exchanged?" not in outcome.output
    page = (tmp_path / "out" / "report.html").read_text()
    assert ", from joint angles, ground forces and EMG envelopes." in page
    # A temporary name of the folder.
    assert ".part" not in page
    trials = load_subject(tmp_path / "out").trials
    durations = trials.time[:, -1] - trials.time[:, 0]
    assert len(trials) >= 11 and np.all((durations > 0.7) & (durations < 0.85))
    # Every cycle begins where the one before ends: none is missing.
    np.testing.assert_allclose(trials.time[1:, 0], trials.time[:-1, -1], atol=1e-9)
    exchanged = settings.read_text()
    for old, new in (("forces.l]", "forces.?]"), ("forces.r]", "forces.l]"), ("forces.?]", "forces.r]")):
        exchanged = exchanged.replace(old, new)
    for old, new in (("calcn_l", "calcn_?"), ("calcn_r", "calcn_l"), ("calcn_?", "calcn_r")):
        exchanged = exchanged.replace(old, new)
    settings.write_text(exchanged)
    outcome = run("prepare", settings, "--out", tmp_path / "exchanged")
    assert outcome.status == 0 and "are [forces.l] and [forces.r] exchanged?" in outcome.output
    again = load_subject(tmp_path / "exchanged").trials
    np.testing.assert_allclose(again.moments, trials.moments, atol=1e-9)


def test_masses_alone_are_scaled_and_it_is_said_what_stays_generic(run, laboratory, tmp_path):
    changes = (
        ('file = "scaled.osim"', 'file = "scaled.osim"\nscale_masses = true'),
        (f"mass_kg = {walker.MASS}", f"mass_kg = {1.2 * walker.MASS}"),
        ('forces = "forces.mot"', 'moments = "id.sto"\ncycles = [[0.5, 1.6], [1.6, 2.7]]'),
    )
    time = np.linspace(0.0, walker.DURATION, 431)
    labels = tuple(f"{name}_moment" for name in walker.COORDINATES)
    moments = np.array([30.0 * np.sin(6.0 * time + place) for place in range(3)])
    write_storage(laboratory.parent / "id.sto", walker.Storage("moments", labels, time, moments.T))
    outcome = prepare(run, laboratory, tmp_path / "heavier", *changes)
    assert outcome.status == 0, outcome.progress
    assert "multiplied by 1.2, to 84 kg" in outcome.output and "generic" in outcome.output
    models = [
        read_model_file(file) for file in (laboratory.parent / "scaled.osim", tmp_path / "heavier/model.osim")
    ]
    assert models[1].mass_kg == pytest.approx(1.2 * models[0].mass_kg)
    assert models[1].muscles.names == models[0].muscles.names


DEVICE = """[[trial]]
name = "knee_passive"
use = "calibration"
task = "passive"
interval = [1.0, 19.0]
posture = {{ {posture} }}
[trial.dynamometer]
file = "{file}"
coordinate = "knee_angle_l"
time = "s"
angle = "deg"
torque = "Nm"
"""


def device_settings(laboratory, name, torque, posture="hip_flexion_l = 80.0, ankle_angle_l = 0.0"):
    """Settings of a laboratory whose only trial is a slow rotation of the knee by a dynamometer."""
    time = np.arange(0.0, 20.0, 0.02)
    angle = 50.0 - 40.0 * np.cos(2.0 * np.pi * time / 10.0)
    rows = np.column_stack([time, angle, torque(angle)])
    file = laboratory.parent / f"{name}.csv"
    np.savetxt(file, rows, delimiter=",", header="s,deg,Nm", comments="")
    text = laboratory.read_text()
    trial = DEVICE.format(file=file.name, posture=posture)
    settings = laboratory.parent / f"{name}.toml"
    settings.write_text(text[: text.index("[[trial]]")] + trial)
    return settings


def test_a_dynamometer_trial_becomes_a_trial_of_its_coordinate(run, laboratory, tmp_path):
    settings = device_settings(laboratory, "knee", lambda angle: 0.2 * (45.0 - angle))
    outcome = run("prepare", settings, "--out", tmp_path / "knee")
    assert outcome.status == 0, outcome.progress
    assert "no weight of limb and lever arm was subtracted" in outcome.output
    trials = load_subject(tmp_path / "knee").trials
    column = trials.moment_coordinates.index("knee_angle_l")
    measured = np.isfinite(trials.moments).any(axis=(0, 2))
    assert measured.tolist() == [place == column for place in range(len(measured))]
    angle = trials.angles[:, trials.coordinates.index("knee_angle_l")]
    expected = 0.2 * (45.0 - np.degrees(angle))[trials.counted]
    np.testing.assert_allclose(trials.moments[:, column][trials.counted], expected, atol=0.02)


def test_the_posture_of_the_other_joints_is_asked_for(run, laboratory, tmp_path):
    settings = device_settings(laboratory, "posed", lambda angle: 45.0 - angle, "hip_flexion_l = 80.0")
    outcome = run("prepare", settings, "--out", tmp_path / "posed")
    assert outcome.status == 2
    assert "expected the posture of every other coordinate, found none of ankle_angle_l" in outcome.progress


@pytest.mark.parametrize(
    ("name", "torque", "words"),
    [
        ("centimeters", lambda angle: 20.0 * (45.0 - angle), 'torque_unit = "N cm"'),
        ("reversed", lambda angle: -0.2 * (45.0 - angle), "a passive moment that falls as the angle rises"),
    ],
)
def test_a_torque_in_another_unit_or_of_opposite_sign_is_refused(
    run, laboratory, tmp_path, name, torque, words
):
    outcome = run("prepare", device_settings(laboratory, name, torque), "--out", tmp_path / name)
    assert outcome.status == 2 and words in outcome.progress, outcome.progress
    assert len(outcome.progress.strip().splitlines()) == 1 and not (tmp_path / name).exists()
