"""Defends: what uncertain joints do to moments is their signature, and a calibration follows as it should."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial

from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.calibration.uncertainty.posterior import physical_units
from wrapjax.diagnosis.diagnosis import diagnosis_input
from wrapjax.diagnosis.effects.catalogue import CATALOGUE
from wrapjax.diagnosis.effects.definition import JointPlace
from wrapjax.diagnosis.evidence.linearization import linearize
from wrapjax.diagnosis.uncertain_joints import place_covariance, uncertain_joints
from wrapjax.report.diagnosis.joints import uncertain_joints_section
from wrapjax.subject.joint_spread import JointSpread

KEPT = {"hip_center_offset", "joint_center_spread"}


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
def joints(moved):
    data, linearized = moved
    return uncertain_joints(data, linearized, data.variables)


@pytest.fixture(scope="module")
def places(joints):
    return joints.places


def test_without_ground_forces_no_joint_is_reported(data, moved):
    """Inverse dynamics cannot be computed anew, so nothing is known of joints."""
    _, linearized = moved
    assert uncertain_joints(data, linearized, data.variables) is None


def test_a_joint_changes_moments_by_its_spread(places, data):
    """The hip has the usual 7 mm of a scaled model, the knee the 1 mm that markers leave."""
    assert len(places) == 2
    hip, knee = (next(one for one in places if one.joint == name) for name in ("hip", "knee"))
    first, second = data.context.coordinates[:2]
    assert (hip.quantity, hip.from_markers) == ("translation", False)
    assert hip.sd == pytest.approx((0.007,) * 3)
    assert knee.from_markers and knee.sd == pytest.approx((0.001, 0.002, 0.002))
    assert hip.moment_sd == pytest.approx({first: 0.7, second: 0.0})
    assert knee.moment_sd == pytest.approx({first: 0.0, second: 0.2})


def test_independent_joints_add_their_variances(joints):
    for sd in ("moment_sd", "left_sd"):
        for name, value in getattr(joints, sd).items():
            assert value**2 == pytest.approx(sum(getattr(one, sd)[name] ** 2 for one in joints.places))


def test_a_calibration_takes_up_part_of_the_change(places):
    for one in places:
        left, before = (sum(value**2 for value in sd.values()) for sd in (one.left_sd, one.moment_sd))
        assert 0.0 < left < before
        assert one.parameter and one.parameter_shift > 0.0


def test_a_calibration_follows_as_its_objective_does(joints, moved):
    """A solution of the objective whose measured moments have changed as by the joints."""
    data, _ = moved
    problem, bounds = data.calibrated, (data.calibrated.lower, data.calibrated.upper)
    solver = AugmentedLagrangian(ProjectedLevenbergMarquardt(gtol=1e-11, ftol=1e-15))
    at = solver.solve(problem, data.solver_state).variables
    free = (at > bounds[0]) & (at < bounds[1])
    moved_by = np.zeros((2, len(at)))
    for row, (coordinate, change) in enumerate(((0, 0.7), (1, 0.2))):
        # A small share of the change, for which the problem is linear.
        changed = dataclasses.replace(problem, measured=problem.measured.at[:, coordinate].add(0.01 * change))
        moved_by[row] = (solver.solve(changed, data.solver_state).variables - at) / 0.01
    scale = physical_units(problem.variables).scale
    expected = dict(
        zip(problem.variables.labels, np.sqrt(np.sum((moved_by * scale) ** 2, axis=0)), strict=True)
    )
    assert free.sum() == len(joints.parameters)
    for one in joints.parameters[:10]:
        assert one.sd_by_joints == pytest.approx(expected[one.name], rel=0.1)


def test_correlated_places_of_a_left_leg_have_the_signs_of_the_effects():
    """To the right is inward in a left leg, and the opposite of outward."""
    correlation = np.zeros((6, 6))
    correlation[0, 2] = correlation[0, 4] = 0.5
    spread = {
        "hip_flexion_l": JointSpread((0.1,) * 3, (None,) * 3, {"knee_angle_l": correlation}),
        "knee_angle_l": JointSpread((0.1,) * 3, (0.1,) * 3, {"hip_flexion_l": correlation.T}),
    }
    places = [
        JointPlace("hip_", "translation", 0),
        JointPlace("knee_angle", "translation", 2),
        JointPlace("knee_angle", "orientation", 1),
    ]
    sd = np.array([0.1, 0.2, 0.3])
    found = place_covariance(places, sd, [True] * 3, spread)
    np.testing.assert_allclose(found[0], [0.01, -0.5 * 0.02, 0.5 * 0.03])
    np.testing.assert_allclose(found, found.T)
    # What markers do not determine is independent of what they do.
    assert place_covariance(places, sd, [False, True, True], spread)[0, 1] == 0.0


def test_the_section_shows_what_changes_most(joints):
    page = uncertain_joints_section(joints)
    assert "knee center" in page and "1.0, 2.0, 2.0 mm" in page and "markers" in page
    assert joints.parameters[0].name in page and "of muscles that uncertain joints move" in page
    assert uncertain_joints_section(None) == ""
