"""Defends: a C3D file gives markers, analog channels and plates as they were, in OpenSim's axes."""

import subprocess
import sys

import numpy as np
import pytest

from tests.preprocessing import c3d_file
from tests.preprocessing.c3d_file import FRAMES, PLACES, RATE, RATIO
from wrapjax.errors import InputError
from wrapjax.preprocessing.c3d import _wrench, read_c3d_analog, read_c3d_markers, read_plates
from wrapjax.preprocessing.force_plates import ForceColumns, centers_of_pressure
from wrapjax.preprocessing.laboratory_settings import laboratory_rotation


@pytest.fixture(scope="module", params=["1", "-1"], ids=["pushes", "pulls"])
def file(request, tmp_path_factory):
    """Two markers, the second one hidden for a while; 700 N on the plate by either sign; one EMG channel."""
    path = tmp_path_factory.mktemp("c3d") / "walk.c3d"
    return _written(path, request.param, "mm")


def _written(path, sign, unit):
    # In a process of its own: ezc3d cannot write where OpenSim has been imported.
    subprocess.run([sys.executable, c3d_file.__file__, str(path), sign, unit], check=True)
    return path


def test_markers(file):
    markers = read_c3d_markers(file)
    assert markers.names == ("KNEE", "HEEL") and markers.time[0] == 0.0
    np.testing.assert_allclose(markers.rate, RATE)
    np.testing.assert_allclose(markers.positions[:, 0], PLACES / 1000.0, rtol=1e-6)
    assert np.isnan(markers.positions[1, 20:25]).all() and np.isfinite(markers.positions[0]).all()


def test_analog_channels(file):
    table = read_c3d_analog(file)
    assert table.columns[-1] == "soleus" and table.time.size == FRAMES * RATIO
    np.testing.assert_allclose(np.diff(table.time), 1e-3)
    np.testing.assert_allclose(table.values[:, -1], np.sin(np.arange(FRAMES * RATIO)), atol=1e-6)


def test_the_ground_pushes_up_where_the_foot_is(file):
    """The plate's axes are the corners': x along its 0.4 m here, so 80 mm along it are 80 mm along y."""
    forces = read_plates(file, {"l": ForceColumns("calcn_l", plates=(1,))}, laboratory_rotation("x", "z"))
    assert forces.wrench.shape == (1, 6, FRAMES * RATIO)
    np.testing.assert_allclose(forces.wrench[0, 3:, 5], [0.0, 700.0, 0.0], atol=1e-3)
    ahead, _, right = centers_of_pressure(forces.wrench)[0, :, 5]
    # The laboratory's y points to the left.
    np.testing.assert_allclose([abs(ahead - 0.3), abs(-right - 0.2)], [0.05, 0.08], atol=1e-4)


def test_a_plate_that_is_not_there_is_told(file):
    with pytest.raises(InputError, match=r"force plate 2, found 1 plates"):
        read_plates(file, {"r": ForceColumns("calcn_r", plates=(2,))}, np.eye(3))


@pytest.mark.parametrize("unit", ["", " ", "furlong"])
def test_plates_without_a_known_unit_of_length_are_told(tmp_path, unit):
    file = _written(tmp_path / "walk.c3d", "1", unit)
    with pytest.raises(InputError, match=rf"expected m, .* as POINT:UNITS, found '{unit.strip()}'"):
        read_plates(file, {"l": ForceColumns("calcn_l", plates=(1,))}, laboratory_rotation("x", "z"))


def test_a_plate_in_no_known_unit_of_length_is_told(tmp_path):
    """Plates may be given a unit of their own by whoever reads the file."""
    plate = {"unit_position": "", "unit_moment": "Nm", "unit_force": "N"}
    with pytest.raises(InputError, match="as the unit of force plates' corners, found ''"):
        _wrench(plate, np.eye(3), tmp_path)


def test_other_files_are_refused(tmp_path):
    file = tmp_path / "walk.c3d"
    file.write_bytes(b"no such thing" * 100)
    with pytest.raises(InputError, match="cannot be read as a C3D file"):
        read_c3d_markers(file)
