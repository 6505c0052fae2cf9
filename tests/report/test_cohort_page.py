"""Tests of the page of a cohort with completed, failed and waiting subjects."""

import re
from pathlib import Path

import pytest

from wrapjax.cohorts.cohort import Cohort
from wrapjax.errors import InputError
from wrapjax.report.cohort_page import describe_cohort, render_cohort


def member(side, error, **diagnosis):
    errors = {f"knee_angle_{side}": error, "mean": error}
    gap = {"outcome": "none", "named": [], "ties": []} | diagnosis
    return {
        "state": "done",
        "converged": True,
        "mae_Nm": {"calibration": errors, "validation": None},
        "rmse_Nm": {"calibration": errors, "validation": None},
        "diagnosis": gap,
        "report": "x/calibration/report.html",
        "diagnosis_report": "x/diagnosis/report.html",
    }


@pytest.fixture
def subjects():
    tie = [["cop_offset", "hip_center_offset"]]
    return {
        "a": member("l", 1.0, outcome="named", named=["cop_offset"]),
        "b": member("r", 2.0, outcome="tie", ties=tie),
        "c": member("r", 6.0, outcome="tie", ties=tie),
        "d": {"state": "failed", "message": "d/model.osim: <does not> exist."},
        "e": {"state": "waiting"},
    }


def test_dataset(subjects):
    done = Cohort(Path(), {"subjects": subjects}).to_dataset()["mean_absolute_error"]
    assert done.sel(subject="b", use="calibration", coordinate="knee_angle_r") == 2.0
    assert done.sel(subject="b", coordinate="knee_angle_l").isnull().all()
    assert "mean" not in done["coordinate"] and done.sel(use="validation").isnull().all()
    with pytest.raises(InputError, match="no subject is done"):
        Cohort(Path(), {"subjects": {"e": subjects["e"]}}).to_dataset()


def test_counts(subjects):
    population = describe_cohort("NGA", True, subjects)["population"]
    assert [population[key] for key in ("n", "converged", "failed", "waiting")] == [3, 3, 1, 1]
    assert population["outcomes"] == {"tie": 2, "named": 1}
    assert population["named"] == {"cop_offset": 1}
    assert population["tied"] == {"cop_offset": 2, "hip_center_offset": 2}
    knee = population["mae_Nm"]["calibration"]["knee_angle"]
    assert (knee["n"], knee["mean"], knee["median"], knee["max"]) == (3, 3.0, 2.0, 6.0)
    assert knee["sd"] == pytest.approx(7.0**0.5)
    assert population["mae_Nm"]["validation"] == {}


def test_page(subjects):
    page = render_cohort(describe_cohort("NGA", True, subjects))
    assert "3 of 5 subjects completed" in page
    assert "Not yet processed when this page was written: 1." in page
    assert "d/model.osim: &lt;does not&gt; exist." in page
    assert page.count("<img") == 2
    text = re.sub(r"<[^>]*>", " ", page)
    assert re.search(r"cop offset\s+1\s+2\s+hip center offset\s+0\s+2", text)


def test_cohort_without_completed_subjects(subjects):
    page = render_cohort(describe_cohort("PGA", False, {"d": subjects["d"], "e": subjects["e"]}))
    assert "0 of 2 subjects completed" in page and "<img" not in page
