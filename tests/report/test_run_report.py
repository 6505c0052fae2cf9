"""Tests of the report of a calibration: self-contained and valid HTML, with the findings in sentences."""

import base64
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import pytest

from tests.report.page import Page
from tests.report.solutions import with_solution
from wrapjax.calibration.solvers.interface import Status
from wrapjax.model.freedom import Freedom
from wrapjax.report.calibration.run_page import render_report, run_findings
from wrapjax.report.calibration.run_summary import summarize
from wrapjax.report.provenance import describe_settings


def _render(subject, result):
    return render_report(
        subject, result, summarize(subject, result), describe_settings(subject, result, Path("run"))
    )


def test_page_is_valid_with_sections_in_order(subject, result):
    page = Page(_render(subject, result))
    headings = re.findall(r"<h2>(.*?)</h2>", _render(subject, result))
    assert headings == [
        "Moment errors",
        "Joint moments",
        "Drive of the muscles",
        "Muscle activations",
        "Fiber lengths",
        "Muscle parameters",
        "Starts",
        "Solver",
        "Notes",
    ]
    assert page.all("html") == [{"lang": "en"}]


def test_page_is_self_contained_without_scripts(subject, result):
    text = _render(subject, result)
    page = Page(text)
    assert not page.all("script") + page.all("link") + page.all("iframe")
    for _, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "style"):
            assert attributes.get(name, "data:").startswith("data:")
    assert "http://" not in text and "https://" not in text
    assert "url(" not in text and "@import" not in text
    assert len(text) < 3_000_000


def test_figures_are_valid_svg_with_descriptions(subject, result):
    page = Page(_render(subject, result))
    images = page.all("img")
    assert len(images) == 6 == len(page.all("figcaption"))
    for image in images:
        assert len(image["alt"]) > 40
        kind, data = image["src"].split(",", 1)
        assert kind == "data:image/svg+xml;base64"
        drawing = ElementTree.fromstring(base64.b64decode(data))
        assert drawing.tag == "{http://www.w3.org/2000/svg}svg"
        references = [
            value
            for element in drawing.iter()
            for name, value in element.attrib.items()
            if name.endswith("href")
        ]
        assert references and all(reference.startswith("#") for reference in references)


def test_equal_results_give_equal_pages(subject, result):
    summary, settings = summarize(subject, result), describe_settings(subject, result, Path("run"))
    assert render_report(subject, result, summary, settings) == render_report(
        subject, result, summary, settings
    )


def test_findings_state_errors_and_bounds(result, subject):
    outcome, errors, bounds = run_findings(result, summarize(subject, result))
    assert outcome == "The calibration converged."
    assert "2.50 N m on average over 2 calibration cycles (before calibration: 20.00 N m)" in errors
    assert "1 validation cycle, held out from calibration, they differ by 6.00 N m" in errors
    assert bounds.startswith("2 of the 4 free parameters ended on a bound")


def test_findings_of_a_calibration_that_did_not_converge(subject, result):
    stopped = replace(with_solution(result, status=Status.iterations), at_bounds=())
    text = Page(_render(subject, stopped)).text
    assert "did not converge" in text and "limit on iterations" in text
    assert "The calibration converged" not in text
    assert "None of the 4 free parameters ended on a bound" in text


def test_missing_validation_is_stated(subject, without_validation):
    page = Page(_render(subject, without_validation))
    assert "No cycles were held out for validation" in page.text
    assert "validation: MAE" not in page.text


def test_tables_contain_errors_parameters_at_bounds_and_undriven_muscles(subject, result):
    text = Page(_render(subject, result)).text
    assert re.search(r"ankle_angle_l \S+ 20\.00 20\.00 3\.00 6\.48 7\.00 7\.00", text.replace("  ", " "))
    assert re.search(r"emg_scale lower 1 iliacus_l", text)
    assert re.search(r"optimal_fiber_length upper 1 soleus_l", text)
    assert "2 muscles of this leg's model without EMG, which exert no force here: piri_l, sart_l." in text
    assert "negative values were set to 0 in calf" in text


def test_muscles_outside_the_expected_fiber_lengths_are_named(subject, result):
    swapped = replace(result, states=result.initial_states)  # 1.4 and more
    assert "iliacus_l, soleus_l leave this range" in Page(_render(subject, swapped)).text
    assert "all muscles stay within this range" in Page(_render(subject, result)).text


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", "a & b", "\"quoted\" 'name'", "Zoë $\\x$"])
def test_names_cannot_break_the_page(name, subject, result):
    hostile = replace(
        subject, name=name, notes=(name,), trials=replace(subject.trials, channels=(name, "calf"))
    )
    muscles = replace(subject.muscles, names=(name, "soleus_l"))
    hostile = replace(hostile, muscles=muscles)
    page = Page(_render(hostile, replace(result, method=name, muscles=muscles.names)))
    assert not page.all("script")
    assert f"{name}: {name} calibration" in page.text


def test_report_of_a_cost_that_is_not_finite(subject, not_finite):
    text = Page(_render(subject, not_finite)).text
    assert "did not converge" in text and "not finite at the start" in text
    assert "nan" not in text.lower().split()


def test_report_without_free_parameters(subject, result):
    held = replace(result, freedom=Freedom("nothing", ()), at_bounds=())
    assert "No parameter was free." in Page(_render(subject, held)).text


def test_importing_the_package_or_the_report_does_not_import_matplotlib():
    code = (
        "import sys, wrapjax, wrapjax.report.calibration.run_page; "
        "print(sorted({'matplotlib', 'opensim', 'pandas', 'sklearn'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
