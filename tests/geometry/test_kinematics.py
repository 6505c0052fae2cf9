"""The skeleton moves as OpenSim's: joints, couplers, points that move or come and go."""

from dataclasses import replace

import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.geometry.kinematics import CoordinateValues, body_motion, path_points
from wrapjax.geometry.model_description import Polynomial, Spline
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles


def straight_length_and_arms(model, muscle, coordinates, poses):
    """From point to point; right for muscles that do not wrap."""
    values = CoordinateValues(model, coordinates, poses)
    points = model.muscle(muscle).points
    found = path_points(points, body_motion(values, {point.body for point in points}), values)
    length, arms = np.zeros(len(poses)), np.zeros((len(poses), len(coordinates)))
    for pose in range(len(poses)):
        on = np.flatnonzero(found.active[pose])
        way = np.diff(found.position[pose, on], axis=0)
        pieces = np.linalg.norm(way, axis=1)
        length[pose] = pieces.sum()
        rate = np.diff(found.velocity[pose][:, on], axis=1)
        arms[pose] = -np.einsum("sk,csk->c", way / pieces[:, None], rate)
    return length, arms


@pytest.mark.parametrize("muscle", ["extensor", "toe_flexor", "conditional", "moving"])
def test_couplers_and_points_of_every_kind_equal_opensim(odd_model, muscle):
    coordinates = ("hip", "knee")
    poses = np.random.default_rng(0).uniform([-1.0, 0.0], [1.0, 2.0], (200, 2))
    truth = analyse_muscles(odd_model, [muscle], coordinates, poses)
    length, arms = straight_length_and_arms(describe_model(odd_model), muscle, coordinates, poses)
    np.testing.assert_allclose(length, truth.length[:, 0], atol=1e-13)
    # OpenSim 4.6 lets no force act on a moving point between two points of its own body.
    spanned = [0] if muscle == "moving" else [0, 1]
    np.testing.assert_allclose(arms[:, spanned], truth.moment_arm[:, spanned, 0], atol=1e-12)


def test_a_moving_points_arm_is_the_slope_of_length(odd_model):
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
    """500 poses each: pins, universal and custom joints of splines and polynomials, coupled patellas."""
    file = data_folder / subject / "model.osim"
    model = describe_model(file)
    hip = ("hip_flexion", "hip_adduction", "hip_rotation")
    names = [f"{name}_{side}" for name in (*hip, "knee_angle", "ankle_angle", "subtalar_angle")]
    known = {coordinate.name for coordinate in model.coordinates}
    coordinates = tuple(name for name in names if name in known)
    muscles = [entry.name for entry in model.muscles if not entry.wraps and entry.name.endswith(f"_{side}")]
    low, high = [-0.6, -0.4, -0.4, 0.0, -0.5, -0.3], [1.0, 0.4, 0.4, 1.6, 0.4, 0.3]
    poses = np.random.default_rng(2).uniform(low, high, (500, 6))[:, : len(coordinates)]
    truth = analyse_muscles(file, muscles, coordinates, poses)
    assert len(muscles) == 19
    for place, muscle in enumerate(muscles):
        length, arms = straight_length_and_arms(model, muscle, coordinates, poses)
        np.testing.assert_allclose(length, truth.length[:, place], atol=1e-9, rtol=0)
        np.testing.assert_allclose(arms, truth.moment_arm[:, :, place], atol=1e-8, rtol=0)


def test_a_function_of_unknown_kind_is_refused_where_it_matters(odd_model):
    model = describe_model(odd_model)
    blind = replace(
        model,
        coordinates=tuple(
            replace(entry, coupler=None) if entry.name == "patella_turn" else entry
            for entry in model.coordinates
        ),
    )
    values = CoordinateValues(blind, ("hip", "knee"), np.zeros((1, 2)))
    body_motion(values, ["shank"])
    with pytest.raises(InputError, match="follows knee by a function of an unknown kind"):
        body_motion(values, ["pulley"])


def test_a_joint_of_unknown_kind_may_only_rest(odd_model):
    model = describe_model(odd_model)
    joints = tuple(
        replace(joint, kind="BallJoint", axes=None) if joint.name == "knee_joint" else joint
        for joint in model.joints
    )
    strange = replace(model, joints=joints)
    at_rest = body_motion(CoordinateValues(strange, ("hip",), np.array([[0.3]])), ["foot"])["foot"]
    moved = body_motion(CoordinateValues(model, ("hip",), np.array([[0.3]])), ["foot"])["foot"]
    np.testing.assert_allclose(at_rest.origin, moved.origin, atol=1e-14)
    with pytest.raises(InputError, match="joint 'knee_joint' is a BallJoint"):
        body_motion(CoordinateValues(strange, ("knee",), np.array([[0.3]])), ["foot"])


@pytest.mark.parametrize(
    "function",
    [
        Polynomial((2.0, -1.0, 0.5)),
        Polynomial((0.7,)),
        Spline((0.0, 1.0, 3.0), (0.1, 0.4, -0.2), (0.3, 0.0, 1.0)),
    ],
)
def test_slopes_of_functions_are_their_derivatives(function):
    at = np.linspace(-2.0, 5.0, 41)
    difference = (function.value(at + 1e-6) - function.value(at - 1e-6)) / 2e-6
    np.testing.assert_allclose(function.derivative(at), difference, atol=1e-8)
    np.testing.assert_allclose(function.scaled(-2.5).value(at), -2.5 * function.value(at), rtol=1e-14)


def test_splines_go_on_straight_beyond_their_ends():
    spline = Spline((0.0, 1.0), (0.0, 1.0), (2.0, 0.5))
    np.testing.assert_allclose(spline.value(np.array([-1.0, 3.0])), [-2.0, 2.0], rtol=1e-15)
