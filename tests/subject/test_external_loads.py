"""External loads: wrenches at any time, and error messages for invalid files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, write_storage
from wrapjax.subject.external_loads import read_ground_loads
from wrapjax.subject.subject import load_subject
from wrapjax.subject.trial_settings import TrialSettings

LOAD = """<ExternalForce name="{name}">
 <applied_to_body>{body}</applied_to_body>
 <force_expressed_in_body>ground</force_expressed_in_body>
 <point_expressed_in_body>ground</point_expressed_in_body>
 <force_identifier>{side}_v</force_identifier>
 <point_identifier>{side}_p</point_identifier>
 <torque_identifier>{side}_t</torque_identifier>
</ExternalForce>"""
LOADS = """<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="loads"><objects>
{}</objects></ExternalLoads></OpenSimDocument>"""
TWO = LOADS.format(
    LOAD.format(name="left", body="/bodyset/calcn_l", side="l")
    + LOAD.format(name="right", body="calcn_r", side="r")
)
TIME = np.linspace(0.0, 2.0, 21)
COLUMNS = tuple(f"{side}_{kind}{axis}" for side in "lr" for kind in "vpt" for axis in "xyz")


def recorded(time):
    """Force, point and torque of two feet, each (time, 3), linear in time."""
    forces, points, torques = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 2, 3))
    increasing = [np.asarray(time)[:, None] * 100.0 * force for force in forces]
    return [
        (force, 0.0 * force + point, torque + 0.0 * force)
        for force, point, torque in zip(increasing, points, torques, strict=True)
    ]


@pytest.fixture
def trial(tmp_path) -> TrialSettings:
    values = np.concatenate([part for foot in recorded(TIME) for part in foot], axis=1)
    write_storage(tmp_path / "forces.mot", Storage("forces", COLUMNS, TIME, values))
    (tmp_path / "loads.xml").write_text(TWO, encoding="utf-8")
    none = Path()
    return TrialSettings(
        name="walk",
        use="calibration",
        angles=none,
        moments=none,
        emg=none,
        cycles=((0.1, 1.1),),
        ground_forces=tmp_path / "forces.mot",
        external_loads=tmp_path / "loads.xml",
    )


def test_wrenches_are_about_grounds_origin_at_any_time(trial):
    loads = read_ground_loads(trial)
    assert loads.bodies == ("calcn_l", "calcn_r")
    times = np.array([[0.13, 0.5], [1.234, 1.99]])
    found = loads.at(times)
    assert found.shape == (2, 6, 2, 2)
    for foot, (force, point, torque) in zip(found, recorded(times.ravel()), strict=True):
        np.testing.assert_allclose(foot[3:].reshape(3, -1).T, force, atol=1e-10)
        expected = torque + np.cross(point, force)
        np.testing.assert_allclose(foot[:3].reshape(3, -1).T, expected, atol=1e-10)
    # Beyond the ends the last sample is held.
    np.testing.assert_array_equal(loads.at(np.array([[9.0]])), loads.at(np.array([[2.0]])))


def test_a_wrong_number_of_rows_in_the_header_is_accepted(trial):
    text = trial.ground_forces.read_text()
    trial.ground_forces.write_text(text.replace("nRows=21", "nRows=4711"))
    assert read_ground_loads(trial).time.size == 21


def test_torque_is_optional(trial):
    text = TWO.replace("<torque_identifier>l_t</torque_identifier>", "<torque_identifier/>")
    trial.external_loads.write_text(text)
    first = read_ground_loads(trial).at(np.array([[1.0]]))[0, :, 0, 0]
    force, point, _ = (part[0] for part in recorded([1.0])[0])
    np.testing.assert_allclose(first[:3], np.cross(point, force), atol=1e-10)


BROKEN = {
    "no such column": (
        "loads.xml",
        "l_v<",
        "left_v<",
        ["forces.mot", "column left_vx", "found none", "l_vx"],
    ),
    "no load": ("loads.xml", "ExternalForce", "OtherForce", ["loads.xml", "at least one <ExternalForce>"]),
    "no body": ("loads.xml", "/bodyset/calcn_l", "", ["loads.xml", "'left'", "<applied_to_body>"]),
    "no point": ("loads.xml", "l_p<", "<", ["loads.xml", "'left'", "<point_identifier>"]),
    "nothing acts": ("loads.xml", "_identifier>", "_other>", ["loads.xml", "'right'", "found neither"]),
    "in a body": (
        "loads.xml",
        "<point_expressed_in_body>ground",
        "<point_expressed_in_body>calcn_r",
        ["loads.xml", "'left'", "<point_expressed_in_body> to be ground", "'calcn_r'"],
    ),
    "not XML": ("loads.xml", "<?xml", "<<", ["loads.xml", "XML"]),
    "not finite": ("forces.mot", "\n1.0\t", "\n1.0\tnan ", ["forces.mot", "found"]),
    "cut off": ("forces.mot", "\n2.0\t", "\n", ["forces.mot", "line 28", "expected 19 numbers, found 18"]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_invalid_files_are_reported(trial, name):
    file, old, new, words = BROKEN[name]
    path = trial.external_loads.parent / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_ground_loads(trial)
    for word in words:
        assert word in str(caught.value)


def test_a_cycle_without_forces_is_reported(trial):
    trial = replace(trial, cycles=((0.1, 1.1), (1.1, 2.2)))
    with pytest.raises(InputError, match=r"forces.mot: trial 'walk', cycle 2 \[1.1, 2.2\] s.*outside"):
        read_ground_loads(trial)


def test_files_are_checked_when_the_folder_is_read(tmp_path, trial):
    """Faults are reported at once, not when a diagnosis needs the forces after minutes."""
    folder = write_subject(tmp_path / "person")
    for file in ("forces.mot", "loads.xml"):
        (folder / file).write_text((tmp_path / file).read_text().replace("l_v<", "left_v<"))
    settings = folder / "subject.toml"
    files = 'ground_forces = "forces.mot"\nexternal_loads = "loads.xml"\nspeed_m_s'
    settings.write_text(settings.read_text().replace("speed_m_s", files))
    with pytest.raises(InputError, match="column left_vx"):
        load_subject(folder)
