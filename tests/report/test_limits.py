"""Tests of reported hard limits: at which muscles they are active, multipliers, and violations."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.report.solutions import with_solution
from wrapjax.calibration.calibration_result import describe_limits, largest_excess, muscles_at_limits
from wrapjax.calibration.path_penalties import path_limits
from wrapjax.report.calibration.calibration_curves import fiber_length_figure, fiber_length_finding
from wrapjax.report.calibration.run_summary import summarize


@pytest.fixture
def limited(result):
    """Calibration whose limit of the longest fiber is active in two frames of iliacus and one of soleus."""
    path = result.states.path
    nominal = type(path)(*(leaf[:, :2] for leaf in (path.length, path.velocity, path.moment_arm)))
    longest, shortest, sign = path_limits(nominal)
    shift = longest.shift.at[0, 3:5].set(0.002).at[1, 0].set(0.01)
    limits = (replace(longest, shift=shift, weight=jnp.full_like(shift, 50.0)), shortest, sign)
    return with_solution(result, problem=result.solution.problem.with_limits(limits), max_violation=0.0)


def test_active_limits_and_multipliers(limited):
    assert muscles_at_limits(limited)["longest_fiber"] == ("iliacus_l", "soleus_l")
    described = describe_limits(limited)
    assert list(described) == ["longest_fiber", "shortest_fiber", "moment_arm_sign"]
    assert described["longest_fiber"] == {
        "pushing": 3,
        "muscles": ["iliacus_l", "soleus_l"],
        "largest_multiplier": pytest.approx(2 * 50.0 * 0.01),
        "largest_excess": 0.0,
    }
    assert described["shortest_fiber"] == {
        "pushing": 0,
        "muscles": [],
        "largest_multiplier": 0.0,
        "largest_excess": 0.0,
    }


def test_violations_are_those_of_calibration_cycles(limited):
    assert set(largest_excess(limited).values()) == {0.0}
    # 1.415 to 1.429 for soleus, the last five frames on the validation cycle.
    beyond = replace(limited, states=limited.initial_states)
    assert largest_excess(beyond)["longest_fiber"] == pytest.approx(1.424 - 1.3)
    arms = limited.states.path.moment_arm.at[0, 1, 0, 2].set(-0.003)
    path = replace(limited.states.path, moment_arm=arms)
    turned = replace(limited, states=replace(limited.states, path=path))
    assert largest_excess(turned)["moment_arm_sign"] == pytest.approx(0.3)


def test_a_calibration_without_limits_has_none(result, subject):
    assert summarize(subject, result)["limits"] == {}
    assert fiber_length_figure(result).axes[0].get_legend_handles_labels()[1] == [
        "before calibration",
        "after",
    ]


def test_figure_marks_active_limits(limited):
    panel = fiber_length_figure(limited).axes[0]
    lines = [line for line in panel.get_lines() if line.get_label() == "hard limit"]
    assert [line.get_xdata()[0] for line in lines] == [0.3, 1.3]
    marks = [line.get_xydata() for line in panel.get_lines() if line.get_label() == "limit active"]
    assert [len(one) for one in marks] == [0, 2]
    np.testing.assert_allclose(marks[1][:, 0], 1.3)
    np.testing.assert_allclose(np.round(marks[1][:, 1]), [0, 1])


def test_a_fiber_length_on_a_limit_is_within_the_range(result):
    def at(*muscles):
        lengths = jnp.full_like(result.states.fiber.normalized_length, 1.0)
        for muscle, trial, length in muscles:
            lengths = lengths.at[muscle, trial, 0].set(length)
        fiber = replace(result.states.fiber, normalized_length=lengths)
        return fiber_length_finding(replace(result, states=replace(result.states, fiber=fiber)))

    assert "all muscles stay" in at((0, 0, 1.3 + 1e-7))
    assert "iliacus_l leaves this range." in at((0, 0, 1.31))
    assert "soleus_l leaves this range, on validation cycles only." in at((1, 2, 0.2))
    assert "iliacus_l, soleus_l leave this range." in at((0, 0, 1.31), (1, 2, 0.2))
