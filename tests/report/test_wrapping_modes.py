"""Tests of the comparison of wrapping modes: both paths are correct, and differences are drawn."""

from dataclasses import replace

import numpy as np
import opensim
import pytest

from wrapjax.datasets.virtual_person.leg import build_leg_model
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.report.paths.wrapping_modes import compare_wrapping_modes, wrapping_modes_figure

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")
MUSCLE = "glmax3_l"


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    opensim.Logger.setLevelString("Off")
    file = tmp_path_factory.mktemp("leg") / "model.osim"
    build_leg_model(file, "l")
    return file


@pytest.fixture(scope="module")
def poses():
    phase = np.linspace(0.0, 2.0 * np.pi, 11)[:, None]
    return np.array([0.3, 0.0, 0.0, 0.6, 0.0]) + np.array([0.5, 0.3, 0.4, 0.5, 0.3]) * np.sin(
        phase + np.arange(5)
    )


@pytest.fixture(scope="module")
def compared(model_file, poses):
    return compare_wrapping_modes(describe_model(model_file), MUSCLE, COORDINATES, poses)


def test_parity_path_agrees_with_opensim(compared, model_file, poses):
    found = analyse_muscles(model_file, (MUSCLE,), COORDINATES, poses, processes=1, quiet=True)
    np.testing.assert_allclose(compared.opensim.length, found.length[:, 0], atol=1e-9)
    assert compared.coordinates == COORDINATES[:3]
    np.testing.assert_allclose(compared.opensim.moment_arm, found.moment_arm[:, :3, 0].T, atol=1e-8)


def test_geodesic_path_is_shortest_with_moment_arms_equal_to_slopes(compared):
    """OpenSim's path on this cylinder is not the shortest, and its moment arms differ from -dL/dq."""
    longer = compared.opensim.length - compared.shortest.length
    assert longer.min() > -1e-9
    assert longer.max() > 1e-7
    assert compared.shortest.disagreement < 1e-7
    assert compared.opensim.disagreement > 1e-5


def test_wrap_parameters_change_both_paths(model_file, poses, compared):
    thicker = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.1]])
    moved = compare_wrapping_modes(describe_model(model_file), MUSCLE, COORDINATES, poses, thicker)
    for before, after in ((compared.opensim, moved.opensim), (compared.shortest, moved.shortest)):
        assert np.abs(after.length - before.length).max() > 1e-4


def test_figure_contains_all_curves_and_differences(compared):
    fewer = replace(compared, muscle="other_l", coordinates=compared.coordinates[:2])
    figure = wrapping_modes_figure([compared, fewer])
    assert [
        panel.get_title(loc="left") for panel in figure.axes if "length" in panel.get_title(loc="left")
    ] == [
        f"{MUSCLE}: length",
        "other_l: length",
    ]
    assert len(figure.axes) == 8 + 6
    (arm,) = [panel for panel in figure.axes[:4] if "hip_adduction_l" in panel.get_title(loc="left")]
    below = figure.axes[4 + figure.axes.index(arm)]
    drawn = [line.get_ydata() for line in arm.get_lines()]
    differences = [line.get_ydata() for line in below.get_lines()]
    reference = 1e3 * compared.shortest.moment_arm[1]
    for curve, difference in zip(drawn, differences, strict=False):
        np.testing.assert_allclose(difference, curve - reference, atol=1e-9)
    np.testing.assert_allclose(drawn[0], 1e3 * compared.opensim.moment_arm[1])
    np.testing.assert_allclose(drawn[1], 1e3 * compared.opensim.slope[1])
