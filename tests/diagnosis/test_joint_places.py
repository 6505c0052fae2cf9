"""Defends: what uncertain joints do to moments is their signature, and a calibration follows as it should."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial

from wrapjax.diagnosis.diagnosis import diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.joint_places import after_calibration, joint_place_errors
from wrapjax.diagnosis.linearization import linearize
from wrapjax.report.diagnosis_joints import joint_places_section
from wrapjax.subject.joint_spread import JointSpread

KEPT = {"hip_center_offset", "joint_center_spread"}


def test_a_calibration_follows_as_least_squares_of_changes_and_sums_do():
    generator = np.random.default_rng(0)
    calibrated, changes = generator.normal(size=(4, 30)), generator.normal(size=(2, 30))
    precision = generator.uniform(0.1, 2.0, 30)
    left, moved = after_calibration(changes, calibrated, precision)
    root = np.sqrt(precision)
    design = np.concatenate([(calibrated * root).T, np.eye(4)])
    for change, rest, own in zip(changes, left, moved.T, strict=True):
        expected = np.linalg.lstsq(design, np.concatenate([change * root, np.zeros(4)]))[0]
        np.testing.assert_allclose(own, expected, rtol=1e-9)
        np.testing.assert_allclose(rest, change - expected @ calibrated, atol=1e-12)


def test_a_calibration_removes_what_its_parameters_do_and_nothing_else():
    calibrated = np.eye(3, 5)
    changes = np.array([[1.0, 2.0, 0.0, 0.0, 3.0]])
    left, moved = after_calibration(changes, calibrated, np.full(5, 1e9))
    np.testing.assert_allclose(left, [[0.0, 0.0, 0.0, 0.0, 3.0]], atol=1e-8)
    np.testing.assert_allclose(moved[:, 0], [1.0, 2.0, 0.0], rtol=1e-8)


@pytest.fixture(scope="module")
def data(calibrated):
    return diagnosis_input(calibrated, sorted(set(CATALOGUE) - KEPT))


def change(derivatives, effect_sizes):
    return jnp.einsum("p,ptcf->tcf", effect_sizes, derivatives)


@pytest.fixture(scope="module")
def moved(data):
    """Places of joints whose centers change one moment each by 100 or 200 N m for each meter forward."""
    derivatives = {
        "hip_center_offset": np.zeros((3, *data.measured.shape)),
        "joint_center_spread": np.zeros((6, *data.measured.shape)),
    }
    derivatives["hip_center_offset"][0, :, 0] = 100.0
    derivatives["joint_center_spread"][0, :, 1] = 200.0
    context = dataclasses.replace(
        data.context,
        measured_changes={id: {"": Partial(change, one)} for id, one in derivatives.items()},
        joint_spread={"knee_angle_l": JointSpread((0.001, 0.002, 0.002), (None, None, None))},
    )
    moved = dataclasses.replace(data, context=context)
    return moved, linearize(moved, moved.variables)


@pytest.fixture(scope="module")
def places(moved):
    data, linearized = moved
    return joint_place_errors(data, linearized, data.variables)


def test_without_ground_forces_no_joint_is_reported(data, moved):
    """Inverse dynamics cannot be computed anew, so nothing is known of joints."""
    _, linearized = moved
    assert joint_place_errors(data, linearized, data.variables) == ()


def test_a_joint_changes_moments_by_its_spread(places, data):
    """The hip has the usual 7 mm of a scaled model, the knee the 1 mm that markers leave."""
    assert len(places) == 2
    hip, knee = (next(one for one in places if one.joint == name) for name in ("hip", "knee"))
    first, second = data.context.coordinates[:2]
    assert (hip.quantity, hip.from_markers, hip.sd) == ("translation", False, (0.007,) * 3)
    assert (knee.from_markers, knee.sd) == (True, (0.001, 0.002, 0.002))
    assert hip.moment_sd == pytest.approx({first: 0.7, second: 0.0})
    assert knee.moment_sd == pytest.approx({first: 0.0, second: 0.2})


def test_a_calibration_takes_up_part_of_the_change(places):
    for one in places:
        left, before = (sum(value**2 for value in sd.values()) for sd in (one.left_sd, one.moment_sd))
        assert 0.0 < left < before
        assert 0.0 < one.parameter_shift < 1.0


def test_a_calibration_follows_as_its_objective_does(places, moved):
    """A Gauss-Newton step of the objective, whose measured moments have changed as by the hip center."""
    data, linearized = moved
    problem, at = data.law.free, jnp.asarray(data.law.with_free_law(data.variables))
    changed = dataclasses.replace(problem, measured=problem.measured.at[:, 0].add(0.7))
    before, after = (one.linearized_at(at) for one in (problem, changed))
    step = np.linalg.solve(before.gauss_newton, before.gradient - after.gradient)
    expected = np.max(np.abs(step) / linearized.parameter_sd)
    hip = next(one for one in places if one.joint == "hip")
    # The linearised model has fewer frames, mean envelopes, and a wide prior in place of bounds.
    assert hip.parameter_shift == pytest.approx(expected, rel=0.1)


def test_the_section_shows_what_changes_most(places):
    page = joint_places_section(places)
    assert "knee center" in page and "1.0, 2.0, 2.0 mm" in page and "markers" in page
    assert joint_places_section(()) == ""
