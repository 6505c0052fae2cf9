"""Defends: a dynamometer's torque becomes the moment of the joint alone, or is refused in one sentence."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from tests.preprocessing import analog_file
from wrapjax.errors import InputError
from wrapjax.io.toml import TableReader
from wrapjax.preprocessing.dynamometer import (
    DynamometerSettings,
    compare_angles,
    read_device_trial,
    read_dynamometer,
)

RATE, MASS = 100.0, 70.0
TIME = np.arange(0.0, 20.0, 1.0 / RATE)
INTERVALS = ((1.0, 19.0),)
#: The device counts plantarflexion from 90 degrees, and its torque has the sign of the person's push.
DEVICE_ZERO = np.radians(90.0)


def ankle(time) -> np.ndarray:
    """A slow rotation between 30 degrees of plantarflexion and 15 of dorsiflexion, rad."""
    return np.radians(-7.5 - 22.5 * np.cos(2.0 * np.pi * time / 10.0))


def weight(angle) -> np.ndarray:
    """Weight of foot and plate about the ankle, and the zero error of the torque, N m."""
    return 6.0 * np.cos(angle + 0.3) + 1.5


def passive(angle) -> np.ndarray:
    """Moment of relaxed tissue, N m: it falls as the angle rises."""
    return -3.0 * np.expm1(4.0 * (angle + 0.2))


def write(file: Path, angle, moment, scale: float = 1.0, sign: int = -1) -> Path:
    """Write what the device records: degrees of plantarflexion, and torque of the other sign."""
    device = np.degrees(DEVICE_ZERO - angle)
    rows = np.column_stack([TIME, device, scale * sign * moment])
    np.savetxt(file, rows, delimiter=",", header="time,angle,torque", comments="")
    return file


def settings(file: Path, **changes) -> DynamometerSettings:
    own = DynamometerSettings(
        file=file,
        coordinate="ankle_angle_r",
        time="time",
        angle="angle",
        torque="torque",
        rate_hz=np.nan,
        start=0.0,
        torque_unit="N m",
        angle_unit="deg",
        torque_sign=-1,
        angle_sign=-1,
        angle_offset=DEVICE_ZERO,
        weight_trial=None,
        still=(),
    )
    return replace(own, **changes)


def read(own, task="passive"):
    return read_device_trial(own, task, MASS, INTERVALS, 6.0)


def inside(trial):
    return (trial.time > 1.0) & (trial.time < 19.0)


def test_weight_by_a_gravity_trial_leaves_the_passive_moment(tmp_path):
    angle = ankle(TIME)
    measured = write(tmp_path / "ankle.csv", angle, passive(angle) + weight(angle))
    alone = write(tmp_path / "gravity.csv", angle, weight(angle))
    found = read(settings(measured, weight_trial=alone))
    keep = inside(found)
    np.testing.assert_allclose(found.angle[keep], ankle(found.time[keep]), atol=1e-4)
    np.testing.assert_allclose(found.moment[keep], passive(ankle(found.time[keep])), atol=0.02)
    assert "weight of limb and lever arm 6 N m, offset of the torque 1.5 N m" in found.notes[1]
    assert "of opposite sign" in found.notes[0] and "90 degrees" in found.notes[0]


@pytest.mark.parametrize("nested", [False, True])
def test_mat_and_csv_give_the_same(tmp_path, nested):
    angle = ankle(TIME)
    text = read(settings(write(tmp_path / "ankle.csv", angle, passive(angle))))
    columns = {"time": TIME, "angle": np.degrees(DEVICE_ZERO - angle), "torque": -passive(angle)}
    savemat(tmp_path / "ankle.mat", {"trial": columns} if nested else columns)
    names = {key: f"trial.{key}" if nested else key for key in columns}
    matlab = read(settings(tmp_path / "ankle.mat", **names))
    np.testing.assert_allclose(matlab.moment, text.moment, atol=1e-9)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Analog channels in V of a C3D file: 0.02 V for 1 N m, 0.1 V for 1 degree."""
    folder = tmp_path_factory.mktemp("device")
    angle = ankle(TIME)
    volts = np.column_stack([0.1 * np.degrees(DEVICE_ZERO - angle), -0.02 * passive(angle)])
    np.savetxt(folder / "volts.csv", volts, delimiter=",", header="Position,Torque", comments="")
    # In a separate process, as ezc3d cannot write after OpenSim has been imported.
    arguments = [str(folder / "ankle.c3d"), str(folder / "volts.csv"), str(RATE)]
    subprocess.run([sys.executable, analog_file.__file__, *arguments], check=True)
    return folder / "ankle.c3d"


def test_channels_of_a_c3d_file_in_volts_give_the_same(tmp_path, recorded):
    angle = ankle(TIME)
    text = read(settings(write(tmp_path / "ankle.csv", angle, passive(angle))))
    names = {"time": "", "angle": "Position", "torque": "Torque"}
    found = read(settings(recorded, **names, torque_scale=50.0, angle_scale=10.0))
    np.testing.assert_allclose(found.moment, text.moment, atol=1e-4)
    np.testing.assert_allclose(found.angle, text.angle, atol=1e-6)
    assert "in 50 N m" in found.notes[0] and "angle in 10 deg" in found.notes[0]
    with pytest.raises(InputError, match="did you mean 'Torque'"):
        read(settings(recorded, **names | {"torque": "torque"}))


def test_weight_by_a_cubic_through_still_samples(tmp_path):
    """Ramps at four angles; before each, the relaxed limb is held still for 2 s."""
    step = (TIME // 5.0).astype(int)
    angle = np.radians(np.array([-30.0, -15.0, 0.0, 15.0]))[step]
    effort = 40.0 * np.sin(np.pi * np.clip(TIME % 5.0 - 2.5, 0.0, 2.0) / 2.0) ** 2
    file = write(tmp_path / "ramps.csv", angle, effort + weight(angle))
    still = tuple((start + 0.3, start + 2.0) for start in (0.0, 5.0, 10.0, 15.0))
    found = read(settings(file, still=still), "isometric")
    peaks = [found.moment[(found.time > at) & (found.time < at + 5.0)].max() for at in (0.0, 5.0, 10.0, 15.0)]
    np.testing.assert_allclose(peaks, 40.0, atol=0.5)
    assert "degree 3 through 4 still intervals at 4 angles" in found.notes[1]


def test_torque_in_newton_centimeters_is_refused_unless_stated(tmp_path):
    angle = ankle(TIME)
    file = write(tmp_path / "ankle.csv", angle, passive(angle), scale=100.0)
    with pytest.raises(InputError, match="N m per kg of body mass in a trial of task 'passive'") as caught:
        read(settings(file))
    assert 'torque_unit = "N cm"' in str(caught.value)
    stated = read(settings(file, torque_unit="N cm"))
    keep = inside(stated)
    np.testing.assert_allclose(stated.moment[keep], passive(ankle(stated.time[keep])), atol=0.02)


def test_passive_torque_of_the_wrong_sign_is_refused(tmp_path):
    angle = ankle(TIME)
    file = write(tmp_path / "ankle.csv", angle, passive(angle))
    with pytest.raises(InputError, match="expected a passive moment that falls as the angle rises"):
        read(settings(file, torque_sign=1))


def test_angle_of_opposite_sign_to_the_motion_is_refused(tmp_path):
    angle = ankle(TIME)
    file = write(tmp_path / "ankle.csv", angle, np.zeros_like(angle) + 5.0)
    own = settings(file)
    note = compare_angles(own, read(own, "isometric"), TIME, angle + np.radians(2.0))
    assert "differs by 2.0 degrees" in note
    turned = settings(file, angle_sign=1, angle_offset=-DEVICE_ZERO)
    with pytest.raises(InputError, match="found the opposite sign") as caught:
        compare_angles(turned, read(turned, "isometric"), TIME, angle)
    assert "angle_sign = -1" in str(caught.value)


FAULTS = {
    "no such column": ({"torque": "Torque"}, "did you mean 'torque'"),
    "still samples of a passive trial": ({"still": ((0.0, 1.0),)}, "would be subtracted with the weight"),
    "a full turn": ({"angle_unit": "rad"}, "more than a full turn"),
    "samples elsewhere": ({"start": 100.0}, "found samples from 100 to"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_faults_are_named(tmp_path, case):
    changes, words = FAULTS[case]
    angle = ankle(TIME)
    file = write(tmp_path / "ankle.csv", angle, passive(angle))
    with pytest.raises(InputError) as caught:
        read(settings(file, **changes))
    assert words in str(caught.value) and str(file) in str(caught.value)


def test_files_that_are_no_tables_are_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(128, 256)))
    (tmp_path / "b.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    (tmp_path / "c.csv").write_text("time,angle,torque\n0,1,x\n1,2,3\n")
    (tmp_path / "d.csv").write_text("time;angle;torque\n0;1,5;2\n0;2,5;3\n")
    for name, words in (
        ("a.csv", "expected text"),
        ("b.mat", "MATLAB file"),
        ("c.csv", "expected a number in line 2, found 'x'"),
        ("d.csv", "expected rising times"),
    ):
        with pytest.raises(InputError, match=words):
            read(settings(tmp_path / name))


TABLE = {"file": "ankle.csv", "coordinate": "ankle_angle_r", "angle": "a", "torque": "t", "rate_hz": 100}


def read_table(folder, **changes):
    (folder / "ankle.csv").write_text("a,t\n0,0\n")
    problems: list = []
    table = {key: value for key, value in (TABLE | changes).items() if value is not None}
    reader = TableReader({"dynamometer": table}, folder / "lab.toml", "[[trial]] number 1", problems)
    return read_dynamometer(reader, folder), [str(one) for one in problems]


def test_settings_are_read_and_their_faults_named(tmp_path):
    found, problems = read_table(tmp_path, torque_sign=-1, angle_offset_deg=90)
    assert not problems and found.torque_sign == -1 and found.angle_sign == 1
    assert found.angle_offset == pytest.approx(np.pi / 2)
    (tmp_path / "ankle.c3d").write_bytes(b"")
    found, problems = read_table(tmp_path, file="ankle.c3d", rate_hz=None, torque_scale=50.0)
    assert not problems and found.torque_scale == 50.0 and found.angle_scale == 1.0
    for changes, words in (
        ({"file": "ankle.c3d"}, "time: expected neither time nor rate_hz"),
        ({"weight_trial": "ankle.c3d"}, "weight_trial: expected a file of the same kind"),
        ({"torque_scale": 0.0}, "torque_scale: expected a number"),
        ({"time": "t"}, "either a column of times or rate_hz"),
        ({"torque_unit": "Nm"}, "torque_unit: expected 'N m'"),
        ({"torque_sign": 0.5}, "torque_sign: expected 1 or -1"),
        ({"weight_trial": "none.csv"}, "weight_trial: expected a file"),
        ({"axis": "x"}, "axis: is not a known key"),
        ({"coordinate": None}, "coordinate: expected text"),
    ):
        found, problems = read_table(tmp_path, **changes)
        assert found is None and any(words in one for one in problems), (changes, problems)
