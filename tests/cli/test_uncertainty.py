"""``wrapjax calibrate --uncertainty``: uncertainty is stored in the run's folder only if requested."""

import csv

import numpy as np
import pytest

from tests.cli.folders import METHOD, content, read_json
from tests.cli.test_check import assert_only_errors
from wrapjax.report.calibration.spread import SCHEMA


@pytest.fixture(scope="module")
def with_uncertainty(run, subject, fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    words = ("--uncertainty", "bootstrap", "--draws", "4", "--fit", fitted[1], "--out", folder)
    return run("calibrate", subject, *METHOD, *words), folder


def test_bootstrap_writes_intervals_of_all_parameters(with_uncertainty, calibrated):
    outcome, folder = with_uncertainty
    assert outcome.status == 0 and "calibrating simulated moments: 4 done" in outcome.progress
    assert "4 draws (bootstrap" in outcome.output
    told = read_json(folder / "uncertainty.json")
    assert told["schema"] == SCHEMA and told["way"] == "bootstrap" and told["draws"] == 4
    assert read_json(folder / "summary.json")["uncertainty"]["converged_draws"] == 4
    with (folder / "parameters.csv").open(newline="") as stream:
        rows = {f"{row['owner']}.{row['parameter']}": row for row in csv.DictReader(stream)}
    for label, own in told["by_parameter"].items():
        assert float(rows[label]["sd"]) == own["sd"] and own["low_90"] <= own["high_90"]
        assert float(rows[label]["value"]) == pytest.approx(own["value"], rel=1e-12)
        assert float(rows[label]["lower"]) * (1 - 1e-9) <= own["low_90"]
        assert own["high_90"] <= float(rows[label]["upper"]) * (1 + 1e-9)
    # The calibration does not depend on --uncertainty.
    plain = calibrated[1]
    assert read_json(folder / "summary.json")["cost"] == pytest.approx(
        read_json(plain / "summary.json")["cost"], rel=1e-9
    )
    assert not (plain / "uncertainty.json").exists() and not (plain / "moment_bands").exists()
    assert not list(folder.parent.glob(".*"))


def test_interrupted_bootstrap_is_resumed(run, subject, fitted, with_uncertainty, tmp_path, monkeypatch):
    """Finished draws are kept, and the others are the same as without an interruption."""
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.solvers.interface import Status

    solve, solved = AugmentedLagrangian.solve, []

    def stopped(self, problem, start, *arguments):
        solution = solve(self, problem, start, *arguments)
        solved.append(not arguments)  # the calibration itself is watched
        if sum(solved) == 3:
            object.__setattr__(solution, "status", Status.interrupted)
        return solution

    words = ("--uncertainty", "bootstrap", "--draws", "4", "--fit", fitted[1], "--out", tmp_path / "run")
    monkeypatch.setattr(AugmentedLagrangian, "solve", stopped)
    outcome = run("calibrate", subject, *METHOD, *words, "--quiet")
    assert outcome.status == 1 and "--resume" in outcome.progress and not (tmp_path / "run").exists()
    done = sum(solved)
    solved[:] = [False] * len(solved)
    monkeypatch.setattr(AugmentedLagrangian, "solve", solve)
    outcome = run("calibrate", subject, *METHOD, *words, "--quiet", "--resume")
    assert outcome.status == 0 and done == 3
    again, before = (
        read_json(folder / "uncertainty.json") for folder in (tmp_path / "run", with_uncertainty[1])
    )
    for label, own in before["by_parameter"].items():
        np.testing.assert_allclose(again["by_parameter"][label]["sd"], own["sd"], rtol=1e-6, atol=1e-12)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--draws", "5"), "is for --uncertainty bootstrap"),
        (("--uncertainty", "laplace", "--draws", "5"), "is for --uncertainty bootstrap"),
        (("--uncertainty", "bootstrap", "--draws", "1"), "expected at least 2"),
    ],
)
def test_invalid_draws_are_refused_before_the_calibration(run, subject, tmp_path, words, said):
    outcome = run("calibrate", subject, *METHOD, "--out", tmp_path / "run", *words)
    (line,) = assert_only_errors(outcome, "--draws")
    assert said in line
    assert content(tmp_path) == {}
