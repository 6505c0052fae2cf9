"""Priors of errors of joints that were personalised from markers."""

import pytest

from wrapjax.diagnosis.effects.scaled_model import (
    HIP_CENTER_OFFSET,
    JOINT_AXIS_ROTATION,
    JOINT_CENTER_SPREAD,
)
from wrapjax.diagnosis.inputs.context import Context
from wrapjax.subject.joint_spread import JointSpread

HIP = JointSpread((0.002, 0.004, 0.05), (None, None, None))
KNEE = JointSpread((0.001, 0.002, 0.006), (0.01, 0.02, None))


def _context(joint_spread):
    """A context of which nothing but the joints is known."""
    context = object.__new__(Context)
    object.__setattr__(context, "joint_spread", joint_spread)
    return context


@pytest.fixture
def context():
    return _context({})


@pytest.fixture
def narrow():
    return _context({"hip_flexion_l": HIP, "knee_angle_l": KNEE})


def test_a_personalised_hip_has_the_spread_that_markers_leave(context, narrow):
    generic, own = (HIP_CENTER_OFFSET.parameters_of(each) for each in (context, narrow))
    assert [entry.prior_sd for entry in generic] == [0.015] * 3
    assert [entry.prior_sd for entry in own] == [0.002, 0.004, 0.015]
    assert [entry.usual_sd for entry in own] == [0.002, 0.004, 0.007]
    assert own[0].limit == pytest.approx(0.008) and own[2].limit == generic[2].limit
    assert "personalised from markers" in own[0].source and own[2] == generic[2]


def test_axes_and_centers_of_a_personalised_knee_are_narrowed_and_the_ankle_is_not(context, narrow):
    """The knee's axis turned outward is a rotation about y of the thigh, its tilt one about x."""
    generic, own = (
        {entry.name: entry for entry in JOINT_AXIS_ROTATION.parameters_of(each)} for each in (context, narrow)
    )
    assert own["knee_rad"].prior_sd == 0.02 and own["knee_tilt_rad"].prior_sd == 0.01
    assert own["ankle_rad"] == generic["ankle_rad"]
    centers = {entry.name: entry.prior_sd for entry in JOINT_CENTER_SPREAD.parameters_of(narrow)}
    assert centers["knee_anterior_m"] == 0.001 and centers["knee_lateral_m"] == 0.005
    assert centers["ankle_anterior_m"] == 0.003
