"""Calibration to a minute of recorded treadmill walking."""

import numpy as np
import pytest

import wrapjax


@pytest.mark.slow
def test_moment_errors_of_53_cycles_are_similar(data_folder):
    subject = wrapjax.load_subject(data_folder / "healthy_treadmill")
    found = wrapjax.calibrate(subject, "NGA", wrapjax.exact_geometry(subject), starts=1).result
    assert found.solution.status.converged and found.coordinates == ("knee_angle_l", "ankle_angle_l")
    error = np.abs(found.modelled - found.measured).mean(axis=2)
    before = np.abs(found.initial_modelled - found.measured).mean(axis=2)
    calibrated, validated = error[:30], error[30:]
    assert len(validated) == 23
    # No cycle stands out; those not calibrated on are explained as well; all are better than before.
    assert (error.std(axis=0) < 0.15 * error.mean(axis=0)).all()
    np.testing.assert_allclose(validated.mean(axis=0), calibrated.mean(axis=0), rtol=0.1)
    assert (error.mean(axis=0) < 0.8 * before.mean(axis=0)).all()
    # Less than a tenth more or less from the first cycle to the last.
    drift = np.polyfit(np.linspace(0.0, 1.0, len(error)), error, 1)[0]
    assert (np.abs(drift) < 0.1 * error.mean(axis=0)).all()
