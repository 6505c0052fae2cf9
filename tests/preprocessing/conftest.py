import pytest

from tests.preprocessing.made_up_project import write_project


@pytest.fixture
def project(tmp_path):
    """A project's folder, without settings."""
    return write_project(tmp_path)
