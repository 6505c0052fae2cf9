"""Tests of pictures of moved cylinders: choice of muscles, distances to scale, and descriptions."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import opensim
import pytest

from tests.report.conftest import COORDINATES, MUSCLES
from wrapjax.comparison.samples import ComparedLeg
from wrapjax.datasets.virtual_person.leg import build_leg_model
from wrapjax.geometry.exact_paths.routed_path import route_path
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.model.freedom import FreedWraps, with_wraps
from wrapjax.osim.model import describe_model
from wrapjax.report.calibration.run_page import write_run
from wrapjax.report.comparison.page import render_comparison
from wrapjax.report.comparison.summary import comparison_rows
from wrapjax.report.paths.moved_paths import describe_move, moved_paths
from wrapjax.report.paths.path_views import look_at, path_section, path_view_figure

#: 3 and 4 mm across the axis, 10 degrees about x, a tenth larger.
CHANGE = np.array([0.003, 0.004, 0.0, np.deg2rad(10.0), 0.0, 0.1])
#: Frame of the second cycle in which the hip's moment arm changed most.
FRAME = 3


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    opensim.Logger.setLevelString("Off")
    file = tmp_path_factory.mktemp("leg") / "model.osim"
    build_leg_model(file, "l")
    return describe_model(file)


@pytest.fixture
def moved(result):
    """A calibration that moved the iliacus' cylinder, and with it its moment arm at the hip."""
    box = np.full((1, 6), 0.4)
    wraps = FreedWraps(
        names=("IL_at_brim_l",),
        quantities=WRAP_PARAMETERS,
        units=("m", "m", "m", "rad", "rad", "1"),
        places=np.array([[0], [-1]]),
        lower=-box,
        upper=box,
        scale=box,
        prior_sd=box,
    )
    before = result.initial_states
    arm = before.path.moment_arm.at[0, :, 0].add(0.001).at[0, 1, 0, FRAME].add(0.002)
    # A change of a path without a freed cylinder must not be drawn.
    arm = arm.at[1, :, 1].add(0.02)
    states = replace(before, path=replace(before.path, moment_arm=arm))
    return replace(
        result,
        method="PGA",
        freedom=with_wraps(result.freedom, "PGA", wraps),
        parameters=replace(result.parameters, path_changes=jnp.asarray(np.stack([CHANGE, np.zeros(6)]))),
        paths=None,
        states=states,
    )


@pytest.fixture
def walking(subject):
    angles = 0.1 + 0.05 * np.arange(subject.trials.angles.size).reshape(subject.trials.angles.shape)
    return replace(subject, trials=replace(subject.trials, angles=angles))


@pytest.fixture
def move(walking, moved, model):
    (found,) = moved_paths(walking, moved, model)
    return found


def test_moved_path_is_in_the_frame_of_largest_change(move, walking, model):
    assert (move.muscle, move.coordinate) == (MUSCLES[0], COORDINATES[0])
    assert move.place == "75 % of walk/02"
    assert move.arm_after - move.arm_before == pytest.approx(0.003)
    pose = walking.trials.angles[1, :1, FRAME]
    for route, parameters in ((move.before, NOMINAL), (move.after, NOMINAL + CHANGE)):
        expected = route_path(model, MUSCLES[0], COORDINATES[:1], pose, parameters[None])
        np.testing.assert_array_equal(route.line, expected.line)
    assert move.before.contacts and move.after.contacts


def test_description_of_a_moved_cylinder(move):
    (pair,) = move.touched
    assert describe_move(*pair) == (
        "IL_at_brim_l: moved 5.0 mm, turned 10.0\N{DEGREE SIGN}, radius \N{MULTIPLICATION SIGN} 1.10 "
        "(35.0 to 38.5 mm)"
    )


def test_no_moved_paths_if_cylinders_are_unchanged(walking, moved, result, model):
    assert moved_paths(walking, result, model) == []
    assert moved_paths(walking, replace(moved, states=moved.initial_states), model) == []


class TestCamera:
    def test_cylinder_seen_along_its_axis_is_a_circle_of_its_radius(self, move):
        camera = look_at(move, 0.0)
        np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.axes) == pytest.approx(1.0)
        cylinder = move.before.wraps[0]
        angles = np.linspace(0.0, 2.0 * np.pi, 9)
        ring = cylinder.radius * np.stack([np.cos(angles), np.sin(angles), 0.7 + 0.0 * angles], axis=1)
        across = (
            camera.project(cylinder.to_ground_frame(ring))[:, :2]
            - camera.project(cylinder.center[None])[:, :2]
        )
        np.testing.assert_allclose(np.linalg.norm(across, axis=1), 1e3 * cylinder.radius, rtol=1e-9)

    def test_muscle_is_on_the_near_side_in_the_side_view(self, move):
        camera = look_at(move, np.deg2rad(68.0))
        cylinder = move.before.wraps[0]
        contacts = np.concatenate([move.before.contacts[cylinder.name], move.after.contacts[cylinder.name]])
        depth = camera.project(contacts)[:, 2].mean() - camera.project(cylinder.center[None])[0, 2]
        assert depth > 0.0


def test_figure(move):
    figure = path_view_figure([move, move, move])
    assert [len(part.axes) for part in figure.subfigs] == [2, 2, 2, 0]
    for panel, tilt in zip(figure.subfigs[0].axes, (0.0, np.deg2rad(68.0)), strict=True):
        assert panel.get_aspect() == 1.0
        assert np.ptp(panel.get_xlim()) == np.ptp(panel.get_ylim())
        drawn = [line.get_xydata() for line in panel.get_lines()]
        for route in (move.before, move.after):
            projected = look_at(move, tilt).project(route.line)[:, :2]
            assert any(one.shape == projected.shape and np.allclose(one, projected) for one in drawn)


def test_report_of_a_run_shows_moved_paths(move, moved, walking, model, tmp_path):
    page = path_section(moved, [move])
    assert page.count("<img") == path_section(moved).count("<img") + 1
    assert re.search(r'alt="Paths and surfaces in space.*IL_at_brim_l: moved 5\.0 mm, turned 10\.0', page)
    asked = []

    def describe(file):
        asked.append(file)
        return model

    write_run([(walking, moved)], tmp_path / "run", describe_model=describe)
    assert asked == [walking.model_file]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "IL_at_brim_l: moved 5.0\N{NO-BREAK SPACE}mm" in page or "IL_at_brim_l: moved 5.0 mm" in page


def test_model_is_not_read_without_freed_cylinders(result, subject, tmp_path):
    write_run([(subject, result)], tmp_path / "run", describe_model=lambda file: pytest.fail("opened"))


def test_comparison_shows_moved_paths_of_the_method_with_freed_cylinders(walking, moved, result, model):
    methods = ("NGA", "PGA")
    results = {"NGA": replace(result, initial_states=result.states), "PGA": moved}
    leg = ComparedLeg("left leg", walking, results, dict.fromkeys(methods, "folder"), model)
    page = render_comparison([leg], methods, comparison_rows([leg], methods))
    assert page.count("Paths and surfaces of left leg by PGA in space") == 1
    assert "of left leg by NGA in space" not in page
    without = replace(leg, model=None)
    assert "in space" not in render_comparison([without], methods, comparison_rows([without], methods))


def test_view_of_a_path_over_half_the_circumference(move):
    """The two contacts are then opposite each other, and their midpoint is on the axis."""
    cylinder = replace(move.before.wraps[0], name="half")
    angle = np.linspace(0.0, np.pi, 50)
    arc = cylinder.to_ground_frame(
        cylinder.radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    )
    route = replace(
        move.before, line=arc, points=arc[[0, -1]], contacts={"half": arc[[0, -1]]}, wraps=(cylinder,)
    )
    camera = look_at(replace(move, before=route, after=route), np.pi / 2)
    np.testing.assert_allclose(camera.axes[2], cylinder.axes[:, 1], atol=1e-6)
