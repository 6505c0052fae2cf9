"""Tests of uncertainty in files and report: only if requested, and in the parameters' units."""

import csv
import json

import numpy as np
import pytest

from wrapjax.calibration.uncertainty.intervals import LegSpread, Spread
from wrapjax.io.storage import read_storage
from wrapjax.report.calibration.run_page import render_report, write_run
from wrapjax.report.calibration.spread import band_figure, interval_figure, kinds_of
from wrapjax.report.labelled.arrays import spread_dataset
from wrapjax.report.style import to_svg


@pytest.fixture
def spread(result) -> LegSpread:
    """Uncertainty of four parameters: two at bounds, and one not identified."""
    own = Spread(
        labels=result.labels,
        units=("1", "m", "1", "m"),
        value=np.array([0.05, 0.11, 1.0 / 3.0, 0.07]),
        deviation=np.array([0.01, 0.002, 0.25, 0.001]),
        low=np.array([0.05, 0.107, 0.1, 0.068]),
        high=np.array([0.07, 0.113, 0.8, 0.07]),
        prior_deviation=np.array([0.1, 0.02, 0.27, 0.02]),
        identified=np.array([True, True, False, True]),
    )
    return LegSpread(
        way="bootstrap",
        parameters=own,
        draws=np.zeros((7, 4)),
        converged=6,
        low=result.modelled - 1.0,
        high=result.modelled + np.array([2.0, 5.0])[:, None],
        noise=np.array([3.0, 4.0]),
        independent_samples=12.3,
        information=50.0,
    )


@pytest.fixture
def run(subject, result, spread, tmp_path):
    write_run([(subject, result)], tmp_path / "run", spreads=[spread])
    return tmp_path / "run"


def test_dataset(spread):
    own = spread_dataset(spread.parameters, spread.way).sel(parameter="soleus_l.emg_scale")
    assert (float(own["sd"]), float(own["low"]), bool(own["identified"])) == (0.25, 0.1, False)
    assert own["unit"].item() == "1" and own.attrs["way"] == "bootstrap"


def test_uncertainty_columns_are_appended(run, subject, result, tmp_path):
    with (run / "parameters.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[-3:] == ["sd", "low_90", "high_90"]
    cells = {(row["owner"], row["parameter"]): (row["sd"], row["low_90"], row["high_90"]) for row in rows}
    assert cells["soleus_l", "emg_scale"] == ("0.25", "0.1", "0.8")
    assert cells["iliacus_l", "optimal_fiber_length"] == ("0.002", "0.107", "0.113")
    assert cells["iliacus_l", "pennation_angle"] == ("", "", "")  # was not free
    write_run([(subject, result)], tmp_path / "plain")
    plain = (tmp_path / "plain" / "parameters.csv").read_text().splitlines()
    asked = (run / "parameters.csv").read_text().splitlines()
    assert [line.rsplit(",", 3)[0] for line in asked] == plain
    assert not (tmp_path / "plain" / "uncertainty.json").exists()
    assert "uncertainty" not in json.loads((tmp_path / "plain" / "summary.json").read_text())


def test_content_of_the_uncertainty_file(run):
    short = json.loads((run / "summary.json").read_text())["uncertainty"]
    assert short == {
        "way": "bootstrap",
        "draws": 7,
        "converged_draws": 6,
        "independent_samples": 12.3,
        "parameters": 4,
        "identified": 3,
    }
    content = json.loads((run / "uncertainty.json").read_text())
    assert content["not_identified"] == ["soleus_l.emg_scale"]
    assert content["by_parameter"]["iliacus_l.emg_scale"] == {
        "value": 0.05,
        "unit": "1",
        "sd": 0.01,
        "low_90": 0.05,
        "high_90": 0.07,
        "sd_without_moments": 0.1,
        "identified": True,
        "at_bound": True,
    }
    assert content["moments"]["ankle_angle_l"] == {"noise_sd_Nm": 4.0, "band_half_width_Nm": 3.0}


def test_bands_of_every_cycle_are_stored(run, result, spread):
    for trial, stem in enumerate(("slow", "walk_02", "fast")):
        bands = read_storage(run / "moment_bands" / f"{stem}.sto")
        assert bands.columns[1] == "ankle_angle_l_moment_low_90"
        assert bands.columns[2] == "hip_flexion_l_moment_high_90"
        np.testing.assert_array_equal(bands.values.T[:2], spread.low[trial])
        np.testing.assert_array_equal(bands.values.T[2:], spread.high[trial])


def test_report_has_a_section_on_uncertainty_only_if_requested(run, subject, result):
    page = (run / "report.html").read_text()
    assert "reduce the uncertainty of 3 of 4 free parameters" in page and "1 of them did not converge" in page
    assert "Parameters that the moments do not identify" in page
    summary, settings = (json.loads((run / f"{name}.json").read_text()) for name in ("summary", "settings"))
    assert "Uncertainty" not in render_report(subject, result, summary, settings)


def test_intervals_are_drawn_between_the_bounds(result, spread):
    figure = interval_figure(result, spread, kinds_of(result, spread)["muscle"])
    scale, fiber = figure.axes
    segments = [bar.get_segments() for bar in fiber.collections]
    # Bounds of iliacus' fiber length are 0.06 and 0.14 m.
    np.testing.assert_allclose(segments[1][0][:, 0], [(0.107 - 0.06) / 0.08, (0.113 - 0.06) / 0.08])
    np.testing.assert_allclose(segments[0][0][:, 0], [(0.11 - 0.0329 - 0.06) / 0.08, 1.0])
    rings = [line for line in scale.get_lines() if line.get_markerfacecolor() == "white"]
    np.testing.assert_allclose(rings[0].get_xdata(), [(1.0 / 3.0 - 0.05) / 0.95])
    assert "<svg" in to_svg(figure)


def test_bands_include_the_modelled_moments(result, spread):
    figure = band_figure(result, spread)
    assert len(figure.axes) == 4
    points = figure.axes[2].collections[0].get_paths()[0].vertices
    modelled = result.modelled[:2, 1].mean(axis=0)
    assert points[:, 1].min() == pytest.approx(modelled.min() - 1.0)
    assert points[:, 1].max() == pytest.approx(modelled.max() + 5.0)
