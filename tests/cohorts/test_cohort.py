"""Many subjects: each whole in its folder, one that fails stops no other, what is done stays done."""

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


def one_after_the_other(work, jobs, **options):
    """Do the work here: that of other processes has tests of its own."""
    for name, job in jobs.items():
        yield Finished(name, work(job))


@pytest.fixture
def here(monkeypatch):
    """Do the work in this process."""
    stay(monkeypatch)


def stay(patch):
    patch.setattr("wrapjax.cohorts.cohort.run_jobs", one_after_the_other)
    patch.setattr(wrapjax.cohorts.cohort, "set_up_jax", lambda: None)


@pytest.fixture(scope="module")
def subjects(tmp_path_factory) -> list[Path]:
    """Two that can be calibrated, one with stronger moments, and one between them that cannot be read."""
    place = tmp_path_factory.mktemp("subjects")
    folders = [write_subject(place / name) for name in ("anna", "broken", "ben")]
    (folders[1] / "model.osim").unlink()
    scale_moments(folders[2], 1.3)
    return folders


@pytest.fixture(scope="module")
def done(subjects, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        stay(patch)
        return cohort(subjects, tmp_path_factory.mktemp("cohorts") / "out", diagnose=True, starts=1)


def test_one_that_cannot_be_read_stops_no_other(done, subjects):
    states = {name: own["state"] for name, own in done.content["subjects"].items()}
    assert states == {"anna": "done", "broken": "failed", "ben": "done"}
    (said,) = done.failed.values()
    assert str(subjects[1]) in said and "model.osim" in said and said.endswith(".")
    assert not (done.folder / "broken").exists()
    assert not done.complete


def test_each_folder_holds_what_the_commands_write(done):
    for name in ("anna", "ben"):
        own = done.content["subjects"][name]
        summary = read_json(done.folder / name / "calibration" / "summary.json")
        assert own["mae_Nm"] == summary["mae_Nm"] and own["converged"] is summary["converged"] is True
        # Two cycles are too few to tell what repeats from what does not.
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


def test_population_is_the_textbooks(done):
    assert read_json(done.folder / "cohort.json") == json.loads(json.dumps(done.content))
    population = done.content["population"]
    assert (population["n"], population["converged"], population["failed"]) == (2, 2, 1)
    assert population["outcomes"] == {"insufficient_data": 2} and population["named"] == {}
    for use in ("calibration", "validation"):
        own = [done.content["subjects"][name]["mae_Nm"][use] for name in ("anna", "ben")]
        # Left and right legs are alike: names lose their side.
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


def test_the_page_says_who_failed_and_is_drawn_again_from_numbers(done):
    page = (done.folder / "report.html").read_bytes()
    text = page.decode()
    assert "2 of 3 subjects done" in text and "1 subject failed:" in text and "model.osim" in text
    assert 'href="anna/calibration/report.html"' in text and 'href="ben/diagnosis/report.html"' in text
    (done.folder / "report.html").unlink()
    assert redraw(done.folder) == done.folder / "report.html"
    assert (done.folder / "report.html").read_bytes() == page


def test_resuming_does_only_what_is_missing_or_changed(here, done, subjects, tmp_path, monkeypatch):
    place = shutil.copytree(done.folder, tmp_path / "out")
    (place / ".anna-torn").mkdir()  # what a killed worker leaves
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
    # Other numbers in a file, or another question, and an old answer is worth nothing.
    scale_moments(moved[0], 1.01)
    assert list(cohort(moved, place, diagnose=True, starts=1, resume=True).failed) == ["anna", "broken"]
    assert calculated == ["anna"]
    assert list(cohort(moved[2:], place, diagnose=True, starts=2, resume=True).failed) == ["ben"]
    assert calculated == ["anna", "ben"]


def test_resuming_what_is_done_starts_no_workers(done, subjects, tmp_path, monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("workers were started")
        yield

    monkeypatch.setattr("wrapjax.cohorts.cohort.run_jobs", started)
    place = shutil.copytree(done.folder, tmp_path / "out")
    again = cohort(subjects[::2], place, diagnose=True, starts=1, resume=True)
    for name in ("anna", "ben"):
        kept, own = again.content["subjects"][name], done.content["subjects"][name]
        assert kept | {"folder": ""} == own | {"folder": ""}
    assert again.complete is False and again.failed == {}  # too few cycles, as before


def test_folders_that_are_there_are_not_touched(here, done, subjects, tmp_path):
    with pytest.raises(InputError, match="--resume, or replace all of it with --force"):
        cohort(subjects, done.folder)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious.txt").write_text("mine")
    for options in ({}, {"force": True}, {"resume": True}):
        with pytest.raises(InputError, match="is no folder of a cohort"):
            cohort(subjects, tmp_path / "mine", **options)
    assert (tmp_path / "mine" / "precious.txt").read_text() == "mine"


def test_names_that_meet_are_refused(here, subjects, tmp_path):
    null_replicate = write_subject(tmp_path / "Anna")
    with pytest.raises(InputError, match="would have the same folder in the result"):
        cohort([*subjects, null_replicate], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_process_of_its_own_says_what_is_wrong(subjects, tmp_path):
    outcome = run("cohort", subjects[1], "--out", tmp_path / "out", "--workers", "1")
    assert outcome.status == 1
    assert "broken" in outcome.output and "model.osim" in outcome.output
    assert "Traceback" not in outcome.progress
    assert read_json(tmp_path / "out" / "cohort.json")["subjects"]["broken"]["state"] == "failed"


def test_a_full_disk_says_where_and_keeps_what_is_done(here, subjects, tmp_path, monkeypatch):
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
def test_command_with_processes_of_its_own(subjects, tmp_path):
    outcome = run("cohort", *subjects, "--out", tmp_path / "out", "--starts", "1", "--workers", "2")
    assert outcome.status == 1
    assert "anna" in outcome.output and "failed: " in outcome.output and "Traceback" not in outcome.progress
    found = read_json(tmp_path / "out" / "cohort.json")["subjects"]
    assert [own["state"] for own in found.values()] == ["done", "failed", "done"]
