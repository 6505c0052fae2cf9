"""Reading of markers, analog channels and force plates from C3D files."""

import subprocess
import sys

import numpy as np
import pytest

from tests.preprocessing import c3d_file
from tests.preprocessing.c3d_file import FRAMES, PLACES, RATE, RATIO
from wrapjax.errors import InputError
from wrapjax.preprocessing.files.c3d import _wrench, read_c3d_analog, read_c3d_markers, read_plates
from wrapjax.preprocessing.files.laboratory_settings import laboratory_rotation
from wrapjax.preprocessing.gait.force_plates import ForceColumns, centers_of_pressure


@pytest.fixture(scope="module", params=["1", "-1"], ids=["pushes", "pulls"])
def file(request, tmp_path_factory):
    """Two markers, one of them with a gap; 700 N of either sign on the plate; one EMG channel."""
    path = tmp_path_factory.mktemp("c3d") / "walk.c3d"
    return _written(path, request.param, "mm")


def _written(path, sign, unit):
    # In a separate process, as ezc3d cannot write after OpenSim has been imported.
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


def test_force_is_upward_and_at_the_center_of_pressure(file):
    """The plate's axes are given by its corners: its x axis is the laboratory's y axis here."""
    forces = read_plates(file, {"l": ForceColumns("calcn_l", plates=(1,))}, laboratory_rotation("x", "z"))
    assert forces.wrench.shape == (1, 6, FRAMES * RATIO)
    np.testing.assert_allclose(forces.wrench[0, 3:, 5], [0.0, 700.0, 0.0], atol=1e-3)
    ahead, _, right = centers_of_pressure(forces.wrench)[0, :, 5]
    # The y axis of the laboratory points to the left.
    np.testing.assert_allclose([abs(ahead - 0.3), abs(-right - 0.2)], [0.05, 0.08], atol=1e-4)


def test_a_missing_plate_is_reported(file):
    with pytest.raises(InputError, match=r"force plate 2, found 1 plates"):
        read_plates(file, {"r": ForceColumns("calcn_r", plates=(2,))}, np.eye(3))


@pytest.mark.parametrize("unit", ["", " ", "furlong"])
def test_an_unknown_unit_of_length_is_reported(tmp_path, unit):
    file = _written(tmp_path / "walk.c3d", "1", unit)
    found = f"'{unit}'" if unit.strip() else "none"
    with pytest.raises(InputError, match=rf"expected one of m, .* as POINT:UNITS, found {found}"):
        read_plates(file, {"l": ForceColumns("calcn_l", plates=(1,))}, laboratory_rotation("x", "z"))


def test_an_unknown_unit_of_a_plate_is_reported(tmp_path):
    """The reader of C3D files may return a separate unit for each plate."""
    plate = {"unit_position": "", "unit_moment": "Nm", "unit_force": "N"}
    with pytest.raises(InputError, match="as the unit of force plates' corners, found ''"):
        _wrench(plate, np.eye(3), tmp_path)


def test_other_files_are_refused(tmp_path):
    file = tmp_path / "walk.c3d"
    file.write_bytes(b"no such thing" * 100)
    with pytest.raises(InputError, match="cannot be read as a C3D file"):
        read_c3d_markers(file)
