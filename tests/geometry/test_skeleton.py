"""Tests of the skeleton: OpenSim as the judge, NumPy against JAX, rates against derivatives."""

import jax
import numpy as np
import pytest

from tests.osim.many_joints import many_joints as many_joints
from validation.skeleton import compare_with_opensim
from wrapjax.geometry.skeleton.bodies import body_poses, build_skeleton, stations
from wrapjax.geometry.skeleton.functions import Piece, PiecewisePolynomial, Spline, evaluate, tabulate
from wrapjax.osim.model import describe_model


def test_joints_and_functions_of_every_class_equal_opensim(many_joints):
    description = describe_model(many_joints)
    assert {joint.kind for joint in description.joints} == {
        *("FreeJoint", "BallJoint", "PinJoint", "SliderJoint", "UniversalJoint", "GimbalJoint"),
        *("PlanarJoint", "WeldJoint", "CustomJoint"),
    }
    assert all(joint.axes is not None for joint in description.joints)
    row = compare_with_opensim(many_joints, 100)
    assert max(row["angle_rad"], row["origin_m"], row["marker_m"]) < 1e-12


@pytest.mark.parametrize(
    "model",
    [
        "healthy_running/model.osim",
        "healthy_overground/model.osim",
        "markers_walk/RajagopalLaiUhlrich2023.osim",
        "s1_left/model.osim",
    ],
)
def test_recorded_models_equal_opensim(data_folder, model):
    row = compare_with_opensim(data_folder / model, 10)
    assert max(row["angle_rad"], row["origin_m"], row["marker_m"]) < 1e-12


def test_jax_computes_the_same_and_rates_are_the_derivatives_of_positions(many_joints):
    model = describe_model(many_joints)
    names = tuple(entry.name for entry in model.coordinates if not entry.coupled_to)
    structure, skeleton = build_skeleton(model, names)
    pose = np.random.default_rng(3).uniform(-0.7, 0.7, len(names))
    location = np.array([[0.1, -0.2, 0.3]])
    body = structure.bodies.index("body9")

    @jax.jit
    def position(given):
        return stations(body_poses(structure, skeleton, given), [body], location)[0]

    here = body_poses(structure, skeleton, pose)
    point = stations(here, [body], location)[0]
    np.testing.assert_allclose(position(pose), point, atol=1e-14)
    rates = np.zeros((3, len(names)))
    for (joint, column), angular, linear in zip(structure.movers, here.angular, here.linear, strict=True):
        if structure.ancestors[body, joint]:
            rates[:, column] += linear + np.cross(angular, point)
    np.testing.assert_allclose(rates, jax.jacfwd(position)(pose), atol=1e-12)


def test_only_the_bodies_between_those_needed_and_ground_are_built(many_joints):
    structure, _ = build_skeleton(describe_model(many_joints), ("pin0",), ["body2"])
    assert structure.bodies == ("ground", "body0", "body1", "body2")


def test_tables_of_functions_equal_the_functions():
    functions = [
        Spline((0.0, 1.0, 3.0), (0.1, 0.4, -0.2), (0.3, 0.0, 1.0)),
        PiecewisePolynomial((0.5,), (Piece(0.0, (1.0, 2.0)), Piece(0.5, (2.0, -1.0, 0.3, 0.1)))).scaled(-2.0),
    ]
    at = np.linspace(-2.0, 5.0, 36)
    values, slopes = evaluate(tabulate(functions), np.stack([at, at], axis=-1))
    for column, function in enumerate(functions):
        np.testing.assert_allclose(values[:, column], function.value(at), atol=1e-13)
        np.testing.assert_allclose(slopes[:, column], function.derivative(at), atol=1e-13)
    difference = (functions[1].value(at + 1e-6) - functions[1].value(at - 1e-6)) / 2e-6
    np.testing.assert_allclose(slopes[:, 1], difference, atol=1e-8)
