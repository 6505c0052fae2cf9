"""Starts are reported as they ended, and what they leave open is said."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from wrapjax.calibration.solvers.interface import Status
from wrapjax.calibration.solvers.multistart import Outcome
from wrapjax.report.starts import (
    describe_starts,
    end_values,
    equally_good,
    findings,
    spread_figure,
    start_cost_figure,
    starts_csv,
    starts_section,
    undetermined_parameters,
)

# Of each variable: iliacus' EMG scale and fiber length, soleus' EMG scale and fiber length.
TAKEN = np.array([0.05, 0.06, 0.4, 0.07])


@pytest.fixture
def from_starts(result):
    """Make a calibration from starts that ended at given costs and values; the second is taken."""

    def make(*ends):
        first = result.solution
        outcomes = [
            Outcome(
                None if number == 0 else 10 + number,
                TAKEN,
                replace(first, cost=cost, variables=TAKEN + change, status=status),
            )
            for number, (cost, change, status) in enumerate(ends)
        ]
        return replace(result, outcomes=tuple(outcomes), chosen=1)

    return make


@pytest.fixture
def open_ended(from_starts):
    return from_starts(
        # As good, but soleus' EMG scale is 0.2 of 0.95 away, and its fiber length 0.003 of 0.04.
        (9.05, np.array([0.0, 0.0, 0.2, -0.003]), Status.gradient),
        (9.0, np.zeros(4), Status.gradient),
        # Poorer: where it ended says nothing.
        (12.0, np.array([0.9, 0.0, 0.0, 0.0]), Status.cost),
        # As low, but still on its way.
        (9.0, np.array([0.0, 0.08, 0.0, 0.0]), Status.iterations),
    )


def test_every_start_is_described(open_ended):
    described = describe_starts(open_ended)
    assert [entry["seed"] for entry in described] == [None, 11, 12, 13]
    assert [entry["cost"] for entry in described] == [9.05, 9.0, 12.0, 9.0]
    assert [entry["taken"] for entry in described] == [False, True, False, False]
    assert [entry["converged"] for entry in described] == [True, True, True, False]
    assert described[3]["message"] == Status.iterations.value
    assert {entry["iterations"] for entry in described} == {2}
    assert {entry["seconds"] for entry in described} == {0.5}


def test_the_table_holds_every_value_of_every_start(open_ended):
    rows = list(csv.DictReader(io.StringIO(starts_csv(open_ended))))
    assert len(rows) == 4 * 2 * 2
    for row in rows:
        start, muscle = int(row["start"]), open_ended.muscles.index(row["owner"])
        assert row["seed"] == ("" if start == 0 else str(10 + start))
        assert float(row["value"]) == end_values(open_ended)[row["parameter"]][start, muscle]
        assert row["unit"] == {"emg_scale": "1", "optimal_fiber_length": "m"}[row["parameter"]]
    (one,) = [
        row
        for row in rows
        if (row["start"], row["owner"], row["parameter"]) == ("0", "soleus_l", "emg_scale")
    ]
    assert float(one["value"]) == pytest.approx(0.6)


def test_only_ends_that_are_as_good_say_what_is_open(open_ended):
    assert equally_good(open_ended).tolist() == [True, True, False, False]
    assert undetermined_parameters(open_ended) == {"emg_scale": ["soleus_l"]}
    first, second = findings(open_ended)
    assert first.startswith("2 of 4 starts ended within 1 % of one cost, 9;")
    assert second.startswith("Of 4 muscle parameters 1 differs among these")
    page = starts_section(open_ended)
    assert page.count("<img") == 2
    assert "emg_scale</th><td" in page and "<td>soleus_l</td>" in page
    assert "1 (taken)" in page and "seed 13" in page


def test_starts_that_agree_are_said_to(from_starts):
    nothing = np.zeros(4)
    agreeing = from_starts(*[(9.0, nothing, Status.gradient)] * 2)
    assert findings(agreeing) == [
        "Both starts ended within 1 % of one cost, 9.",
        "These agree on every muscle parameter to within a tenth of the way between its bounds.",
    ]
    three = from_starts(*[(9.0, nothing, Status.gradient)] * 3)
    assert findings(three)[0].startswith("All 3 starts")


def test_a_start_that_is_lowest_alone_says_nothing_of_parameters(from_starts):
    lonely = from_starts((9.1, np.ones(4), Status.gradient), (9.0, np.zeros(4), Status.gradient))
    assert len(findings(lonely)) == 1 and findings(lonely)[0].startswith("None of the other starts")
    assert undetermined_parameters(lonely) == {}


def test_one_start_has_no_figure(result):
    page = starts_section(result)
    assert "<img" not in page and "ran from one start" in page


def test_figures_show_where_each_start_ended(open_ended):
    panel = start_cost_figure(open_ended).axes[0]
    drawn = [line.get_xydata().ravel().tolist() for line in panel.get_lines()]
    assert drawn == [[9.05, 0.0], [9.0, 1.0], [12.0, 2.0], [9.0, 3.0]]
    scale, length = spread_figure(open_ended).axes
    (taken,) = [line for line in scale.get_lines() if line.get_label() == "taken"]
    np.testing.assert_allclose(taken.get_xdata(), [0.0, 0.35 / 0.95])
    # Beside the gray guides, one stroke joins what is as good and far apart.
    strokes = [segment for one in scale.collections[1:] for segment in one.get_segments()]
    np.testing.assert_allclose(strokes, [[[0.35 / 0.95, 1.0], [0.55 / 0.95, 1.0]]])
    assert not [segment for one in length.collections[1:] for segment in one.get_segments()]


def test_a_run_whose_every_cost_is_unknown_is_reported(from_starts):
    unknown = from_starts(*[(float("nan"), np.zeros(4), Status.not_finite)] * 2)
    assert "None of the other starts" in starts_section(unknown)
