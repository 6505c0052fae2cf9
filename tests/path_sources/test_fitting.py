"""``fit`` replaces paths by polynomials that are as good as it says, and comes back from disk unchanged."""

import dataclasses

import jax
import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.path_sources.path_fitting import fit
from wrapjax.path_sources.polynomial_fit import load_fit


def test_stated_errors_are_those_on_other_poses(person, paths):
    """Against OpenSim at poses of our own, well inside the walking belt."""
    fractions = np.random.default_rng(11).uniform(0.2, 0.8, size=(60, 2))
    low, high = person.trials.angles.min(axis=(0, 2)), person.trials.angles.max(axis=(0, 2))
    # On the recorded curve: two coordinates apart may be far outside the belt at every frame.
    frames = np.random.default_rng(12).integers(0, 100, size=60)
    poses = person.trials.angles[0, :, frames] + 0.02 * (fractions - 0.5)
    assert ((poses > low - 0.02) & (poses < high + 0.02)).all()
    truth = analyse_muscles(
        person.model_file, person.muscles.names, paths.surrogate.coordinates, poses, processes=1, quiet=True
    )
    grid = jax.numpy.asarray(poses.T[None])
    found = paths.surrogate(grid, 0.0 * grid)
    for row, name in enumerate(paths.surrogate.muscles):
        stated = paths.errors[name]
        length_error = 1e3 * np.abs(np.asarray(found.length)[row, 0] - truth.length[:, row])
        arm_error = 1e3 * np.abs(np.asarray(found.moment_arm)[row, 0] - truth.moment_arm[:, :, row].T)
        # A wrong axis, sign or unit would be off by centimeters.
        assert length_error.max() <= 3.0 * stated.length_max_mm
        assert arm_error.max() <= 3.0 * stated.moment_arm_max_mm


def test_round_trip(person, paths, tmp_path):
    paths.save(tmp_path / "fit")
    again = load_fit(tmp_path / "fit", person)
    assert again.key == paths.key and again.errors == paths.errors and again.seconds == paths.seconds
    assert jax.tree.structure(again.surrogate) == jax.tree.structure(paths.surrogate)
    for one, other in zip(jax.tree.leaves(again.surrogate), jax.tree.leaves(paths.surrogate), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_saving_refuses_what_exists(paths, tmp_path):
    paths.save(str(tmp_path / "fit"))
    with pytest.raises(InputError, match="exists already"):
        paths.save(tmp_path / "fit")
    paths.save(tmp_path / "fit", force=True)


def test_any_subject_if_none_is_named(paths, tmp_path):
    paths.save(tmp_path / "fit")
    assert load_fit(tmp_path / "fit").key == paths.key


@pytest.mark.parametrize("changed", ["angles", "time"])
def test_other_cycles_are_another_question(person, paths, changed):
    """The cache must not answer with the poses of others."""
    from wrapjax.path_sources.path_fitting import _key

    trials = dataclasses.replace(person.trials, **{changed: getattr(person.trials, changed) + 1e-9})
    assert _key(dataclasses.replace(person, trials=trials), "opensim", 0) != paths.key
    assert _key(person, "opensim", 1) != paths.key
    assert _key(person, "opensim", 0) == paths.key


def test_moments_and_emg_are_no_part_of_the_question(person, paths):
    from wrapjax.path_sources.path_fitting import _key

    trials = dataclasses.replace(person.trials, moments=0.5 * person.trials.moments)
    assert _key(dataclasses.replace(person, trials=trials), "opensim", 0) == paths.key


def test_unknown_geometry(person):
    with pytest.raises(ValueError, match="unknown geometry 'guess': expected one of opensim, engine"):
        fit(person, "guess")
