"""Defends: candidate trials move joints within their ranges, with the signs of the model."""

import numpy as np
import pytest

from wrapjax.diagnosis.protocol.trials import candidate_trials, positions, rates

NAMES = ("hip_flexion_r", "knee_angle_r", "ankle_angle_r")
RANGES = dict(zip(NAMES, ((-0.5, 2.1), (0.0, 2.1), (-0.9, 0.5)), strict=True))


def by_id(ranges):
    return {trial.id: trial for trial in candidate_trials(NAMES, ranges)}


@pytest.mark.parametrize("sign", [1, -1])
def test_every_angle_is_within_the_range_of_the_model(sign):
    """Models differ in the sign of knee flexion."""
    ranges = RANGES | {"knee_angle_r": tuple(sorted((0.0, sign * 2.1)))}
    phase = np.linspace(0.0, 1.0, 21)
    for trial in by_id(ranges).values():
        for movement in trial.movements:
            angles = positions(movement, NAMES, dict.fromkeys(NAMES, 0.0), phase)
            for name, row in zip(NAMES, angles, strict=True):
                low, high = ranges[name]
                assert low - 1e-9 <= row.min() and row.max() <= high + 1e-9, (trial.id, name)
    flexed = by_id(ranges)["passive_ankle_angle_knee_flexed"]
    assert flexed.posture["knee_angle_r"] == pytest.approx(sign * 90.0)


def test_rates_are_the_derivatives_of_the_positions():
    (movement,) = by_id(RANGES)["passive_knee_angle"].movements
    phase = np.linspace(0.0, 1.0, 401)
    angles = positions(movement, NAMES, dict.fromkeys(NAMES, 0.0), phase)
    numerical = np.gradient(angles[1], phase * movement.seconds)
    expected = rates(movement, NAMES, phase)[1]
    np.testing.assert_allclose(numerical[1:-1], expected[1:-1], atol=1e-3 * np.abs(expected).max())


def test_the_catalogue_holds_the_trials_of_a_dynamometer_and_a_squat():
    trials = by_id(RANGES)
    assert {"passive_hip_flexion", "passive_ankle_angle", "isometric_ankle_angle", "squat"} <= set(trials)
    ramps = trials["isometric_ankle_angle"]
    assert len(ramps.movements) == 6 and ramps.measured == ("ankle_angle_r",)
    assert {movement.efforts[0][1] for movement in ramps.movements} == {1, -1}
    assert all(trial.minutes > 0 and trial.effort for trial in trials.values())
    assert not any(movement.efforts for movement in trials["passive_ankle_angle"].movements)


def test_joints_of_unknown_names_have_passive_and_isometric_trials():
    ids = {trial.id for trial in candidate_trials(("elbow",), {"elbow": (0.0, 2.0)})}
    assert ids == {"passive_elbow", "passive_elbow_two_speeds", "isometric_elbow"}
