"""Tests of changed muscle paths: coefficients in the files, and the report section."""

import csv
import json
import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from tests.subject.synthetic import write_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.cli.calibrate import calibration_table
from wrapjax.model.freedom import FreedPaths
from wrapjax.path_sources.path_fitting import fit
from wrapjax.report.calibration.starts import moment_arm_spread, start_findings
from wrapjax.report.paths.path_views import largest_changes, moment_arm_figure, path_section
from wrapjax.subject.subject import load_subject as load_subject


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Calibration of two muscles with free paths from two starts."""
    subject = load_subject(write_subject(tmp_path_factory.mktemp("subjects") / "person"))
    solver = AugmentedLagrangian(inner=ProjectedLevenbergMarquardt(max_iterations=100))
    return calibrate(subject, "SGA", fit(subject), solver=solver, starts=2)


@pytest.fixture(scope="module")
def run(done, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    done.save(folder)
    return folder


def test_evaluating_a_run_on_its_own_subject_gives_its_moments(run, done):
    """An evaluation reads the coefficients that the run wrote."""
    assert_reproduces_itself(run, done.subject)


def _terms(run):
    """Read coefficients by muscle and term from parameters.csv."""
    terms = {}
    with (run / "parameters.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            if row["kind"] == "term":
                assert (row["unit"], row["lower"], row["upper"]) == ("m", "", "")
                terms.setdefault(row["owner"], {})[row["parameter"]] = float(row["value"])
    return terms


def test_lengths_can_be_computed_from_the_files(done, run):
    result, trials = done.result, done.subject.trials
    scaling = json.loads((run / "settings.json").read_text())["freed_paths"]["scaling"]
    scaled = {
        name: (trials.angles[:, trials.coordinates.index(name)] - own["center"]) / own["half_range"]
        for name, own in scaling.items()
    }

    def term(name):
        factors = [factor.partition("^") for factor in name.split("*") if name != "1"]
        product = np.ones(trials.time.shape)
        for coordinate, _, power in factors:
            product = product * scaled[coordinate] ** int(power or 1)
        return product

    for muscle, coefficients in _terms(run).items():
        length = sum(value * term(name) for name, value in coefficients.items())
        row = result.muscles.index(muscle)
        np.testing.assert_allclose(length, result.states.path.length[row], rtol=1e-12)
        assert np.abs(length - result.initial_states.path.length[row]).max() > 1e-5


def test_only_freed_paths_have_terms_in_the_files(done, run, tmp_path):
    assert set(_terms(run)) == set(done.result.muscles)
    free = done.result.freedom.paths.free & np.array([[False], [True]])
    freedom = replace(done.result.freedom, paths=FreedPaths(free, 15.0))
    replace(done, result=replace(done.result, freedom=freedom)).save(tmp_path / "one")
    assert set(_terms(tmp_path / "one")) == {done.result.muscles[1]}
    freed = json.loads((tmp_path / "one" / "settings.json").read_text())["freed_paths"]
    assert freed["modes"] == {done.result.muscles[1]: int(free.sum())} and freed["prior_sd"] == 15.0


def test_settings_contain_the_solver_and_valid_paths(done, run):
    settings = json.loads((run / "settings.json").read_text())
    assert settings["solver"]["class"] == "AugmentedLagrangian"
    assert settings["solver"]["inner"]["class"] == "ProjectedLevenbergMarquardt"
    assert settings["solver"]["inner"]["max_iterations"] == 100
    assert settings["starts"] == [None, 1]
    assert not settings["subject"]["folder"].startswith("/")
    assert (run / settings["subject"]["folder"]).resolve() == done.subject.folder.resolve()
    assert (run / settings["subject"]["model_file"]).resolve() == done.subject.model_file.resolve()


def test_largest_changes_come_first(done):
    result = done.result
    before, after = (np.asarray(states.path.moment_arm) for states in (result.initial_states, result.states))
    change = np.abs(after - before).mean(axis=(1, 3))
    places = largest_changes(result)
    found = [change[place] for place in places]
    assert found == sorted(found, reverse=True) and found[0] == change.max() > 0.0
    figure = moment_arm_figure(result)
    assert len(figure.axes) == len(places)
    muscle, coordinate = places[0]
    for label, arms in (("nominal", before), ("calibrated", after)):
        (line,) = [line for line in figure.axes[0].get_lines() if line.get_label() == label]
        np.testing.assert_allclose(line.get_ydata(), 1e3 * arms[muscle, :, coordinate].mean(axis=0))


def test_section_contains_changes_by_muscle(done):
    result = done.result
    page = path_section(result)
    change = 1e3 * np.abs(np.asarray(result.states.path.length - result.initial_states.path.length))
    for row, muscle in enumerate(result.muscles):
        (cells,) = re.findall(
            rf'{muscle}</th><td class="number">(.*?)</td><td class="number">(.*?)</td>', page
        )
        assert cells == (f"{change[row].mean():.1f}", f"{change[row].max():.1f}")
    assert "The paths of 2 of 2 muscles were free to change." in page
    assert path_section(replace(result, freedom=result.freedom.with_held_paths())) == ""
    unchanged = path_section(replace(result, states=result.initial_states))
    assert "none changed" in unchanged and "<img" not in unchanged


def test_starts_are_compared_by_their_moment_arms(done):
    taken = done.result.outcomes[done.result.chosen]
    alike = replace(done.result, outcomes=(taken, taken), chosen=0)
    assert moment_arm_spread(alike) == 0.0
    assert start_findings(alike)[-1] == "Their moment arms differ by at most 0.1 mm."
    of_paths = np.array(["path" in label for label in done.result.labels])
    nominal = replace(taken.solution, variables=np.where(of_paths, 0.0, taken.solution.variables))
    apart = replace(alike, outcomes=(taken, replace(taken, solution=nominal)))
    matched = np.array([use == "calibration" for use in done.result.uses])
    before, after = (
        np.asarray(states.path.moment_arm)[:, matched]
        for states in (done.result.initial_states, done.result.states)
    )
    assert moment_arm_spread(apart) == pytest.approx(np.abs(after - before).max())


def test_terminal_output_contains_starts_limits_and_paths(done):
    lines = calibration_table(done).splitlines()
    assert re.match(r"2 starts in .* within 1 % of the chosen one, start \d$", lines[1])
    assert re.match(r"\d+ iterations, cost .* variables at a bound$", lines[2])
    assert re.match(
        r"hard limits: largest violation \S+ \(allowed 1e-06\); \d+ values of \d muscles", lines[3]
    )
    length, arm = re.match(
        r"paths of 2 muscles free: .* lengths changed by (\S+) mm, moment arms by (\S+) mm$", lines[4]
    ).groups()
    states, initial = done.result.states.path, done.result.initial_states.path
    change = jax.tree.map(lambda after, before: 1e3 * np.abs(after - before).mean(), states, initial)
    assert float(length) == pytest.approx(change.length, abs=0.006)
    assert float(arm) >= 0.0
    held = replace(done, result=replace(done.result, freedom=done.result.freedom.with_held_paths()))
    assert "paths of" not in calibration_table(held)
