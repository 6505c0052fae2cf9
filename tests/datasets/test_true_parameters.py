"""True parameters are physiological, and are read back as they were written."""

import numpy as np
import pytest

from wrapjax.datasets.virtual_person.leg import MUSCLES
from wrapjax.datasets.virtual_person.true_parameters import (
    draw_true_parameters,
    parameter_names,
    read_true_parameters,
)


@pytest.mark.parametrize("seed", range(5))
def test_true_parameters_are_within_their_ranges(seed):
    truth = draw_true_parameters(np.random.default_rng(seed))
    by_name = {muscle.name: muscle for muscle in MUSCLES}
    assert sorted(truth.muscles) == sorted(by_name)
    fiber = np.array([by_name[name].optimal_fiber_length for name in truth.muscles])
    slack = np.array([by_name[name].tendon_slack_length for name in truth.muscles])
    for values, lowest, highest in (
        (truth.electromechanical_delay, 0.030, 0.080),
        (truth.activation_time_constant, 0.010, 0.025),
        (truth.activation_nonlinearity, 0.0, 0.2),
        (truth.emg_scale, 0.1, 0.9),
        (truth.optimal_fiber_length / fiber, 0.9, 1.1),
        (truth.tendon_slack_length / slack, 0.9 - 1e-12, 1.1 + 1e-12),
    ):
        assert values.min() >= lowest
        assert values.max() <= highest
        assert np.ptp(values) > 0.3 * (highest - lowest)


def test_muscles_of_one_channel_are_more_alike():
    truths = [draw_true_parameters(np.random.default_rng(seed)) for seed in range(200)]
    delays = {
        name: np.array([truth.electromechanical_delay[truth.muscles.index(name)] for truth in truths])
        for name in ("glmax1_r", "glmax2_r", "soleus_r")
    }
    assert np.corrcoef(delays["glmax1_r"], delays["glmax2_r"])[0, 1] > 0.6
    assert abs(np.corrcoef(delays["glmax1_r"], delays["soleus_r"])[0, 1]) < 0.25


def test_round_trip(tmp_path):
    truth = draw_true_parameters(np.random.default_rng(0))
    truth.write(tmp_path)
    again = read_true_parameters(tmp_path)
    assert again.muscles == truth.muscles
    for name in parameter_names():
        assert np.array_equal(getattr(again, name), getattr(truth, name))
