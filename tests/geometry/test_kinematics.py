"""Tests of forward kinematics against OpenSim: joints, couplers, moving and conditional points."""

from dataclasses import replace

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.geometry.skeleton.functions import Polynomial, Spline
from wrapjax.geometry.skeleton.kinematics import CoordinateValues, body_motion, path_points
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles


def straight_length_and_arms(model, muscle, coordinates, poses):
    """Length and moment arms of a path straight from point to point, valid for muscles without wraps."""
    values = CoordinateValues(model, coordinates, poses)
    points = model.muscle(muscle).points
    points = path_points(points, body_motion(values, {point.body for point in points}), values)
    length, arms = np.zeros(len(poses)), np.zeros((len(poses), len(coordinates)))
    for pose in range(len(poses)):
        active = np.flatnonzero(points.active[pose])
        segments = np.diff(points.position[pose, active], axis=0)
        lengths = np.linalg.norm(segments, axis=1)
        length[pose] = lengths.sum()
        rate = np.diff(points.velocity[pose][:, active], axis=1)
        arms[pose] = -np.einsum("sk,csk->c", segments / lengths[:, None], rate)
    return length, arms


@pytest.mark.parametrize("muscle", ["extensor", "toe_flexor", "conditional", "moving"])
def test_couplers_and_points_of_every_kind_equal_opensim(odd_model, muscle):
    coordinates = ("hip", "knee")
    poses = np.random.default_rng(0).uniform([-1.0, 0.0], [1.0, 2.0], (200, 2))
    expected = analyse_muscles(odd_model, [muscle], coordinates, poses)
    length, arms = straight_length_and_arms(describe_model(odd_model), muscle, coordinates, poses)
    np.testing.assert_allclose(length, expected.length[:, 0], atol=1e-13)
    # OpenSim 4.6 applies no force to a moving point between two points of its own body.
    spanned = [0] if muscle == "moving" else [0, 1]
    np.testing.assert_allclose(arms[:, spanned], expected.moment_arm[:, spanned, 0], atol=1e-12)


def test_moment_arm_with_a_moving_point_is_minus_the_derivative_of_length(odd_model):
    model, coordinates = describe_model(odd_model), ("hip", "knee")
    poses = np.random.default_rng(1).uniform([-1.0, 0.0], [1.0, 2.0], (50, 2))
    _, arms = straight_length_and_arms(model, "moving", coordinates, poses)
    assert np.abs(arms[:, 1]).max() > 1e-3
    for place in range(2):
        step = np.eye(2)[place] * 1e-6
        ahead, _ = straight_length_and_arms(model, "moving", coordinates, poses + step)
        behind, _ = straight_length_and_arms(model, "moving", coordinates, poses - step)
        np.testing.assert_allclose(arms[:, place], -(ahead - behind) / 2e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("subject", "side"), [("s1_left", "l"), ("healthy_overground", "r"), ("healthy_treadmill", "l")]
)
def test_unwrapped_muscles_of_recorded_models_equal_opensim(data_folder, subject, side):
    """Pin, universal and custom joints with splines and polynomials, and coupled patellas, in 500 poses."""
    file = data_folder / subject / "model.osim"
    model = describe_model(file)
    hip = ("hip_flexion", "hip_adduction", "hip_rotation")
    names = [f"{name}_{side}" for name in (*hip, "knee_angle", "ankle_angle", "subtalar_angle")]
    existing = {coordinate.name for coordinate in model.coordinates}
    coordinates = tuple(name for name in names if name in existing)
    muscles = [entry.name for entry in model.muscles if not entry.wraps and entry.name.endswith(f"_{side}")]
    low, high = [-0.6, -0.4, -0.4, 0.0, -0.5, -0.3], [1.0, 0.4, 0.4, 1.6, 0.4, 0.3]
    poses = np.random.default_rng(2).uniform(low, high, (500, 6))[:, : len(coordinates)]
    expected = analyse_muscles(file, muscles, coordinates, poses)
    assert len(muscles) == 19
    for place, muscle in enumerate(muscles):
        length, arms = straight_length_and_arms(model, muscle, coordinates, poses)
        np.testing.assert_allclose(length, expected.length[:, place], atol=1e-9, rtol=0)
        np.testing.assert_allclose(arms, expected.moment_arm[:, :, place], atol=1e-8, rtol=0)


def test_an_unsupported_function_is_an_error_only_for_bodies_that_need_it(odd_model):
    model = describe_model(odd_model)
    unsupported = replace(
        model,
        coordinates=tuple(
            replace(entry, coupler=None) if entry.name == "patella_turn" else entry
            for entry in model.coordinates
        ),
    )
    values = CoordinateValues(unsupported, ("hip", "knee"), np.zeros((1, 2)))
    body_motion(values, ["shank"])
    with pytest.raises(InputError, match="follows knee by a function of an unknown kind"):
        body_motion(values, ["pulley"])


def test_an_unsupported_joint_must_stay_in_its_default_pose(odd_model):
    model = describe_model(odd_model)
    joints = tuple(
        replace(joint, kind="EllipsoidJoint", axes=None) if joint.name == "knee_joint" else joint
        for joint in model.joints
    )
    unsupported = replace(model, joints=joints)
    at_rest = body_motion(CoordinateValues(unsupported, ("hip",), np.array([[0.3]])), ["foot"])["foot"]
    moved = body_motion(CoordinateValues(model, ("hip",), np.array([[0.3]])), ["foot"])["foot"]
    np.testing.assert_allclose(at_rest.origin, moved.origin, atol=1e-14)
    with pytest.raises(InputError, match="joint 'knee_joint' is a EllipsoidJoint"):
        body_motion(CoordinateValues(unsupported, ("knee",), np.array([[0.3]])), ["foot"])


@pytest.mark.parametrize(
    "function",
    [
        Polynomial((2.0, -1.0, 0.5)),
        Polynomial((0.7,)),
        Spline((0.0, 1.0, 3.0), (0.1, 0.4, -0.2), (0.3, 0.0, 1.0)),
    ],
)
def test_derivatives_of_functions_equal_differences(function):
    at = np.linspace(-2.0, 5.0, 41)
    difference = (function.value(at + 1e-6) - function.value(at - 1e-6)) / 2e-6
    np.testing.assert_allclose(function.derivative(at), difference, atol=1e-8)
    np.testing.assert_allclose(function.scaled(-2.5).value(at), -2.5 * function.value(at), rtol=1e-14)


def test_splines_are_extrapolated_linearly():
    spline = Spline((0.0, 1.0), (0.0, 1.0), (2.0, 0.5))
    np.testing.assert_allclose(spline.value(np.array([-1.0, 3.0])), [-2.0, 2.0], rtol=1e-15)
