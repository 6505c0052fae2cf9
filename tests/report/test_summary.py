"""Tests of summary.json: the keys on which users' scripts rely, and the numbers."""

import json

import pytest

from tests.report.solutions import with_solution
from wrapjax.calibration.solvers.interface import Status
from wrapjax.io.files import write_json
from wrapjax.report.calibration.run_summary import file_stems, summarize

CONTRACT = {
    "schema", "subject", "method", "converged", "message", "iterations", "starts", "n_variables",
    "n_residuals", "seconds", "max_constraint_violation", "mae_Nm", "trials", "geometry_change", "at_bounds",
}  # fmt: skip


def test_summary_has_exactly_the_documented_keys(subject, result):
    summary = summarize(subject, result)
    ours = {"rmse_Nm", "before", "cost", "cost_by_term", "drive", "limits", "start_costs"}
    assert summary.keys() == CONTRACT | ours
    assert list(summary)[:1] == ["schema"]


def test_summary_of_the_solution(subject, result):
    summary = summarize(subject, result)
    known = {
        "schema": 1,
        "subject": "made_by_hand",
        "method": "NGA",
        "converged": True,
        "message": Status.gradient.value,
        "iterations": 2,
        "starts": 1,
        "n_variables": 4,
        "n_residuals": 20,
        "seconds": {"compile": 1.5, "solve": 0.5},
        "max_constraint_violation": 0.0,
        "geometry_change": {"length_mae_m": pytest.approx(0.006), "moment_arm_mae_m": pytest.approx(0.006)},
        "at_bounds": ["iliacus_l.emg_scale", "soleus_l.optimal_fiber_length"],
        "cost": 9.0,
    }
    assert {key: summary[key] for key in known} == known


def test_errors_agree_with_manual_calculation(subject, result):
    summary = summarize(subject, result)
    # Hip: (1 + 3) / 2. Ankle: (2 + 20 / 5) / 2.
    assert summary["mae_Nm"]["calibration"] == pytest.approx(
        {"hip_flexion_l": 2.0, "ankle_angle_l": 3.0, "mean": 2.5}
    )
    assert summary["mae_Nm"]["validation"] == pytest.approx(
        {"hip_flexion_l": 5.0, "ankle_angle_l": 7.0, "mean": 6.0}
    )
    # Squares are pooled over frames before the root: (1 + 9) / 2 and (4 + 400 / 5) / 2.
    hip, ankle = 5.0**0.5, 42.0**0.5
    assert summary["rmse_Nm"]["calibration"] == pytest.approx(
        {"hip_flexion_l": hip, "ankle_angle_l": ankle, "mean": (hip + ankle) / 2}
    )
    assert summary["before"]["mae_Nm"]["calibration"]["mean"] == pytest.approx(20.0)


def test_errors_by_trial(subject, result):
    trials = summarize(subject, result)["trials"]
    assert list(trials) == ["slow", "walk/02", "fast"]
    assert [trial["use"] for trial in trials.values()] == ["calibration", "calibration", "validation"]
    assert trials["walk/02"]["mae_Nm"] == pytest.approx(
        {"hip_flexion_l": 3.0, "ankle_angle_l": 4.0, "mean": 3.5}
    )
    assert trials["walk/02"]["rmse_Nm"]["ankle_angle_l"] == pytest.approx(80.0**0.5)
    assert trials["walk/02"]["file"] == "walk_02"


def test_validation_is_null_without_validation_cycles(subject, without_validation):
    summary = summarize(subject, without_validation)
    assert summary["mae_Nm"]["validation"] is None
    assert summary["rmse_Nm"]["validation"] is None
    assert summary["mae_Nm"]["calibration"]["hip_flexion_l"] == pytest.approx(3.0)


def test_a_solver_that_ran_out_of_iterations_has_not_converged(subject, result):
    stopped = with_solution(result, status=Status.iterations)
    summary = summarize(subject, stopped)
    assert summary["converged"] is False
    assert summary["message"] == Status.iterations.value


def test_json_is_strict_even_if_nothing_is_finite(subject, not_finite, tmp_path):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    write_json(tmp_path / "summary.json", summarize(subject, not_finite))
    read = json.loads((tmp_path / "summary.json").read_text(), parse_constant=refuse)
    assert read["mae_Nm"]["calibration"]["mean"] is None
    assert read["converged"] is False


def test_file_stems_are_unique():
    assert file_stems(["walk", "walk/01"]) == {"walk": "walk", "walk/01": "walk_01"}
    stems = file_stems(["walk_01", "walk/01", "Walk/01", "walk_01-2"])
    assert len({stem.lower() for stem in stems.values()}) == 4
    assert stems["walk_01"] == "walk_01"
