"""Polynomial fits: reported errors, storage, cache keys."""

import dataclasses

import jax
import numpy as np
import pytest

from wrapjax.errors import InputError
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.path_sources.path_fitting import fit
from wrapjax.path_sources.polynomial_fit import load_fit


def test_reported_errors_hold_in_other_poses(person, paths):
    """Compare with OpenSim in other poses near the recorded ones."""
    fractions = np.random.default_rng(11).uniform(0.2, 0.8, size=(60, 2))
    low, high = person.trials.angles.min(axis=(0, 2)), person.trials.angles.max(axis=(0, 2))
    # Along the recorded curve: independent coordinates may be far from all recorded poses.
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
    dataset = paths.to_dataset()
    assert dataset["length_max"].attrs["units"] == "m"
    for name, one in paths.errors.items():
        assert float(dataset["moment_arm_rmse"].sel(muscle=name)) == pytest.approx(
            1e-3 * one.moment_arm_rmse_mm
        )


def test_round_trip(person, paths, tmp_path):
    paths.save(tmp_path / "fit")
    again = load_fit(tmp_path / "fit", person)
    assert again.key == paths.key and again.errors == paths.errors and again.seconds == paths.seconds
    assert jax.tree.structure(again.surrogate) == jax.tree.structure(paths.surrogate)
    for one, other in zip(jax.tree.leaves(again.surrogate), jax.tree.leaves(paths.surrogate), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_existing_folders_are_not_overwritten(paths, tmp_path):
    paths.save(str(tmp_path / "fit"))
    with pytest.raises(InputError, match="exists already"):
        paths.save(tmp_path / "fit")
    paths.save(tmp_path / "fit", force=True)


def test_the_subject_is_checked_only_if_given(paths, tmp_path):
    paths.save(tmp_path / "fit")
    assert load_fit(tmp_path / "fit").key == paths.key


@pytest.mark.parametrize("changed", ["angles", "time"])
def test_other_cycles_give_another_key(person, paths, changed):
    """The cached fit depends on the recorded poses."""
    from wrapjax.path_sources.path_fitting import _key

    trials = dataclasses.replace(person.trials, **{changed: getattr(person.trials, changed) + 1e-9})
    assert _key(dataclasses.replace(person, trials=trials), "opensim", 0) != paths.key
    assert _key(person, "opensim", 1) != paths.key
    assert _key(person, "opensim", 0) == paths.key


def test_moments_and_emg_are_not_part_of_the_key(person, paths):
    from wrapjax.path_sources.path_fitting import _key

    trials = dataclasses.replace(person.trials, moments=0.5 * person.trials.moments)
    assert _key(dataclasses.replace(person, trials=trials), "opensim", 0) == paths.key


def test_unknown_geometry(person):
    with pytest.raises(ValueError, match="unknown geometry 'guess': expected one of opensim, engine"):
        fit(person, "guess")
