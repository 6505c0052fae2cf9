"""Defends: a freedom that would calibrate something else than was meant is refused with the reason."""

from dataclasses import replace

import numpy as np
import pytest

from wrapjax.model.freedom import nga_freedom
from wrapjax.model.parameters import initial_parameters


@pytest.fixture
def freedom():
    return nga_freedom(initial_parameters(*np.array([[1000.0], [0.1], [0.2], [0.1]])))


def test_a_parameter_is_held_by_its_name(freedom):
    held = freedom.without(["optimal_fiber_length", "electromechanical_delay"])
    assert [one.name for one in held.parameters] == [
        "activation_time_constant",
        "activation_nonlinearity",
        "emg_scale",
        "tendon_slack_length",
    ]


def test_a_mistyped_parameter_is_not_silently_left_free(freedom):
    with pytest.raises(ValueError, match=r"emg_scal: not free; free are .*emg_scale"):
        freedom.without(["emg_scal"])


def test_a_parameter_is_freed_once(freedom):
    with pytest.raises(ValueError, match="emg_scale: freed twice"):
        replace(freedom, parameters=(*freedom.parameters, freedom.parameters[3]))


def test_there_must_be_such_a_parameter_and_bounds_in_order(freedom):
    scale = freedom.parameters[3]
    with pytest.raises(ValueError, match=r"'emg_gain' is no model parameter; there are .*emg_scale"):
        replace(scale, name="emg_gain")
    with pytest.raises(ValueError, match="a lower bound is above"):
        replace(scale, lower=2.0 * scale.upper)
