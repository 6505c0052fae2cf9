"""Tests of inverse kinematics and inverse dynamics by OpenSim's tools, and of their output and errors."""

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.io.model_file import read_model_file
from wrapjax.io.storage import read_storage
from wrapjax.osim.model import describe_model
from wrapjax.osim.tools import solve_inverse_dynamics, solve_inverse_kinematics
from wrapjax.preprocessing.files.joint_angles import find_coupled_coordinates, read_motion

#: Hip, knee and ankle of both legs.
JOINTS = tuple(
    f"{name}_{side}"
    for name in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")
    for side in "lr"
)


def moment_differences(folder, coordinates, time, values):
    """Root mean square differences (N m) from the published moments of the recording."""
    # The published moments were computed with the tool's filter at 6 Hz.
    loads = folder / "trials" / "walk" / "external_loads.xml"
    found = solve_inverse_dynamics(folder / "model.osim", coordinates, time, values, loads, 6.0)
    published = read_storage(folder / "trials" / "walk" / "moments.sto")
    return {
        name: float(np.sqrt(np.mean((found[f"{name}_moment"] - _column(published, f"{name}_moment")) ** 2)))
        for name in JOINTS
    }


def _column(table, name):
    return table.values[:, table.columns.index(name)]


def test_published_moments_are_reproduced_with_patellae_in_radians(data_folder, capfd):
    """Without conversion, patella angles in degrees would explain all differences."""
    folder = data_folder / "healthy_overground"
    file = folder / "trials" / "walk" / "angles.sto"
    infos = read_model_file(folder / "model.osim").coordinates
    couplers = find_coupled_coordinates(describe_model(folder / "model.osim").coordinates)
    notes = []
    motion = read_motion(file, infos, couplers, JOINTS, notes)
    assert sorted(couplers) == ["knee_angle_l_beta", "knee_angle_r_beta"]
    assert len(notes) == 2 and all("is in degrees" in note for note in notes)
    differences = moment_differences(folder, motion.coordinates, motion.time, motion.values)
    assert max(differences.values()) < 0.3, differences

    table = read_storage(file)
    names = [label.split("/")[-2] for label in table.columns]
    unconverted = moment_differences(folder, names, table.time, table.values.T)
    assert unconverted["hip_flexion_r"] > 50.0 and unconverted["ankle_angle_r"] < 0.3
    assert capfd.readouterr().out == ""


def test_failures_of_tools_are_input_errors(odd_model, tmp_path):
    time = np.arange(20) / 100.0
    with pytest.raises(InputError, match=r"absent\.xml: OpenSim's inverse dynamics stopped"):
        solve_inverse_dynamics(odd_model, ("hip",), time, np.zeros((1, 20)), tmp_path / "absent.xml")
    with pytest.raises(InputError, match=r"absent\.trc: OpenSim's inverse kinematics stopped"):
        solve_inverse_kinematics(odd_model, tmp_path / "absent.trc", {}, 0.0, 1.0)
