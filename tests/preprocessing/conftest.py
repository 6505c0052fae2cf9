import pytest

from tests.preprocessing.synthetic_project import write_project


@pytest.fixture
def project(tmp_path):
    """A project's folder, without settings."""
    return write_project(tmp_path)
