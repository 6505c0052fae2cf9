"""Fits with sampled wraps: reported errors, storage, report, and use in PGA."""

import json
import os
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from tests.path_sources.wrapped_knee import wrapped_model
from tests.subject.synthetic import write_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.errors import InputError
from wrapjax.geometry.exact_paths.engine import ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapping import NOMINAL
from wrapjax.geometry.surrogates.physiological import PhysiologicalThresholds
from wrapjax.osim.model import describe_model
from wrapjax.osim.path_engine import PathEngine
from wrapjax.osim.personalised_model import write_personalised_model
from wrapjax.path_sources import wrap_fitting
from wrapjax.path_sources.path_fitting import fit
from wrapjax.path_sources.path_samples import fit_poses
from wrapjax.path_sources.polynomial_fit import load_fit
from wrapjax.path_sources.wrap_fitting import fit_wraps
from wrapjax.subject.subject import load_subject as load_subject

pytestmark = pytest.mark.usefixtures("fewer_samples")


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    folder = write_subject(tmp_path_factory.mktemp("wrapped") / "synthetic")
    (folder / "model.osim").write_text(wrapped_model(), encoding="utf-8")
    return load_subject(folder)


@pytest.fixture(scope="module")
def sampled(person, fewer_samples):
    return fit_wraps(person, fit(person, "engine"))


def test_reported_errors_are_those_against_the_engine(person, sampled):
    """For other wrap parameters that the classifier accepts, in other poses."""
    error, wraps = sampled.errors["recfem_l"], sampled.wraps
    assert error.wrapped and not sampled.errors["semiten_l"].wrapped
    assert 0.0 < error.length_rmse_mm < 0.2 and 0.0 < error.moment_arm_rmse_mm < 0.8
    coordinates = sampled.surrogate.coordinates
    engine = ExactPaths(describe_model(person.model_file), ["recfem_l"], coordinates)
    poses = fit_poses(person, coordinates, seed=77).validation[::5]
    half = np.asarray(wraps.inner.half_range)[0, 0]
    changes = 0.5 * np.random.default_rng(3).uniform(-1.0, 1.0, (40, 6)) * half
    limit = wraps.feasibility["knee_front_l"]
    if limit is not None:
        changes = changes[np.asarray(jax.vmap(limit.excess)(jnp.asarray(changes + NOMINAL))) < -0.5]
    assert len(changes) >= 10
    truth = wrap_at_samples(engine.posed(poses)["recfem_l"], (changes + NOMINAL)[:, None])
    assert np.asarray(truth.touching).any()
    rows = []
    for change in changes:
        both = jnp.zeros((2, 6)).at[0].set(change)
        row = sampled.surrogate.coefficients[0] + wraps.inner(both)[0]
        used = np.asarray(sampled.surrogate.used[0])
        rows.append(sampled.surrogate.design("recfem_l", poses) @ np.asarray(row)[used])
    length = np.array(rows)[:, : len(poses)] - np.asarray(truth.length)
    assert 1e3 * np.sqrt(np.mean(length**2)) < 2.0 * error.length_rmse_mm


def test_errors_are_nominal_where_no_sample_is_physiological(person, sampled):
    """Without samples the errors would otherwise be zero."""
    plain = fit(person, "engine")
    hopeless = fit_wraps(person, plain, thresholds=PhysiologicalThresholds(length_deviation=1e-12))
    assert hopeless.wraps.quality["knee_front_l"].physiological_share == 0.0
    assert hopeless.errors["recfem_l"] == plain.errors["recfem_l"] != sampled.errors["recfem_l"]


def test_content_of_the_folder(sampled, tmp_path):
    sampled.save(tmp_path / "fit")
    content = json.loads((tmp_path / "fit" / "fit.json").read_text())
    entry = content["wraps"]["knee_front_l"]
    assert list(content["wraps"]) == ["knee_front_l"]
    assert 0.0 <= entry["physiological_share"] <= 1.0
    assert {"balanced_accuracy", "false_physiological"} <= set(entry)
    # Together with the margins the classifier can only reject more.
    assert entry["learned_false_physiological"] >= entry["false_physiological"]
    assert 0.5 < entry["learned_balanced_accuracy"] <= 1.0
    assert set(content["seconds"]) >= {"analysis", "fit", "boxes", "sampling", "feasibility"}


def test_the_report_uses_the_thresholds_of_the_fit(person, sampled, tmp_path):
    """A fit without wraps has a report without sampled paths."""
    usual = sampled.wraps.thresholds
    strict = replace(sampled, wraps=replace(sampled.wraps, thresholds=replace(usual, length_deviation=0.0)))
    saved = {"usual": sampled, "strict": strict, "plain": fit(person, "engine")}
    for name, one in saved.items():
        one.save(tmp_path / name, subject=person)
    pages = {name: (tmp_path / name / "report.html").read_text() for name in saved}
    assert "recfem_l (knee_front_l): 0 of 150 accepted" in pages["strict"]
    assert "<details>" in pages["usual"] and "recfem_l (knee_front_l): 0 of" not in pages["usual"]
    assert "<details>" not in pages["plain"] and "<h2>Cylinders" not in pages["plain"]
    assert load_fit(tmp_path / "strict", person).wraps.thresholds.length_deviation == 0.0


def test_a_failed_report_leaves_no_folder(person, sampled, tmp_path, monkeypatch):
    monkeypatch.setattr("wrapjax.report.paths.fit_page.render_fit", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        sampled.save(tmp_path / "fit")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="is no fit of subject"):
        replace(sampled, key="other-key").save(tmp_path / "fit", subject=person)


def test_round_trip(person, sampled, tmp_path):
    sampled.save(tmp_path / "fit")
    again = load_fit(tmp_path / "fit", person)
    for name in ("wraps_of", "translations", "touched", "quality"):
        assert getattr(again.wraps, name) == getattr(sampled.wraps, name)
    assert again.errors == sampled.errors and again.geometry == "engine"
    for kind in ("inner", "feasibility"):
        leaves = [jax.tree.leaves(getattr(one.wraps, kind)) for one in (again, sampled)]
        for one, other in zip(*leaves, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("damage", ["arrays gone", "cut short"])
def test_a_damaged_fit_is_refused(sampled, tmp_path, damage):
    sampled.save(tmp_path / "fit")
    file = tmp_path / "fit" / "fit.npz"
    if damage == "cut short":
        file.write_bytes(file.read_bytes()[:-2000])
    else:
        with np.load(file) as stored:
            kept = {name: value for name, value in stored.items() if not name.startswith("inner.")}
        np.savez(file, **kept)
    with pytest.raises(InputError, match="damaged"):
        load_fit(tmp_path / "fit")


def test_the_same_fit_is_read_from_the_cache(person, sampled, monkeypatch):
    monkeypatch.setattr(wrap_fitting, "_fit_wraps", None)
    again = fit_wraps(person, fit(person, "engine"))
    assert again.wraps.quality == sampled.wraps.quality
    assert not list(Path(os.environ["WRAPJAX_CACHE"]).rglob("report.html"))


def test_pga_requires_sampled_wraps(person):
    with pytest.raises(InputError, match="has no samples of them"):
        fit(person, "engine").freedom("PGA", person)


def test_all_sampled_wraps_can_be_free(person, sampled):
    untouched = replace(sampled, wraps=replace(sampled.wraps, touched=()))
    with pytest.raises(InputError, match="no driven muscle touches a wrapping surface"):
        untouched.freedom("PGA", person)
    assert untouched.freedom("PGA", person, "all").wraps.names == ("knee_front_l",)


def test_pga_adjusts_the_wrap(person, sampled, tmp_path):
    """The calibrated polynomials agree with OpenSim on the personalised model."""
    nga, pga = (calibrate(person, method, sampled, starts=1) for method in ("NGA", "PGA"))
    assert pga.status.converged
    assert pga.result.solution.cost < nga.result.solution.cost
    wraps = pga.result.freedom.wraps
    assert sampled.wraps.touched == ("knee_front_l",)
    assert wraps.names == ("knee_front_l",)
    changes = wraps.changes_of(np.asarray(pga.result.parameters.path_changes))[0]
    assert (np.abs(changes) > 1e-4 * np.asarray(wraps.upper[0])).any()
    file = person.folder / "moved.osim"
    write_personalised_model(person.model_file, file, {"knee_front_l": changes + NOMINAL}, {})
    columns = [person.trials.coordinates.index(name) for name in ("hip_flexion_l", "knee_angle_l")]
    poses = np.moveaxis(person.trials.angles[0, columns], 0, -1)
    judge = PathEngine(
        file, ("hip_flexion_l", "knee_angle_l"), {"recfem_l": ("hip_flexion_l", "knee_angle_l")}
    )
    length, _ = judge.analyse(poses)
    found = np.asarray(pga.result.states.path.length)[0, 0]
    assert np.sqrt(np.mean((found - length[:, 0]) ** 2)) < 3e-4
    # The stored polynomials are those for the calibrated wrap.
    pga.save(tmp_path / "run")
    assert_reproduces_itself(tmp_path / "run", person)


@pytest.mark.slow
def test_opensim_and_the_engine_give_the_same_fit(person, sampled):
    """For one cylinder their paths differ by micrometers."""
    judged = fit_wraps(person, fit(person, "opensim"), processes=1)
    by_opensim, by_engine = (one.wraps.quality["knee_front_l"] for one in (judged, sampled))
    assert by_opensim.physiological_share == pytest.approx(by_engine.physiological_share, abs=0.05)
    np.testing.assert_allclose(judged.wraps.inner.weights[0], sampled.wraps.inner.weights[0], atol=2e-3)
