"""Tests of the report of a fit: muscles with large errors are named, and the page is self-contained."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.report.page import Page
from wrapjax.report.paths.fit_page import error_figure, error_findings, render_fit
from wrapjax.report.paths.fit_wraps import SampledPath


def error(length, arm, *, wrapped=True):
    return {
        "wrapped": wrapped,
        "length_rmse_mm": length,
        "length_max_mm": 3.0 * length,
        "moment_arm_rmse_mm": arm,
        "moment_arm_max_mm": 3.0 * arm,
        "terms": 20,
    }


def cylinder(share, accuracy, passed, *, touched=True):
    return {
        "physiological_share": share,
        "balanced_accuracy": accuracy,
        "false_physiological": passed,
        "learned_balanced_accuracy": accuracy and accuracy - 0.05,
        "learned_false_physiological": passed,
        "translation_m": 0.0075,
        "touched": touched,
    }


PLAIN = {
    "muscles": {
        "psoas_l": error(0.05, 0.2),
        "glmax1_l": error(0.1, 0.95),
        "semimem_l": error(0.3, 0.1),
        "soleus_l": error(1e-5, 1e-4, wrapped=False),
    },
    "touching": ["psoas_l"],
    "geometry": "opensim",
    "seed": 4,
    "seconds": {"analysis": 10.0, "fit": 2.5},
    "wraps": {},
    "wraps_of": None,
    "thresholds": None,
}
SAMPLED = PLAIN | {
    "wraps": {"brim": cylinder(0.6, 0.9, 0.02), "pelvis": cylinder(0.99, None, 1.0, touched=False)},
    "wraps_of": {"psoas_l": ("brim",), "glmax1_l": ("pelvis",), "semimem_l": (), "soleus_l": ()},
    "thresholds": {
        "length_deviation": 0.025,
        "moment_arm_deviation": 0.02,
        "variability": 3.0,
        "length_step": 0.0015,
        "moment_arm_step": 0.003,
    },
}


def sampled_path():
    nominal = 0.3 + 0.01 * np.sin(np.linspace(0.0, 6.0, 20))
    length = nominal + np.array([0.0, 0.001, 0.05])[:, None]
    arms, usual = {"hip": 0.1 * length}, {"hip": 0.1 * nominal}
    return SampledPath("psoas_l", nominal, usual, length, arms, {"jumps": np.array([False, False, True])})


def test_findings_name_muscles_with_unusual_errors():
    first, second = error_findings(PLAIN)
    assert first == (
        "The polynomials approximate the paths of 3 of 4 muscles with the usual accuracy; errors are larger "
        "for glmax1_l."
    )
    assert "Muscles that may wrap (3): length median 0.100 mm, largest 0.300 mm (semimem_l)" in second
    assert "moment arm median 0.200 mm, largest 0.950 mm (glmax1_l)" in second
    assert "Muscles that never wrap (1): length < 0.001 mm, moment arm < 0.001 mm" in second
    good = PLAIN | {"muscles": {"psoas_l": error(0.05, 0.2)}}
    assert error_findings(good)[0].endswith("1 muscle with the usual accuracy.")


def test_a_nan_error_is_unusual():
    assert "psoas_l" in error_findings(PLAIN | {"muscles": {"psoas_l": error(float("nan"), 0.1)}})[0]


def test_figure_shows_the_errors():
    length, arm = error_figure(PLAIN).axes
    for panel, expected in ((length, [0.1, 0.05, 0.3]), (arm, [0.95, 0.2, 0.1])):
        drawn = next(line for line in panel.get_lines() if line.get_label() == "may wrap")
        np.testing.assert_allclose(drawn.get_xdata(), expected)
        assert panel.get_xlim()[1] > max(expected)
    names = [label.get_text() for label in length.get_yticklabels()]
    assert names == ["glmax1_l", "psoas_l", "semimem_l", "soleus_l"]


@pytest.mark.parametrize("content", [PLAIN, SAMPLED])
def test_page_is_valid_self_contained_and_states_methods(content, subject):
    html = render_fit(content, subject, [sampled_path()] if content["wraps"] else [])
    page = Page(html)
    headings = re.findall(r"<h2>(.*?)</h2>", html)
    surfaces = ["Wrapping surfaces", "Accepted and rejected paths"] if content["wraps"] else []
    assert headings == ["Errors by muscle", *surfaces, "Methods"]
    assert not page.all("script") + page.all("link")
    assert all(image["src"].startswith("data:image/svg+xml") for image in page.all("img"))
    assert "http://" not in html and "https://" not in html
    assert "made_by_hand: muscle paths as polynomials" in page.text
    assert "OpenSim's muscle analysis" in page.text and "seed 4" in page.text and "12.5" in page.text


def test_page_shows_cylinders():
    text = Page(render_fit(SAMPLED, None, [sampled_path()])).text
    assert "2 wrapping surfaces were sampled for PGA; muscles touch 1 of them" in text
    assert re.search(r"brim psoas_l yes 7\.5 60\.0 90\.0 2\.0 85\.0 2\.0", text)
    # Nearly all placements are physiological, so the accuracy of the limit cannot be assessed.
    assert re.search(r"pelvis glmax1_l no 7\.5 99\.0( \N{EN DASH}){4}", text)
    assert "psoas_l (brim): 2 of 3 accepted" in text
    assert "length step 1.5 mm" in text


def test_names_cannot_break_the_page(subject):
    name = "<script>alert(1)</script>"
    content = SAMPLED | {
        "muscles": {name: error(0.5, 0.9)},
        "touching": [name],
        "wraps_of": {name: ("brim",)},
    }
    page = Page(render_fit(content, replace(subject, name=name), [replace(sampled_path(), muscle=name)]))
    assert not page.all("script")
    assert f"{name}: muscle paths" in page.text
