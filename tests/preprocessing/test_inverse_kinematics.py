"""Tests of inverse kinematics: known motions, OpenSim as the judge, gaps, goals, clamps, and wrong files."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.preprocessing.marker_legs import gait, legs_text, recorded_by_opensim
from tests.preprocessing.marker_legs import legs_model as legs_model
from wrapjax.cli.command_line import main
from wrapjax.errors import InputError
from wrapjax.geometry.inverse_kinematics import MarkerGoals, expand
from wrapjax.geometry.marker_model import build_marker_model
from wrapjax.osim.model import describe_model
from wrapjax.osim.tools import solve_inverse_kinematics
from wrapjax.preprocessing.files.kinematics_settings import CoordinateGoal, read_kinematics_settings
from wrapjax.preprocessing.files.markers import write_trc
from wrapjax.preprocessing.inverse_kinematics import free_coordinates, inverse_kinematics


@pytest.fixture(scope="module")
def walk(legs_model):
    """Coordinates, their motion, and markers of a gait-like motion."""
    description = describe_model(legs_model)
    coordinates = tuple(entry.name for entry in description.coordinates)
    motion = gait(coordinates, 40)
    names = [marker.name for marker in description.markers]
    return coordinates, motion, recorded_by_opensim(legs_model, coordinates, motion, names)


@pytest.fixture(scope="module")
def noisy(walk):
    """Markers displaced by continuous errors of about 10 mm, one of them unseen for a while."""
    markers = walk[2]
    rng = np.random.default_rng(5)
    phase = rng.uniform(0.0, 6.28, markers.positions.shape[::2])[:, None, :]
    error = 0.01 * np.sin(9.0 * markers.time[None, :, None] + phase)
    positions = markers.positions + error
    positions[7, 10:30] = np.nan
    return replace(markers, positions=positions)


def test_the_motion_behind_markers_is_found(legs_model, walk):
    coordinates, motion, markers = walk
    found = inverse_kinematics(legs_model, markers)
    assert found.converged.all() and found.determined.all()
    assert found.coordinates == coordinates
    np.testing.assert_allclose(found.values.T, motion, atol=1e-9)
    assert found.rms < 1e-10


@pytest.mark.parametrize("turn", [2.0, np.pi])
def test_people_who_walk_in_other_directions_are_found(legs_model, walk, turn):
    rotation = np.array(
        [[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]]
    )
    found = inverse_kinematics(legs_model, walk[2].rotated(rotation))
    assert found.rms < 1e-10
    joints = [not name.startswith("pelvis") for name in found.coordinates]
    np.testing.assert_allclose(found.values[joints].T, walk[1][:, joints], atol=1e-9)


def test_poses_and_distances_equal_opensim(legs_model, noisy, tmp_path):
    file = tmp_path / "noisy.trc"
    write_trc(file, noisy)
    found = inverse_kinematics(legs_model, file, weights={"TH0_r": 3.0})
    weights = {name: 3.0 if name == "TH0_r" else 1.0 for name in noisy.names}
    expected = solve_inverse_kinematics(legs_model, file, weights, 0.0, noisy.time[5])
    rows = [found.coordinates.index(name) for name in expected.coordinates]
    np.testing.assert_allclose(found.values[rows, :6], expected.values, atol=np.radians(0.01))
    assert 0.003 < found.rms < 0.02
    dataset = found.to_dataset()
    knee = dataset["coordinate_value"].sel(coordinate="knee_angle_r")
    assert knee["unit"].item() == "rad" and dataset["marker_distance"].attrs["units"] == "m"
    np.testing.assert_array_equal(knee, found.values[found.coordinates.index("knee_angle_r")])
    cost = (found.weights @ found.distances[:, :6] ** 2).sum()
    theirs = (found.weights @ np.linalg.norm(expected.positions - noisy.positions[:, :6], axis=-1) ** 2).sum()
    assert cost <= theirs * (1.0 + 1e-9)


def test_expansion_holds_the_exact_second_derivatives(legs_model, noisy):
    description = describe_model(legs_model)
    names = [entry.name for entry in free_coordinates(description)]
    model = build_marker_model(description, names, noisy.names)
    weights = np.full(len(noisy.names), 1.0 / len(noisy.names))
    nothing = np.zeros(len(names))
    goal = MarkerGoals(noisy.positions[:, 0], weights, nothing, nothing)
    pose = gait(names, 40)[3] + 0.3
    derivatives = jax.jit(lambda at: expand(model, goal, at))
    expansion = derivatives(pose)
    for column in range(len(names)):
        step = 1e-5 * np.eye(len(names))[column]
        ahead, behind = derivatives(pose + step), derivatives(pose - step)
        assert abs(expansion.gradient[column] - (ahead.cost - behind.cost) / 4e-5) < 1e-9
        hessian = expansion.gauss_newton + expansion.remainder
        difference = (ahead.gradient - behind.gradient) / 2e-5
        np.testing.assert_allclose(hessian[column], difference, atol=1e-8)


def test_goals_pull_and_clamps_hold(legs_model, noisy, tmp_path):
    plain = inverse_kinematics(legs_model, noisy)
    pulled = inverse_kinematics(legs_model, noisy, goals={"knee_angle_r": CoordinateGoal(1.0, -1.2)})
    knee = plain.coordinates.index("knee_angle_r")
    assert (np.abs(pulled.values[knee] + 1.2) < np.abs(plain.values[knee] + 1.2)).all()
    clamped = tmp_path / "clamped.osim"
    text = legs_text().replace(
        '<Coordinate name="knee_angle_r"><range>-3 3</range>',
        '<Coordinate name="knee_angle_r"><range>-0.6 0</range><clamped>true</clamped>',
    )
    clamped.write_text(text)
    held = inverse_kinematics(clamped, noisy).values[knee]
    assert held.min() >= -0.6 and (held == -0.6).any() and plain.values[knee].min() < -0.7


def test_coordinates_without_markers_are_named(legs_model, noisy):
    names = tuple(name for name in noisy.names if not name.startswith("FO"))
    found = inverse_kinematics(legs_model, noisy.select(names))
    assert found.summary()["undetermined"] == ["ankle_angle_r", "ankle_angle_l"]


def test_command_writes_angles_and_settings_of_opensim_are_read(legs_model, noisy, tmp_path, capsys):
    write_trc(tmp_path / "walk.trc", noisy)
    tasks = "".join(f'<IKMarkerTask name="{name}"><weight>2</weight></IKMarkerTask>' for name in noisy.names)
    tasks += '<IKCoordinateTask name="knee_angle_r"><weight>0.1</weight></IKCoordinateTask>'
    settings = tmp_path / "tasks.xml"
    settings.write_text(f'<OpenSimDocument Version="40600"><IKTaskSet>{tasks}</IKTaskSet></OpenSimDocument>')
    out = tmp_path / "out"
    arguments = [
        "ik",
        str(legs_model),
        str(tmp_path / "walk.trc"),
        "--out",
        str(out),
        "--tasks",
        str(settings),
    ]
    assert main(arguments) == 0
    assert "40 of 40 frames solved" in capsys.readouterr().out
    assert {file.name for file in out.iterdir()} >= {"angles.sto", "marker_errors.sto", "ik.json"}
    assert read_kinematics_settings(settings).goals == {"knee_angle_r": CoordinateGoal(0.1)}


def _in_millimetres(markers):
    return replace(markers, positions=1e3 * markers.positions)


def _exchanged(markers):
    return replace(markers, names=tuple(f"{name[:-1]}{'lr'[name[-1] == 'l']}" for name in markers.names))


def _without_a_frame(markers):
    positions = markers.positions.copy()
    positions[:, 12] = np.nan
    return replace(markers, positions=positions)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_in_millimetres, "found 1e+03 times; is the unit of length"),
        (_exchanged, "mm with left and right exchanged; are left and right exchanged"),
        (_without_a_frame, "found none in 1 frames; the first one is at 0.24 s"),
        (
            lambda markers: replace(markers, names=tuple(f"x{name}" for name in markers.names)),
            "found 0 of 28",
        ),
    ],
)
def test_wrong_markers_are_refused(legs_model, noisy, change, message):
    with pytest.raises(InputError) as error:
        inverse_kinematics(legs_model, change(noisy))
    assert message in str(error.value)
    assert len(error.value.problems) == 1


def test_unknown_names_are_refused(legs_model, noisy):
    with pytest.raises(InputError, match="no such marker; did you mean 'TH0_r'"):
        inverse_kinematics(legs_model, noisy, weights={"TH0r": 2.0})
    with pytest.raises(InputError, match="no such coordinate; did you mean 'knee_angle_r'"):
        inverse_kinematics(legs_model, noisy, goals={"knee_angel_r": CoordinateGoal(1.0)})
