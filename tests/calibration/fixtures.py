"""Fixtures with a small synthetic subject and its calibration, for the conftest of several folders."""

import pytest

from tests.subject.synthetic import write_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.path_sources.path_fitting import fit
from wrapjax.subject.subject import load_subject as load_subject


@pytest.fixture(scope="session")
def person(tmp_path_factory):
    """Subject with two muscles, two coordinates and three cycles."""
    return load_subject(write_subject(tmp_path_factory.mktemp("subjects") / "synthetic"))


@pytest.fixture(scope="session")
def paths(person):
    return fit(person)


@pytest.fixture(scope="session")
def calibrated(person, paths):
    return calibrate(person, "NGA", paths, starts=1)
