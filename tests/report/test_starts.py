"""Tests of the report on starts: their results, agreement, and undetermined parameters."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.report.calibration.starts import (
    describe_starts,
    end_values,
    equally_good,
    spread_figure,
    start_cost_figure,
    start_findings,
    starts_csv,
    starts_section,
    undetermined_parameters,
)

# Variables of the selected start: EMG scale and fiber length of iliacus, then of soleus.
SELECTED = np.array([0.05, 0.06, 0.4, 0.07])


@pytest.fixture
def from_starts(result):
    """Make a calibration from starts with given final costs and values; the second start is selected."""

    def make(*ends):
        first = result.solution
        outcomes = [
            Outcome(
                None if number == 0 else 10 + number,
                SELECTED,
                replace(first, cost=cost, variables=SELECTED + change, status=status),
            )
            for number, (cost, change, status) in enumerate(ends)
        ]
        return replace(result, outcomes=tuple(outcomes), chosen=1)

    return make


@pytest.fixture
def ambiguous(from_starts):
    return from_starts(
        # Equal cost, but for soleus EMG scale differs by 0.2 of 0.95 and fiber length by 0.003 of 0.04.
        (9.05, np.array([0.0, 0.0, 0.2, -0.003]), Status.gradient),
        (9.0, np.zeros(4), Status.gradient),
        # Higher cost, so its values are not considered.
        (12.0, np.array([0.9, 0.0, 0.0, 0.0]), Status.cost),
        # Equal cost, but not converged.
        (9.0, np.array([0.0, 0.08, 0.0, 0.0]), Status.iterations),
    )


def test_every_start_is_described(ambiguous):
    described = describe_starts(ambiguous)
    assert [entry["seed"] for entry in described] == [None, 11, 12, 13]
    assert [entry["cost"] for entry in described] == [9.05, 9.0, 12.0, 9.0]
    assert [entry["taken"] for entry in described] == [False, True, False, False]
    assert [entry["converged"] for entry in described] == [True, True, True, False]
    assert described[3]["message"] == Status.iterations.value
    assert {entry["iterations"] for entry in described} == {2}
    assert {entry["seconds"] for entry in described} == {0.5}


def test_the_table_holds_every_value_of_every_start(ambiguous):
    rows = list(csv.DictReader(io.StringIO(starts_csv(ambiguous))))
    assert len(rows) == 4 * 2 * 2
    for row in rows:
        start, muscle = int(row["start"]), ambiguous.muscles.index(row["owner"])
        assert row["seed"] == ("" if start == 0 else str(10 + start))
        assert float(row["value"]) == end_values(ambiguous)[row["parameter"]][start, muscle]
        assert row["unit"] == {"emg_scale": "1", "optimal_fiber_length": "m"}[row["parameter"]]
    (one,) = [
        row
        for row in rows
        if (row["start"], row["owner"], row["parameter"]) == ("0", "soleus_l", "emg_scale")
    ]
    assert float(one["value"]) == pytest.approx(0.6)


def test_undetermined_parameters_are_found_from_equally_good_starts(ambiguous):
    assert equally_good(ambiguous).tolist() == [True, True, False, False]
    assert undetermined_parameters(ambiguous) == {"emg_scale": ["soleus_l"]}
    first, second = start_findings(ambiguous)
    assert first.startswith("2 of 4 starts ended within 1 % of the same cost, 9;")
    assert second.startswith("1 of 4 muscle parameters differs among these starts")
    page = starts_section(ambiguous)
    assert page.count("<img") == 2
    assert "emg_scale</th><td" in page and "<td>soleus_l</td>" in page
    assert "1 (selected)" in page and "seed 13" in page


def test_findings_of_starts_that_agree(from_starts):
    nothing = np.zeros(4)
    agreeing = from_starts(*[(9.0, nothing, Status.gradient)] * 2)
    assert start_findings(agreeing) == [
        "Both starts ended within 1 % of the same cost, 9.",
        "These starts agree on every muscle parameter to within a tenth of the range between its bounds.",
    ]
    three = from_starts(*[(9.0, nothing, Status.gradient)] * 3)
    assert start_findings(three)[0].startswith("All 3 starts")


def test_findings_of_a_single_best_start(from_starts):
    result = from_starts((9.1, np.ones(4), Status.gradient), (9.0, np.zeros(4), Status.gradient))
    (finding,) = start_findings(result)
    assert finding.startswith("No other start ended")
    assert undetermined_parameters(result) == {}


def test_one_start_has_no_figure(result):
    page = starts_section(result)
    assert "<img" not in page and "ran from one start" in page


def test_figures_show_the_result_of_each_start(ambiguous):
    panel = start_cost_figure(ambiguous).axes[0]
    drawn = [line.get_xydata().ravel().tolist() for line in panel.get_lines()]
    assert drawn == [[9.05, 0.0], [9.0, 1.0], [12.0, 2.0], [9.0, 3.0]]
    scale, length = spread_figure(ambiguous).axes
    (selected,) = [line for line in scale.get_lines() if line.get_label() == "selected"]
    np.testing.assert_allclose(selected.get_xdata(), [0.0, 0.35 / 0.95])
    # Besides the gray lines, one red line joins equally good starts that differ widely.
    strokes = [segment for one in scale.collections[1:] for segment in one.get_segments()]
    np.testing.assert_allclose(strokes, [[[0.35 / 0.95, 1.0], [0.55 / 0.95, 1.0]]])
    assert not [segment for one in length.collections[1:] for segment in one.get_segments()]


def test_section_if_no_cost_is_finite(from_starts):
    unknown = from_starts(*[(float("nan"), np.zeros(4), Status.not_finite)] * 2)
    assert "No other start ended" in starts_section(unknown)
