"""``wrapjax contact``: contact forces of one or two runs, and error messages."""

import json

import pytest

from tests.cli.folders import content, names, read_json
from tests.cli.test_check import assert_only_errors
from tests.contact_forces.synthetic_run import write_run
from wrapjax.subject.subject import load_subject


@pytest.fixture
def no_work(monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("the command started to work")

    monkeypatch.setattr("wrapjax.contact_forces.contact_force.contact", started)


def test_two_runs(run, subject, tmp_path):
    """The result is written beside the first run, compares both runs, and is available as JSON."""
    person = load_subject(subject)
    nga, pga = write_run(tmp_path / "nga", person), write_run(tmp_path / "pga", person, "PGA", factor=0.8)
    done = run("contact", nga, pga)
    assert done.status == 0
    assert done.output.startswith(
        "This is the contribution of the muscles alone and not the total contact force"
    )
    assert "PGA less NGA" in done.output and f"written to {nga / 'contact'}" in done.output
    assert "lines of action" in done.progress
    found = read_json(nga / "contact" / "contact.json")
    assert found["kind"] == "muscle_share"
    assert [entry["run"] for entry in found["runs"]] == ["NGA", "PGA"]
    assert found["tests"][0]["test"]["difference"] < 0.0
    assert found["knee_compartments"] is None
    assert {"report.html", "forces/PGA/walk_b.sto"} < set(names(nga / "contact"))
    page = (nga / "contact" / "report.html").read_text()
    assert "not the total contact force" in page and "http" not in page.replace("http://www.w3.org", "")

    before = content(nga)
    assert_only_errors(run("contact", nga), nga / "contact")
    assert_only_errors(run("contact", nga, "--out", tmp_path / "out", "--condyle-distance", "40"), "0.12 m")
    assert content(nga) == before
    again = run("contact", nga, "--undriven", "left", "--force", "--json", "--quiet")
    assert (again.status, again.progress) == (0, "")
    assert json.loads(again.output)["tests"] == []


def test_a_run_that_did_not_converge_has_exit_status_1(run, subject, tmp_path):
    folder = write_run(tmp_path / "nga", load_subject(subject), converged=False)
    done = run("contact", folder, "--out", tmp_path / "out")
    assert done.status == 1
    assert "The calibration NGA had not converged, so its forces are not final." in done.output
    assert (tmp_path / "out" / "contact.json").exists()


def test_two_runs_by_one_method_have_distinct_labels(run, subject, tmp_path):
    person = load_subject(subject)
    folders = [write_run(tmp_path / name, person) for name in ("one", "other")]
    done = run("contact", *folders, "--out", tmp_path / "out", "--json")
    assert [entry["run"] for entry in json.loads(done.output)["runs"]] == ["NGA 1 (one)", "NGA 2 (other)"]


def test_bad_input_is_refused_and_leaves_nothing(run, subject, tmp_path, no_work):
    assert_only_errors(run("contact", subject, "--out", subject), subject)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["nowhere", "."])
def test_a_folder_that_is_no_run_is_an_error(run, tmp_path, name):
    folder = tmp_path / name
    before = content(tmp_path)
    assert_only_errors(run("contact", folder), folder)
    assert content(tmp_path) == before
