"""Ground reaction forces: reading, center of pressure, filter, writing, and axes of the laboratory."""

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, write_storage
from wrapjax.preprocessing.files.laboratory_settings import laboratory_rotation
from wrapjax.preprocessing.files.markers import low_pass
from wrapjax.preprocessing.gait.force_plates import (
    ForceColumns,
    centers_of_pressure,
    read_force_columns,
    write_forces,
)
from wrapjax.subject.external_loads import read_external_loads

TIME = np.arange(1000) / 1000.0
FEET = {"l": ForceColumns("calcn_l", "l_v", "l_p", "l_t"), "r": ForceColumns("calcn_r", "r_v", "r_p")}


@pytest.fixture
def file(tmp_path):
    """Stance of the left foot from 0.2 to 0.8 s at (0.3, 0, -0.1) m; the point is arbitrary otherwise."""
    on = (TIME > 0.2) & (TIME < 0.8)
    force = np.array([30.0, 700.0, -20.0])[:, None] * np.sin(np.pi * (TIME - 0.2) / 0.6) * on
    point = np.where(on, np.array([[0.3], [0.0], [-0.1]]), 9e3)
    torque = np.array([[0.0], [4.0], [0.0]]) * on
    nothing = np.zeros_like(force)
    names = [
        f"{side}_{kind}{axis}"
        for side, kinds in (("l", "vpt"), ("r", "vp"))
        for kind in kinds
        for axis in "xyz"
    ]
    values = np.concatenate([force, point, torque, nothing, 9e3 + nothing])
    write_storage(tmp_path / "forces.mot", Storage("forces", tuple(names), TIME, values.T))
    return tmp_path / "forces.mot"


def test_center_of_pressure_is_at_the_foot(file):
    forces = read_force_columns(file, FEET)
    centers = centers_of_pressure(forces.filtered(6.0).wrench)
    middle = (TIME > 0.3) & (TIME < 0.7)
    # Arbitrary points in the file have no effect; the last center is kept while the foot is in the air.
    np.testing.assert_allclose(centers[0][:, middle].T - [0.3, 0.0, -0.1], 0.0, atol=1e-6)
    assert np.abs(centers).max() < 0.5
    assert not centers[1].any()


def test_written_forces_are_the_same_wrench(file, tmp_path):
    forces = read_force_columns(file, FEET).filtered(6.0)
    write_forces(tmp_path, forces, FEET)
    loads = read_external_loads(tmp_path / "external_loads.xml")
    assert [load.body for load in loads] == ["calcn_l", "calcn_r"]
    again = {
        side: ForceColumns(load.body, load.force, load.point, load.torque)
        for side, load in zip("lr", loads, strict=True)
    }
    read = read_force_columns(tmp_path / "ground_forces.mot", again)
    np.testing.assert_allclose(read.wrench, forces.wrench, atol=1e-9)


def test_missing_columns_are_reported(file):
    with pytest.raises(InputError, match=r"column l_wx: is not in the file; did you mean 'l_vx'"):
        read_force_columns(file, {"l": ForceColumns("calcn_l", "l_w", "l_p")})


def test_gain_of_the_filter_without_delay():
    """Run twice, a second-order Butterworth filter has the gain 1 / (1 + (f / fc)^4)."""
    time = np.arange(20000) / 1000.0
    for frequency in (2.0, 6.0, 12.0):
        wave = np.cos(2.0 * np.pi * frequency * (time - 10.0))
        gain = 1.0 / (1.0 + (frequency / 6.0) ** 4)
        np.testing.assert_allclose(
            low_pass(time, wave[None], 6.0)[0, 5000:15000], gain * wave[5000:15000], atol=2e-3
        )


def test_rotation_from_laboratory_axes_to_those_of_opensim():
    axes = laboratory_rotation("-y", "z")
    np.testing.assert_array_equal(axes @ [0.0, -1.0, 0.0], [1.0, 0.0, 0.0])  # forward
    np.testing.assert_array_equal(axes @ [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])  # up
    assert np.linalg.det(axes) == 1.0
