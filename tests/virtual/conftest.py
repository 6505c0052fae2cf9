import opensim
import pytest

from wrapjax.virtual import Series, build_leg_model, read_truth, write_virtual_subject


@pytest.fixture(scope="session")
def leg_file(tmp_path_factory):
    """The virtual leg's model."""
    opensim.Logger.setLevelString("Off")
    path = tmp_path_factory.mktemp("leg") / "model.osim"
    build_leg_model(path)
    return path


@pytest.fixture(scope="session")
def clean_folder(tmp_path_factory):
    """A virtual subject without any noise: one cycle at either speed."""
    folder = tmp_path_factory.mktemp("subjects") / "clean"
    series = (Series(0.8, 1, 0), Series(1.2, 0, 1))
    write_virtual_subject(folder, seed=3, emg_noise=0.0, moment_noise=0.0, series=series)
    return folder


@pytest.fixture(scope="session")
def clean_truth(clean_folder):
    return read_truth(clean_folder)
