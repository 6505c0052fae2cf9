"""Tests of the index page: it lists all results below a folder with numbers from their files."""

import json
import re
from html.parser import HTMLParser

import pytest

from wrapjax.cli.report import redraw
from wrapjax.errors import InputError
from wrapjax.report.calibration.run_page import write_run
from wrapjax.report.overview import KINDS, find_results

CONTENT = {
    "fit/fit.json": {"muscles": {"a_l": {"length_rmse_mm": 0.1}, "b_l": {"length_rmse_mm": 0.25}}},
    "deep/er/gap & co/gap.json": {
        "subject": "<p1>",
        "outcome": "tie",
        "named": [],
        "ties": [["cop_offset", "hip_center_offset"]],
        "explainable_share": {"estimate": 0.6},
    },
    "broken/gap.json": {"subject": "p2"},
    "contact/contact.json": {
        "subject": "p3",
        "joints": {"hip": "hip_l", "knee": "knee_l"},
        "runs": [
            {
                "run": "NGA",
                "joints": {
                    "hip": {"peak": {"mean_bodyweights": 5.0}, "first_peak": {"mean_bodyweights": 3.456}},
                    "knee": {"peak": {"mean_bodyweights": 2.0}},
                },
            }
        ],
    },
    "lengths/initialisation.json": {
        "subject": "p4",
        "passive_mae_Nm": {"knee_angle_l": {"before": 2.0, "after": 0.125}},
    },
    "joints/joints.json": {
        "subject": "p5",
        "rms_mm": {"before": 70.0, "after": 10.25, "held_out_before": None, "held_out_after": None},
    },
    "subject/joints.json": {"subject": "p5"},
    ".hidden/fit.json": {},
}


@pytest.fixture
def results(subject, result, tmp_path):
    folder = tmp_path / "all"
    write_run([(subject, result)], folder / "run")
    for name, content in CONTENT.items():
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text(json.dumps(content))
    (folder / "deep/er/gap & co/report.html").write_text("there")
    (folder / "joints/model_joints.osim").write_text("<model/>")
    return folder


def test_every_result_has_its_main_numbers(results):
    found = {one.folder.relative_to(results).as_posix(): one for one in find_results(results)}
    assert list(found) == ["broken", "contact", "deep/er/gap & co", "fit", "joints", "lengths", "run"]
    assert found["fit"].figures == "2 muscles; largest length error 0.25 mm RMSE (b_l)"
    assert found["deep/er/gap & co"].figures == (
        "tie: cop_offset, hip_center_offset; 60 % of the error explainable"
    )
    # The copy in a prepared subject folder is no result of its own.
    assert found["joints"].figures == "markers 70.00 to 10.25 mm"
    assert found["broken"].figures == "gap.json cannot be read"
    assert found["contact"].figures == "first peak at the hip (bodyweights): NGA 3.46"
    assert found["lengths"].figures == (
        "passive moments, mean absolute error (N m): knee_angle_l 2.00 to 0.12"
    )
    mean = {
        use: json.loads((results / "run/summary.json").read_text())["mae_Nm"][use]["mean"]
        for use in ("calibration", "validation")
    }
    assert found["run"].about == "NGA of made_by_hand"
    assert found["run"].figures == (
        f"mean absolute error: calibration {mean['calibration']:.2f} N m, validation "
        f"{mean['validation']:.2f} N m"
    )


def test_page_links_to_existing_reports(results):
    page = redraw(results)
    assert page == results / "index.html"
    links = []

    class Links(HTMLParser):
        def handle_starttag(self, tag, attributes):
            links.extend(value for name, value in attributes if name == "href")

    text = page.read_text()
    Links().feed(text)
    assert links == ["deep/er/gap%20%26%20co/report.html", "run/report.html"]
    assert "&lt;p1&gt;" in text and not re.search(r'(src|href)="(https?:)?//', text)


def test_a_report_that_cannot_be_redrawn_is_unchanged(results):
    before = (results / "run" / "report.html").read_bytes()
    with pytest.raises(
        InputError, match="holds a calibration, whose report shows more than its files contain"
    ):
        redraw(results / "run")
    assert (results / "run" / "report.html").read_bytes() == before
    assert not (results / "run" / "index.html").exists()


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no result"):
        redraw(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        redraw(tmp_path / "nowhere")
    assert list(tmp_path.iterdir()) == []


def test_every_kind_has_an_existing_command():
    from wrapjax.cli.command_line import main

    for kind in KINDS.values():
        with pytest.raises(SystemExit) as stopped:
            main([kind.command, "--help"])
        assert stopped.value.code == 0
