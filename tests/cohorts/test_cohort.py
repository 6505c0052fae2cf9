"""Cohorts: complete folders by subject, failures that do not stop other subjects, and resuming."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import wrapjax.cohorts.cohort
from tests.calibration.test_two_legs import scale_moments
from tests.cli.conftest import run
from tests.cli.folders import content, read_json
from tests.subject.synthetic import write_subject
from wrapjax.cli.report import redraw
from wrapjax.cohorts.cohort import cohort
from wrapjax.cohorts.scheduling import Finished
from wrapjax.errors import InputError, Problem


def run_sequentially(work, jobs, **options):
    """Run jobs in this process; other processes are tested in ``test_scheduling.py``."""
    for name, job in jobs.items():
        yield Finished(name, work(job))


@pytest.fixture
def in_this_process(monkeypatch):
    """Run jobs in this process."""
    patch_scheduling(monkeypatch)


def patch_scheduling(patch):
    patch.setattr("wrapjax.cohorts.cohort.run_jobs", run_sequentially)
    patch.setattr(wrapjax.cohorts.cohort, "set_up_jax", lambda: None)


@pytest.fixture(scope="module")
def subjects(tmp_path_factory) -> list[Path]:
    """Two subjects that can be calibrated, one of them with larger moments, and one that cannot be read."""
    place = tmp_path_factory.mktemp("subjects")
    folders = [write_subject(place / name) for name in ("anna", "broken", "ben")]
    (folders[1] / "model.osim").unlink()
    scale_moments(folders[2], 1.3)
    return folders


@pytest.fixture(scope="module")
def done(subjects, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch_scheduling(patch)
        return cohort(subjects, tmp_path_factory.mktemp("cohorts") / "out", diagnose=True, starts=1)


def test_an_unreadable_subject_does_not_stop_the_others(done, subjects):
    states = {name: own["state"] for name, own in done.content["subjects"].items()}
    assert states == {"anna": "done", "broken": "failed", "ben": "done"}
    (said,) = done.failed.values()
    assert str(subjects[1]) in said and "model.osim" in said and said.endswith(".")
    assert not (done.folder / "broken").exists()
    assert not done.complete


def test_folders_have_the_files_of_the_commands(done):
    for name in ("anna", "ben"):
        own = done.content["subjects"][name]
        summary = read_json(done.folder / name / "calibration" / "summary.json")
        assert own["mae_Nm"] == summary["mae_Nm"] and own["converged"] is summary["converged"] is True
        # Two cycles are too few to separate repeatable error from noise.
        assert own["diagnosis"]["outcome"] == "insufficient_data"
        assert read_json(done.folder / name / "diagnosis" / "gap.json")["outcome"] == "insufficient_data"
        for report in (own["report"], own["diagnosis_report"]):
            assert (done.folder / report).is_file()
    assert sorted(path.name for path in done.folder.iterdir()) == [
        "anna",
        "ben",
        "cohort.json",
        "report.html",
    ]


def test_population_statistics(done):
    assert read_json(done.folder / "cohort.json") == json.loads(json.dumps(done.content))
    population = done.content["population"]
    assert (population["n"], population["converged"], population["failed"]) == (2, 2, 1)
    assert population["outcomes"] == {"insufficient_data": 2} and population["named"] == {}
    for use in ("calibration", "validation"):
        own = [done.content["subjects"][name]["mae_Nm"][use] for name in ("anna", "ben")]
        # Left and right legs are pooled: names have no side.
        assert list(population["mae_Nm"][use]) == ["hip_flexion", "knee_angle", "mean"]
        values = np.array([one["knee_angle_l"] for one in own])
        assert population["mae_Nm"][use]["knee_angle"] == pytest.approx(
            {
                "n": 2,
                "mean": values.mean(),
                "sd": abs(values[1] - values[0]) / np.sqrt(2.0),
                "min": values.min(),
                "median": values.mean(),
                "max": values.max(),
            }
        )


def test_the_report_names_failures_and_is_rendered_again(done):
    page = (done.folder / "report.html").read_bytes()
    text = page.decode()
    assert "2 of 3 subjects completed" in text and "1 subject failed:" in text and "model.osim" in text
    assert 'href="anna/calibration/report.html"' in text and 'href="ben/diagnosis/report.html"' in text
    (done.folder / "report.html").unlink()
    assert redraw(done.folder) == done.folder / "report.html"
    assert (done.folder / "report.html").read_bytes() == page


def test_resuming_computes_only_missing_or_changed_subjects(
    in_this_process, done, subjects, tmp_path, monkeypatch
):
    place = shutil.copytree(done.folder, tmp_path / "out")
    (place / ".anna-torn").mkdir()  # Left by a killed worker.
    moved = [Path(shutil.copytree(one, tmp_path / "moved" / one.name)) for one in subjects]
    before = content(place)
    calculated = []

    def calculate(subject, *arguments, **options):
        calculated.append(subject.folder.name)
        raise InputError(Problem(subject.name, "stopped by the test"))

    monkeypatch.setattr("wrapjax.calibration.calibration.cached_calibration", calculate)
    again = cohort(moved, place, diagnose=True, starts=1, resume=True)
    assert not (place / ".anna-torn").exists()
    assert calculated == [] and list(again.failed) == ["broken"]
    for name in ("anna", "ben"):
        kept, own = again.content["subjects"][name], done.content["subjects"][name]
        assert kept | {"folder": ""} == own | {"folder": ""}
    assert content(place)["anna/subject.json"] == before["anna/subject.json"]
    # Results are not reused if a file or a setting has changed.
    scale_moments(moved[0], 1.01)
    assert list(cohort(moved, place, diagnose=True, starts=1, resume=True).failed) == ["anna", "broken"]
    assert calculated == ["anna"]
    assert list(cohort(moved[2:], place, diagnose=True, starts=2, resume=True).failed) == ["ben"]
    assert calculated == ["anna", "ben"]


def test_resuming_a_finished_cohort_starts_no_workers(done, subjects, tmp_path, monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("workers were started")
        yield

    monkeypatch.setattr("wrapjax.cohorts.cohort.run_jobs", started)
    place = shutil.copytree(done.folder, tmp_path / "out")
    again = cohort(subjects[::2], place, diagnose=True, starts=1, resume=True)
    for name in ("anna", "ben"):
        kept, own = again.content["subjects"][name], done.content["subjects"][name]
        assert kept | {"folder": ""} == own | {"folder": ""}
    assert again.complete is False and again.failed == {}  # Too few cycles, as before.


def test_existing_folders_are_not_changed(in_this_process, done, subjects, tmp_path):
    with pytest.raises(InputError, match="--resume, or replace all of it with --force"):
        cohort(subjects, done.folder)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious.txt").write_text("mine")
    for options in ({}, {"force": True}, {"resume": True}):
        with pytest.raises(InputError, match="is no folder of a cohort"):
            cohort(subjects, tmp_path / "mine", **options)
    assert (tmp_path / "mine" / "precious.txt").read_text() == "mine"


def test_subjects_with_the_same_name_are_refused(in_this_process, subjects, tmp_path):
    null_replicate = write_subject(tmp_path / "Anna")
    with pytest.raises(InputError, match="would have the same folder in the result"):
        cohort([*subjects, null_replicate], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_worker_reports_errors(subjects, tmp_path):
    outcome = run("cohort", subjects[1], "--out", tmp_path / "out", "--workers", "1")
    assert outcome.status == 1
    assert "broken" in outcome.output and "model.osim" in outcome.output
    assert "Traceback" not in outcome.progress
    assert read_json(tmp_path / "out" / "cohort.json")["subjects"]["broken"]["state"] == "failed"


def test_a_full_disk_is_reported_and_results_are_kept(in_this_process, subjects, tmp_path, monkeypatch):
    from wrapjax.report import cohort_page

    written = []

    def write(content, place, write=cohort_page.write_content):
        written.append(place)
        if len(written) == 3:
            raise OSError(28, "No space left on device", str(place / "cohort.json"))
        write(content, place)

    monkeypatch.setattr(cohort_page, "write_content", write)
    place = tmp_path / "out"
    outcome = run("cohort", subjects[0], subjects[2], "--out", place, "--starts", "1")
    assert outcome.status == 2
    assert f"{place / 'cohort.json'}: No space left on device; continue with --resume" in outcome.progress
    assert "nothing was written" not in outcome.progress
    assert read_json(place / "cohort.json")["subjects"]["anna"]["state"] == "done"


@pytest.mark.slow
def test_command_with_worker_processes(subjects, tmp_path):
    outcome = run("cohort", *subjects, "--out", tmp_path / "out", "--starts", "1", "--workers", "2")
    assert outcome.status == 1
    assert "anna" in outcome.output and "failed: " in outcome.output and "Traceback" not in outcome.progress
    found = read_json(tmp_path / "out" / "cohort.json")["subjects"]
    assert [own["state"] for own in found.values()] == ["done", "failed", "done"]
