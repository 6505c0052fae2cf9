import pytest

from tests.preprocessing.synthetic_project import write_project


@pytest.fixture
def project(tmp_path):
    """Folder of a synthetic project of the NMSM Pipeline, without settings."""
    return write_project(tmp_path)
