"""Fixtures of the tests in this folder."""

import pytest

from tests.calibration.fixtures import calibrated as calibrated
from tests.calibration.fixtures import paths as paths
from tests.calibration.fixtures import person as person
from wrapjax.geometry.surrogates import training_samples


@pytest.fixture(scope="module")
def fewer_samples():
    """Sample wraps less often than fits do, in all tests of a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_samples, "TRAINING_SAMPLES", 300)
        patch.setattr(training_samples, "VALIDATION_SAMPLES", 60)
        yield
