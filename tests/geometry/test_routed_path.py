"""Tests that the line drawn for a muscle is the path of the exact engine."""

from dataclasses import replace

import numpy as np
import pytest

from wrapjax.geometry.exact_paths.engine import GEODESIC, ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.routed_path import route_path
from wrapjax.osim.model import describe_model

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l")
#: Muscles with one cylinder, restricted to a side or not, with few and many points; and one with two
#: cylinders.
MUSCLES = ("psoas_l", "iliacus_l", "glmax1_l", "bfsh_l", "addmagIsch_l", "gasmed_l")
MOVED = np.array([0.004, -0.003, 0.002, 0.12, -0.1, 0.93])


@pytest.fixture(scope="module")
def model(s1_left):
    return describe_model(s1_left / "model.osim")


@pytest.fixture(scope="module")
def poses():
    low, high = [-0.4, -0.3, -0.3, 0.0, -0.4], [0.8, 0.3, 0.3, 1.4, 0.4]
    return np.random.default_rng(1).uniform(low, high, (6, 5))


def wrap_parameters(engine, muscle):
    nominal = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    count = len(engine.wraps_of(muscle))
    return {"nominal": np.tile(nominal, (count, 1)), "moved": np.tile(MOVED, (count, 1))}


@pytest.mark.parametrize("muscle", MUSCLES)
def test_line_is_the_engines_path(model, poses, muscle):
    engine = ExactPaths(model, (muscle,), COORDINATES)
    posed, touched = engine.posed(poses)[muscle], 0
    for parameters in wrap_parameters(engine, muscle).values():
        wrapped = wrap_at_samples(posed, parameters[None], GEODESIC)
        for number, pose in enumerate(poses):
            route = route_path(model, muscle, COORDINATES, pose, parameters)
            assert len(route.contacts) == wrapped.touching[0, number].sum()
            if wrapped.margins.inside[0, number] < 0.0:
                continue
            touched += len(route.contacts)
            line = np.linalg.norm(np.diff(route.line, axis=0), axis=1).sum()
            assert line == pytest.approx(float(wrapped.length[0, number]), abs=1e-6)
            assert route.length == pytest.approx(float(wrapped.length[0, number]), abs=1e-13)
            np.testing.assert_allclose(route.moment_arm, wrapped.moment_arm[0, number], atol=1e-12)
            for cylinder in route.wraps:
                for line in (route.line, route.points):
                    distance = np.linalg.norm(cylinder.to_surface_frame(line)[:, :2], axis=1)
                    if cylinder.name in route.contacts:
                        assert distance.min() > cylinder.radius - 1e-9
                if cylinder.name in route.contacts:
                    ends = np.linalg.norm(
                        cylinder.to_surface_frame(route.contacts[cylinder.name])[:, :2], axis=1
                    )
                    np.testing.assert_allclose(ends, cylinder.radius, atol=1e-12)
    assert touched, "the path wraps in no pose, nothing was tested"


def test_line_has_no_kinks_where_it_meets_a_cylinder(model, poses):
    """A shortest path is tangent to the surface; an arc in the wrong direction would have a kink."""
    route = route_path(model, "psoas_l", COORDINATES, poses[0])
    (ends,) = route.contacts.values()
    steps = np.diff(route.line, axis=0)
    along = steps / np.linalg.norm(steps, axis=1)[:, None]
    cosines = np.sum(along[:-1] * along[1:], axis=1)
    at_points = [np.abs(route.line - point).sum(axis=1).argmin() for point in route.points]
    elsewhere = np.delete(np.arange(1, len(route.line) - 1), np.array(at_points[1:-1], dtype=int) - 1)
    assert np.degrees(np.arccos(np.clip(cosines[elsewhere - 1], -1.0, 1.0))).max() < 0.51
    assert any(np.abs(route.line - ends[0]).sum(axis=1) < 1e-12)


def test_line_without_wraps_connects_the_active_path_points(model, poses):
    """Without wraps the line is straight between path points, and inactive points are not on it."""
    path = model.muscle("tibant_l")
    route = route_path(model, "tibant_l", COORDINATES, poses[0])
    assert not path.wraps and route.wraps == () and route.contacts == {}
    np.testing.assert_array_equal(route.line, route.points)
    conditional = replace(
        path.points[1], kind="ConditionalPathPoint", active_range=("ankle_angle_l", 2.0, 3.0)
    )
    points = (path.points[0], conditional, *path.points[2:])
    muscles = tuple(replace(path, points=points) if one is path else one for one in model.muscles)
    without = route_path(replace(model, muscles=muscles), "tibant_l", COORDINATES, poses[0])
    np.testing.assert_array_equal(without.line, np.delete(route.line, 1, axis=0))


def test_cylinders_have_the_pose_and_radius_of_the_parameters(model, poses):
    before, after = (
        route_path(model, "psoas_l", COORDINATES, poses[0], own)
        for own in (None, np.array([[0.003, -0.004, 0.012, 0.3, 0.0, 1.1]]))
    )
    (old,), (new,) = before.wraps, after.wraps
    np.testing.assert_allclose(old.to_surface_frame(new.center[None])[0], [0.003, -0.004, 0.012], atol=1e-12)
    assert new.radius == pytest.approx(1.1 * old.radius)
    assert old.axes[:, 2] @ new.axes[:, 2] == pytest.approx(np.cos(0.3))
    np.testing.assert_allclose(new.to_ground_frame(new.to_surface_frame(after.line)), after.line, atol=1e-12)
