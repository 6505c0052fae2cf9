"""Defends: what the page draws is what the engine and the skeleton compute."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.report.model_view.conftest import COORDINATES, FRAMES, MOVED, MUSCLES
from wrapjax.geometry.exact_paths.engine import ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.routed_path import route_path
from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.skeleton.kinematics import CoordinateValues, body_motion
from wrapjax.geometry.skeleton.model_description import Pose
from wrapjax.report.model_view.quantities import gap_errors
from wrapjax.report.model_view.scene import Placement, build_scene
from wrapjax.report.model_view.wrap_shapes import wrap_shape


@pytest.fixture(scope="module")
def poses(shown):
    return np.concatenate([motion.poses for motion in shown.motions])


def test_drawn_paths_are_the_engines(shown, scene, poses):
    """Path points, contacts and lengths in every frame; thinned arcs are shorter by a hundredth of a mm."""
    touched = 0
    for muscle in MUSCLES:
        for placement, path in zip(shown.placements, scene.paths[muscle], strict=False):
            parameters = placement.of(path.wraps)
            engine = ExactPaths(shown.model, (muscle,), COORDINATES)
            wrapped = wrap_at_samples(engine.posed(poses)[muscle], parameters[None])
            np.testing.assert_allclose(path.length, wrapped.length[0], atol=1e-12)
            np.testing.assert_allclose(path.moment_arm.T, wrapped.moment_arm[0], atol=1e-12)
            for frame in (0, 5, 2 * FRAMES - 1):
                route = route_path(shown.model, muscle, COORDINATES, poses[frame], parameters)
                vertices = path.frame(frame)
                first = int(path.counts[:frame].sum())
                flags = slice(first, first + len(vertices))
                np.testing.assert_allclose(vertices[path.is_point[flags]], route.points, atol=1e-12)
                drawn = np.linalg.norm(np.diff(vertices, axis=0), axis=1).sum()
                assert route.length - 1e-4 < drawn <= route.length + 1e-12
                contact = path.contact[flags]
                assert (contact >= 0).any() == bool(route.contacts)
                for place, cylinder in enumerate(route.wraps):
                    on = np.flatnonzero(contact == place)
                    if on.size:
                        touched += 1
                        local = cylinder.to_surface_frame(vertices[on[0] : on[-1] + 2])
                        np.testing.assert_allclose(np.hypot(*local.T[:2]), cylinder.radius, atol=1e-9)
                        np.testing.assert_allclose(
                            vertices[on[0]], route.contacts[cylinder.name][0], atol=1e-9
                        )
    assert touched, "no path wraps, nothing was tested"


def test_only_what_calibration_moved_is_drawn_twice(scene):
    assert {name: len(paths) for name, paths in scene.paths.items()} == {
        "psoas_l": 2,
        "gasmed_l": 1,
        "tibant_l": 1,
    }
    assert {name: len(shapes) for name, shapes in scene.wraps.items()} == {
        "PS_at_brim_l": 2,
        "Gastroc_at_condyles_l": 1,
    }
    before, after = scene.paths["psoas_l"]
    assert np.abs(before.length - after.length).max() > 1e-3


def test_wraps_are_drawn_where_the_engine_has_them(shown, poses, scene):
    for placement in shown.placements:
        parameters = placement.of(("PS_at_brim_l",))
        shape = wrap_shape(shown.model.wrap("PS_at_brim_l"), parameters[0])
        (cylinder,) = route_path(shown.model, "psoas_l", COORDINATES, poses[3], parameters).wraps
        body = scene.bodies[shape.body]
        local = cylinder.to_surface_frame(body.origin[3] + shape.vertices @ body.rotation[3].T)
        np.testing.assert_allclose(np.hypot(*local.T[:2]), cylinder.radius, atol=1e-12)
        np.testing.assert_allclose(np.abs(local[:, 2]), cylinder.half_length, atol=1e-12)
        assert shape.triangles.max() == shape.lines.max() == len(shape.vertices) - 1


def test_bodies_turn_about_the_drawn_axes(shown, scene, poses):
    """A small change of a coordinate turns the body below its joint about the axis, by the right hand."""
    step = 1e-6
    assert {axis.coordinate for axis in scene.axes} == set(COORDINATES)
    for axis in scene.axes:
        joint = next(joint for joint in shown.model.joints if joint.name == axis.joint)
        moved = poses.copy()
        moved[:, COORDINATES.index(axis.coordinate)] += step
        after = body_motion(CoordinateValues(shown.model, COORDINATES, moved), [joint.child_body])
        rotation = after[joint.child_body].rotation @ np.swapaxes(
            scene.bodies[joint.child_body].rotation, 1, 2
        )
        turned = np.stack([rotation[:, 2, 1], rotation[:, 0, 2], rotation[:, 1, 0]], axis=1) / step
        np.testing.assert_allclose(turned, axis.direction, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(axis.direction, axis=1), 1.0, atol=1e-12)


def test_axes_before_are_those_of_the_model_before(shown, scene):
    """The axis of a joint that was placed elsewhere is that of a model whose joint is there."""
    knee = next(joint for joint in shown.model.joints if joint.name == "knee_l")
    turned = Rotation.from_euler("XYZ", (0.1, -0.2, 0.3)).as_matrix() @ np.asarray(knee.in_parent.rotation)
    origin = np.asarray(knee.in_parent.translation) + (0.01, 0.02, -0.03)
    pose = Pose(tuple(map(tuple, turned.tolist())), tuple(origin.tolist()))
    parts = (shown.muscles, shown.coordinates, shown.motions, shown.placements)
    joints = tuple(replace(one, in_parent=pose) if one is knee else one for one in shown.model.joints)
    (expected,) = (
        axis
        for axis in build_scene(replace(shown.model, joints=joints), *parts).axes
        if axis.joint == "knee_l"
    )
    found = build_scene(shown.model, *parts, {"knee_l": pose}).axes
    assert [axis for axis in found if not axis.before] != [] and len(found) == len(scene.axes) + 1
    (before,) = (axis for axis in found if axis.before)
    assert (before.joint, before.coordinate) == ("knee_l", "knee_angle_l")
    np.testing.assert_allclose(before.center, expected.center, atol=1e-12)
    np.testing.assert_allclose(before.direction, expected.direction, atol=1e-12)


def test_sticks_join_the_joints(shown, scene):
    """The thigh's line ends in the knee, also where the joint's center moves in the thigh."""
    knee = next(axis for axis in scene.axes if axis.coordinate == "knee_angle_l")
    thigh = scene.bodies["femur_l"]
    ends = [thigh.origin[0] + thigh.rotation[0] @ line[1] for line in scene.sticks["femur_l"]]
    assert min(np.linalg.norm(end - knee.center[0]) for end in ends) < 1e-12
    assert scene.root == "pelvis"


def test_unsupported_wraps_are_named_and_left_out(shown):
    wraps = tuple(
        replace(wrap, kind="WrapMesh") if wrap.name == "PS_at_brim_l" else wrap for wrap in shown.model.wraps
    )
    model = replace(shown.model, wraps=wraps)
    scene = build_scene(model, ("psoas_l",), COORDINATES, shown.motions[:1], (Placement("model"),))
    assert "PS_at_brim_l" not in scene.wraps
    assert len(scene.notes) == 1 and scene.notes[0].startswith(
        "psoas_l is drawn straight from point to point: "
    )
    assert wrap_shape(model.wrap("PS_at_brim_l"), NOMINAL) is None
    assert set(MOVED) == {"PS_at_brim_l"}


def test_errors_of_a_diagnosis_are_spread_over_phase_and_speed(shown):
    where = [
        {"coordinate": "knee_angle_l", "phase_percent": [0, 50], "speed_m_s": 0.5, "rms_Nm": 3.0},
        {"coordinate": "knee_angle_l", "phase_percent": [50, 100], "speed_m_s": 0.5, "rms_Nm": 5.0},
        {"coordinate": "knee_angle_l", "phase_percent": [0, 50], "speed_m_s": None, "rms_Nm": 8.0},
        {"coordinate": "hip_rotation_l", "phase_percent": [0, 50], "speed_m_s": 0.5, "rms_Nm": 9.0},
        {"coordinate": "ankle_angle_l", "time_s": [0, 1], "speed_m_s": 0.5, "rms_Nm": 9.0},
    ]
    errors = gap_errors(where, shown.motions, (0.5, None), COORDINATES, "rms_Nm")
    knee = errors[COORDINATES.index("knee_angle_l")]
    np.testing.assert_array_equal(knee[:FRAMES], [3.0] * 4 + [5.0] * 5)
    np.testing.assert_array_equal(knee[FRAMES:], [8.0] * 4 + [np.nan] * 5)
    assert np.isnan(np.delete(errors, COORDINATES.index("knee_angle_l"), axis=0)).all()
