"""Tests of a comparison: numbers computed by hand, the unit of analysis, tables and the page."""

import csv
import io
import json
import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from tests.report.page import Page
from tests.report.solutions import with_solution
from wrapjax.calibration.solvers.interface import Status
from wrapjax.comparison.samples import ComparedLeg, group_by_speed
from wrapjax.comparison.statistics import MINIMUM_UNITS
from wrapjax.io.files import write_json
from wrapjax.report.comparison.figures import methods_that_move, most_moved
from wrapjax.report.comparison.page import render_comparison
from wrapjax.report.comparison.summary import comparison_rows, describe_comparison
from wrapjax.report.comparison.tables import cycles_csv, differences_csv, means_csv
from wrapjax.report.formatting import p_value

METHODS = ("NGA", "SGA", "LSGA")
#: Factor of the synthetic errors of each method.
FACTORS = {"NGA": 1.0, "SGA": 0.5, "LSGA": 0.75}
#: Change of lengths and moment arms by each method, m.
SHIFTS = {"NGA": 0.0, "SGA": 0.004, "LSGA": 0.006}


def moved(states, shift):
    """Increase lengths and nonzero moment arms by ``shift``, in the second cycle by twice that."""
    by_cycle = shift * jnp.array([1.0, 2.0, 1.0])
    path = states.path
    arm = jnp.where(path.moment_arm != 0.0, path.moment_arm + by_cycle[None, :, None, None], 0.0)
    return replace(states, path=replace(path, length=path.length + by_cycle[None, :, None], moment_arm=arm))


@pytest.fixture
def make_leg(subject, result):
    def make(label="left leg", scale=1.0, **changes):
        """Make a leg with ``scale`` times the synthetic errors, times the factor of each method."""
        before = replace(result, initial_states=result.states, **changes)
        results = {
            method: replace(
                before,
                method=method,
                modelled=before.measured + scale * factor * (result.modelled - result.measured),
                states=moved(before.initial_states, SHIFTS[method]),
            )
            for method, factor in FACTORS.items()
        }
        return ComparedLeg(label, subject, results, {method: f"{label}/{method}" for method in METHODS})

    return make


@pytest.fixture
def one(make_leg):
    return [make_leg()]


@pytest.fixture
def four(make_leg):
    return [make_leg(f"leg {number}", scale) for number, scale in enumerate((1.0, 1.2, 2.0, 0.7))]


def find(rows, quantity, item, use="all", speed="all speeds"):
    (row,) = [
        row for row in rows if (row.quantity, row.item, row.use, row.speed) == (quantity, item, use, speed)
    ]
    return row


def test_moment_errors_by_hand(one):
    """Calibration cycles have errors of 1 and 3 N m at the hip, 2 and 4 at the ankle, the other 5 and 7."""
    rows = comparison_rows(one, METHODS)
    hip = find(rows, "moment_error", "hip_flexion", "calibration")
    assert hip.unit_of_analysis == "cycle" and hip.n == 2
    assert hip.spreads["NGA"].mean == pytest.approx(2.0)
    assert hip.spreads["NGA"].sd == pytest.approx(math.sqrt(2.0))
    assert hip.spreads["SGA"].mean == pytest.approx(1.0)
    average = find(rows, "moment_error", "mean", "calibration")
    assert average.spreads["NGA"].mean == pytest.approx(2.5)
    held_out = find(rows, "moment_error", "ankle_angle", "validation")
    assert held_out.n == 1 and held_out.spreads["LSGA"].mean == pytest.approx(0.75 * 7.0)
    assert math.isnan(held_out.spreads["LSGA"].sd)


def test_geometry_by_hand(one):
    """Cycles change by 1, 2 and 1 times the shift; each muscle spans one coordinate."""
    rows = comparison_rows(one, METHODS)
    for quantity in ("length_change", "moment_arm_change"):
        for item in ("hip_flexion", "ankle_angle", "mean"):
            row = find(rows, quantity, item)
            assert row.n == 3
            assert row.spreads["SGA"].mean == pytest.approx(0.004 * 4.0 / 3.0), (quantity, item)
            assert row.spreads["NGA"].mean == 0.0
            # A method that does not change paths is excluded from the tests.
            assert list(row.paired) == [("LSGA", "SGA")]


def test_paired_tests_are_of_the_same_cycles(one):
    row = find(comparison_rows(one, METHODS), "moment_arm_change", "ankle_angle")
    shifts = np.array([1.0, 2.0, 1.0])
    expected = stats.ttest_rel(SHIFTS["LSGA"] * shifts, SHIFTS["SGA"] * shifts)
    test = row.paired["LSGA", "SGA"]
    assert (test.t, test.p) == pytest.approx((expected.statistic, expected.pvalue))
    assert test.difference == pytest.approx(0.002 * 4.0 / 3.0)


def test_unit_of_analysis_is_the_leg_from_three_legs_on(four):
    for count in range(1, 5):
        rows = comparison_rows(four[:count], METHODS)
        expected = "leg" if count >= MINIMUM_UNITS else "cycle"
        hip = find(rows, "moment_error", "hip_flexion", "calibration")
        assert (hip.unit_of_analysis, hip.n) == (expected, count if expected == "leg" else 2 * count)
        parameter = find(rows, "parameter", "emg_scale")
        within = ("leg", count) if expected == "leg" else ("muscle", 2 * count)
        assert (parameter.unit_of_analysis, parameter.n) == within


def test_legs_are_tested_by_their_averages(four):
    row = find(comparison_rows(four, METHODS), "moment_error", "hip_flexion", "calibration")
    nga = 2.0 * np.array([1.0, 1.2, 2.0, 0.7])
    assert row.spreads["NGA"].mean == pytest.approx(nga.mean())
    assert row.spreads["NGA"].sd == pytest.approx(nga.std(ddof=1))
    expected = stats.ttest_rel(0.5 * nga, nga)
    assert row.paired["SGA", "NGA"].p == pytest.approx(expected.pvalue)
    assert row.variance.p == pytest.approx(stats.f_oneway(nga, 0.5 * nga, 0.75 * nga).pvalue)
    tukey = stats.tukey_hsd(nga, 0.5 * nga, 0.75 * nga)
    assert row.tukey["LSGA", "SGA"].p == pytest.approx(tukey.pvalue[2, 1])
    # Each against the first only.
    assert list(row.paired) == [("SGA", "NGA"), ("LSGA", "NGA")]


def test_holm_counts_coordinates_but_not_their_mean(four):
    rows = comparison_rows(four, METHODS)
    pair = ("SGA", "NGA")
    own = {item: find(rows, "moment_error", item, "calibration") for item in ("hip_flexion", "ankle_angle")}
    smaller, larger = sorted(row.paired[pair].p for row in own.values())
    assert sorted(row.p_holm[pair] for row in own.values()) == pytest.approx(
        sorted([2.0 * smaller, max(larger, 2.0 * smaller)])
    )
    assert find(rows, "moment_error", "mean", "calibration").p_holm == {}


class TestSpeeds:
    def test_speeds_are_separate_if_a_use_has_several(self, make_leg):
        legs = [make_leg(speeds=np.array([0.5, 0.8, 0.8]))]
        kinds = group_by_speed(legs, "calibration")
        assert [(kind.label, kind.count) for kind in kinds] == [
            ("0.5 m/s", 1),
            ("0.8 m/s", 1),
            ("all speeds", 2),
        ]
        assert [kind.label for kind in group_by_speed(legs, "validation")] == ["all speeds"]

    def test_missing_speeds_are_pooled(self, make_leg):
        legs = [make_leg(speeds=np.array([0.5, math.nan, math.nan]))]
        labels = [kind.label for kind in group_by_speed(legs, "calibration")]
        assert labels == ["0.5 m/s", "speed not given", "all speeds"]

    def test_speeds_are_ranked_if_they_differ_between_legs(self, make_leg):
        legs = [make_leg(speeds=np.array([0.5, 0.8, 0.8])), make_leg(speeds=np.array([1.2, 0.9, 0.9]))]
        slow, fast, _ = group_by_speed(legs, "calibration")
        assert (slow.label, fast.label) == ("speed 1 of 2", "speed 2 of 2")
        assert [own.tolist() for own in slow.keep] == [[True, False, False], [False, True, False]]

    def test_speeds_are_pooled_if_they_cannot_be_ranked(self, make_leg):
        legs = [make_leg(), make_leg(speeds=np.array([0.5, 0.5, 0.5]))]
        assert [kind.label for kind in group_by_speed(legs, "calibration")] == ["all speeds"]


def test_legs_need_not_have_the_same_joints(make_leg):
    """The right leg's hip is the same joint; a knee that only one leg has is counted once."""
    other = make_leg(
        "right leg", coordinates=("hip_flexion_r", "knee_angle_r"), muscles=("iliacus_r", "vasmed_r")
    )
    rows = comparison_rows([make_leg(), other], METHODS)
    counts = {row.item: row.n for row in rows if row.quantity == "moment_error" and row.use == "calibration"}
    assert counts == {"hip_flexion": 4, "ankle_angle": 2, "knee_angle": 2, "mean": 4}
    assert list(counts)[-1] == "mean"
    assert find(rows, "muscle_force", "vasmed").n == 3
    assert Page(render_comparison([make_leg(), other], METHODS, rows))


def test_json_is_strict_and_null_where_there_is_too_little(one, tmp_path):
    content = describe_comparison(one, METHODS, comparison_rows(one, METHODS))
    write_json(tmp_path / "comparison.json", content)
    stored = json.loads((tmp_path / "comparison.json").read_text())
    assert stored["schema"] == 1 and stored["unit_of_analysis"] == "cycle"
    assert "descriptive" in stored["note"] and stored["reference"] == "NGA"
    for row in stored["quantities"]["moment_error"]:
        # Two cycles, or one: means, but no test.
        assert row["n"] < 3 and row["methods"]["SGA"]["mean"] > 0.0
        assert row["anova"] is row["repeated_measures_anova"] is None
        for test in [*row["tukey_kramer"], *row["paired_t"]]:
            names = test.keys() - {"method", "against"}
            assert {"difference", "low", "high", "p"} <= names and {test[name] for name in names} == {None}
    # Parameters are the same by every method: the difference is 0, and no test is defined.
    (scale,) = [row for row in stored["quantities"]["parameter"] if row["item"] == "emg_scale"]
    assert scale["unit_of_analysis"] == "muscle"
    assert stored["legs"][0]["runs"]["LSGA"]["folder"] == "left leg/LSGA"


def test_not_finite_is_null(one, four, not_finite, tmp_path):
    """A method that could not even start has no numbers, and spoils nobody else's."""
    for legs in (one, four):
        failed = {"SGA": replace(not_finite, initial_states=not_finite.states)}
        legs = [replace(leg, results=leg.results | failed) for leg in legs]
        rows = comparison_rows(legs, METHODS)
        write_json(tmp_path / "comparison.json", describe_comparison(legs, METHODS, rows))
        row = find(rows, "moment_error", "hip_flexion", "calibration")
        assert math.isnan(row.spreads["SGA"].mean) and row.spreads["LSGA"].mean > 0.0
        text = Page(render_comparison(legs, METHODS, rows)).text
        assert "did not converge: " in text and "by SGA" in text


def test_tables(four):
    rows = comparison_rows(four, METHODS)
    means = list(csv.DictReader(io.StringIO(means_csv(rows))))
    tests = list(csv.DictReader(io.StringIO(differences_csv(rows))))
    cycles = list(csv.DictReader(io.StringIO(cycles_csv(four, METHODS))))
    assert len(means) == 3 * len(rows)
    assert {row["test"] for row in tests} == {"anova", "repeated_measures_anova", "tukey_kramer", "paired_t"}
    assert len(cycles) == 4 * 3 * 3 * 3  # legs, trials, methods, coordinates and their mean
    hip = find(rows, "moment_error", "hip_flexion", "calibration")
    (line,) = [
        row
        for row in tests
        if (row["test"], row["method"], row["item"], row["use"], row["quantity"])
        == ("paired_t", "SGA", "hip_flexion", "calibration", "moment_error")
    ]
    # All digits, so that nothing is lost on the way.
    assert (
        float(line["p"]) == hip.paired["SGA", "NGA"].p and float(line["d_z"]) == hip.paired["SGA", "NGA"].d_z
    )
    # The tests can be done again from the table of cycles.
    values = {
        method: [
            float(
                np.mean(
                    [
                        float(row["mae_Nm"])
                        for row in cycles
                        if (row["leg"], row["method"], row["coordinate"], row["use"])
                        == (leg.label, method, "hip_flexion", "calibration")
                    ]
                )
            )
            for leg in four
        ]
        for method in METHODS
    }
    assert stats.ttest_rel(values["SGA"], values["NGA"]).pvalue == pytest.approx(float(line["p"]))
    assert "nan" not in means_csv(rows) + differences_csv(rows)


class TestPage:
    def test_page_is_valid_and_self_contained(self, one, four):
        for legs in (one, four):
            text = render_comparison(legs, METHODS, comparison_rows(legs, METHODS))
            page = Page(text)
            assert not page.all("script") + page.all("link")
            assert "http://" not in text and "https://" not in text
            assert len(page.all("img")) == len(page.all("figcaption")) == 2
            assert all(len(image["alt"]) > 40 for image in page.all("img"))

    def test_page_states_the_unit_of_analysis(self, one, four):
        first, second = (
            Page(render_comparison(legs, METHODS, comparison_rows(legs, METHODS))).text
            for legs in (one, four)
        )
        assert "descriptive" in first and "Unit of analysis: cycle" in first
        assert "descriptive" not in second and "Unit of analysis: leg (n = 4)" in second

    def test_significant_differences_are_marked(self, four):
        text = Page(render_comparison(four, METHODS, comparison_rows(four, METHODS))).text
        assert "* 1.23 ± 0.56" in text  # SGA at the hip: half of 2.45 ± 1.11
        assert "2.45 ± 1.11" in text and "* 2.45" not in text

    def test_no_tables_of_tests_for_too_few_observations(self, one):
        text = Page(render_comparison(one, METHODS, comparison_rows(one, METHODS))).text
        assert "Too few cycles for tests" in text and "Greenhouse" not in text

    def test_calibrations_that_did_not_converge_are_named(self, one):
        failed = with_solution(one[0].results["LSGA"], status=Status.iterations)
        legs = [replace(one[0], results=one[0].results | {"LSGA": failed})]
        text = Page(render_comparison(legs, METHODS, comparison_rows(legs, METHODS))).text
        assert "1 of 3 calibrations did not converge: left leg by LSGA." in text

    def test_page_if_no_method_changes_paths(self, one):
        held = {method: one[0].results["NGA"] for method in METHODS}
        legs = [replace(one[0], results=held)]
        assert methods_that_move(legs, METHODS) == [] == most_moved(legs, METHODS)
        text = Page(render_comparison(legs, METHODS, comparison_rows(legs, METHODS))).text
        assert "No method changed a muscle path." in text


def test_moment_arms_are_ordered_by_their_change(one, result):
    assert methods_that_move(one, METHODS) == ["SGA", "LSGA"]
    assert sorted(most_moved(one, METHODS)) == [("iliacus", "hip_flexion"), ("soleus", "ankle_angle")]
    path = one[0].results["LSGA"].states.path
    further = replace(path, moment_arm=path.moment_arm.at[1, :, 1].add(0.01))
    states = replace(one[0].results["LSGA"].states, path=further)
    results = one[0].results | {"LSGA": replace(one[0].results["LSGA"], states=states)}
    assert most_moved([replace(one[0], results=results)], METHODS)[0] == ("soleus", "ankle_angle")


def test_p_values_in_words():
    assert [p_value(p) for p in (0.2, 0.0494, 0.0004, math.nan)] == [
        "0.200",
        "0.049",
        "< 0.001",
        "\N{EN DASH}",
    ]
