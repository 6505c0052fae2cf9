import pytest

from tests.subject.synthetic import write_subject
from wrapjax.api import calibrate, fit, load_subject


@pytest.fixture(scope="session")
def person(tmp_path_factory):
    """Two muscles, two coordinates, three cycles."""
    return load_subject(write_subject(tmp_path_factory.mktemp("subjects") / "synthetic"))


@pytest.fixture(scope="session")
def paths(person):
    return fit(person)


@pytest.fixture(scope="session")
def calibrated(person, paths):
    return calibrate(person, "NGA", paths, starts=1)
