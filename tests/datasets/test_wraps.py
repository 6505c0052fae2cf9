"""Displaced cylinders: the true ones differ from those of the written model, and paths are as smooth."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from wrapjax.datasets.virtual_person.anatomy import COORDINATES, CYLINDERS
from wrapjax.datasets.virtual_person.true_parameters import (
    LARGEST_CHANGE,
    TRUE_PARAMETERS_FILE,
    parameter_names,
    read_true_parameters,
)
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.geometry.exact_paths.wrapping import NOMINAL, WRAP_PARAMETERS
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.path_sources.exact import exact_geometry
from wrapjax.subject.subject import load_subject

SPREAD = 0.6


@pytest.fixture(scope="module")
def displaced_folder(tmp_path_factory):
    """The noise-free subject with displaced cylinders."""
    folder = tmp_path_factory.mktemp("hidden") / "subject"
    series = (Series(0.8, 1, 0), Series(1.2, 0, 1))
    write_virtual_subject(folder, seed=3, emg_noise=0.0, moment_noise=0.0, series=series, wrap_spread=SPREAD)
    return folder


@pytest.fixture(scope="module")
def displaced(displaced_folder):
    return read_true_parameters(displaced_folder)


def test_cylinders_differ_within_the_spread(displaced):
    assert set(displaced.wraps) == {cylinder.name for cylinder in CYLINDERS}
    changes = (np.stack(list(displaced.wraps.values())) - NOMINAL) / LARGEST_CHANGE
    assert np.abs(changes).max() <= SPREAD
    assert (np.ptp(changes, axis=0) > 0.5 * SPREAD).all()


def test_nothing_else_changes(displaced, clean_truth, displaced_folder, clean_folder):
    """The written model is nominal; muscles and walking are those of the same seed."""
    for name in parameter_names():
        assert np.array_equal(getattr(displaced, name), getattr(clean_truth, name))
    assert clean_truth.wraps == {}
    same = ("model.osim", "trials/walk_0p8_1/angles.sto", "trials/walk_0p8_1/emg.sto")
    for file in same:
        assert (displaced_folder / file).read_bytes() == (clean_folder / file).read_bytes(), file
    moments = [load_subject(folder).trials.moments for folder in (displaced_folder, clean_folder)]
    assert np.abs(moments[0] - moments[1]).max() > 1.0


def test_true_parameters_are_read_with_and_without_cylinders(displaced_folder, displaced):
    content = json.loads((displaced_folder / TRUE_PARAMETERS_FILE).read_text())
    for name, values in content["wraps"].items():
        assert tuple(values) == WRAP_PARAMETERS
        assert list(values.values()) == displaced.wraps[name].tolist()


def test_a_file_of_an_earlier_version_without_cylinders_is_read(displaced_folder, tmp_path):
    content = json.loads((displaced_folder / TRUE_PARAMETERS_FILE).read_text())
    del content["wraps"]
    (tmp_path / TRUE_PARAMETERS_FILE).write_text(json.dumps(content))
    assert read_true_parameters(tmp_path).wraps == {}


def test_true_cylinders_are_within_the_barriers(tmp_path):
    """This person's first placement has continuous paths, but is beyond a barrier."""
    series = (Series(0.8, 1, 0), Series(1.2, 1, 0))
    truth = write_virtual_subject(
        tmp_path / "v", seed=2, emg_noise=0.0, moment_noise=0.0, series=series, wrap_spread=SPREAD
    )
    subject = load_subject(tmp_path / "v")
    geometry = exact_geometry(subject)
    freedom = geometry.freedom("PGA", subject)
    moved = np.array([truth.wraps[name] - NOMINAL for name in freedom.wraps.names])
    places = freedom.wraps.places
    changes = np.where((places >= 0)[..., None], moved[places], 0.0).reshape(len(places), -1)
    paths = geometry.paths(subject, subject.trials, freedom)
    assert np.isfinite(eqx.filter_jit(paths.at)(jnp.asarray(changes)).proximity).all()


def test_true_paths_are_continuous(displaced_folder, displaced, tmp_path):
    """OpenSim's lengths with the true cylinders change between frames no more than with the nominal ones."""
    subject = load_subject(displaced_folder)
    trials = subject.trials
    assert trials.coordinates == COORDINATES
    write_personalised_model(subject.model_file, tmp_path / "true.osim", displaced.wraps, {})
    moved = []
    bends = []
    for model in (subject.model_file, tmp_path / "true.osim"):
        poses = np.moveaxis(trials.angles, 1, -1)
        found = analyse_muscles(
            model, subject.muscles.names, COORDINATES, np.concatenate(poses), quiet=True, processes=1
        )
        length = found.length.reshape(*poses.shape[:2], -1)
        moved.append(length)
        bends.append(np.abs(np.diff(length, 2, axis=1)).max())
    assert np.abs(moved[1] - moved[0]).max() > 1e-3
    assert bends[1] < 1.5 * bends[0]


def test_too_large_a_spread_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no usable placement was found for cylinder"):
        write_virtual_subject(tmp_path / "v", series=(Series(1.2, 2, 0),), wrap_spread=30.0)
    assert not (tmp_path / "v").exists()
