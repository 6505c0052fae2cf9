"""Fixtures of the tests in this folder."""

from tests.calibration.fixtures import calibrated as calibrated
from tests.calibration.fixtures import paths as paths
from tests.calibration.fixtures import person as person
