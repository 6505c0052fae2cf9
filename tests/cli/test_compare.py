"""``wrapjax compare``: report of a comparison of methods, and error messages."""

import json

import pytest

from tests.cli.folders import content, names, read_json
from tests.cli.test_check import assert_only_errors
from tests.subject.synthetic import write_subject
from tests.subject.test_broken_folders import BROKEN

#: The synthetic leg touches no wrapping surface: LSGA has nothing to free.
METHODS = ("--methods", "NGA,SGA", "--starts", "1", "--threads", "1")


@pytest.fixture(scope="module")
def compared(run, subject, tmp_path_factory):
    """Outcome of ``compare`` and its folder. Read-only."""
    folder = tmp_path_factory.mktemp("comparisons") / "out"
    return run("compare", subject, *METHODS, "--out", folder), folder


@pytest.fixture
def no_work(monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("the command started to work")

    monkeypatch.setattr("wrapjax.comparison.comparison.calibrate", started)


def test_table_and_folder(compared):
    outcome, folder = compared
    assert outcome.status == 0
    for words in ("hip_flexion", "calibration, all speeds", "NGA", "SGA", "±", "Unit of analysis: cycle"):
        assert words in outcome.output, words
    assert f"written to {folder}" in outcome.output
    assert "calibrating synthetic by SGA" in outcome.progress
    assert [path.name for path in folder.parent.iterdir()] == ["out"]


def test_folder_has_the_documented_files(compared):
    _, folder = compared
    found = names(folder)
    for file in ("comparison.json", "means.csv", "tests.csv", "cycles.csv", "report.html"):
        assert file in found
    for method in ("NGA", "SGA"):
        assert f"synthetic/{method}/summary.json" in found
    comparison = read_json(folder / "comparison.json")
    assert comparison["methods"] == ["NGA", "SGA"] and comparison["unit_of_analysis"] == "cycle"
    assert set(comparison["quantities"]) == {
        *("moment_error", "length_change", "moment_arm_change", "muscle_force", "activation", "parameter")
    }


def test_not_converged_is_status_1(run, subject, tmp_path):
    arguments = ("--max-iterations", "1", "--json", "--quiet", "--seed", "0")
    outcome = run("compare", subject, *METHODS, "--out", tmp_path / "out", *arguments)
    assert (outcome.status, outcome.progress) == (1, "")
    comparison = json.loads(outcome.output)
    assert comparison == read_json(tmp_path / "out" / "comparison.json")
    assert not comparison["legs"][0]["runs"]["NGA"]["converged"]


def test_interrupted_then_resumed(run, subject, tmp_path, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("wrapjax.comparison.comparison.calibrate", interrupt)
        outcome = run("compare", subject, *METHODS, "--out", tmp_path / "out")
        assert outcome.status == 1 and "--resume" in outcome.progress
    assert not (tmp_path / "out").exists()
    refused = run("compare", subject, *METHODS, "--out", tmp_path / "out")
    assert refused.status == 2 and "was begun and interrupted" in refused.progress
    assert run("compare", subject, *METHODS, "--out", tmp_path / "out", "--resume", "--quiet").status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


class TestRefused:
    """Refused with an error message and exit status 2; nothing is written or lost."""

    def test_existing_folder(self, run, subject, tmp_path, no_work):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("mine")
        before = content(tmp_path)
        outcome = run("compare", subject, *METHODS, "--out", tmp_path / "out")
        (line,) = assert_only_errors(outcome, tmp_path / "out")
        assert "exists already and is not overwritten; use --force" in line
        assert content(tmp_path) == before

    def test_errors_of_all_subjects_are_reported_together(self, run, subject, tmp_path, no_work):
        for name, fault in (("one", "no model"), ("two", "unknown muscle")):
            BROKEN[fault][0](write_subject(tmp_path / name))
        before = content(tmp_path)
        outcome = run(
            "compare", tmp_path / "one", subject, tmp_path / "two", *METHODS, "--out", tmp_path / "out"
        )
        lines = assert_only_errors(outcome, tmp_path)
        assert any(str(tmp_path / "one") in line for line in lines)
        assert any(str(tmp_path / "two") in line for line in lines)
        assert content(tmp_path) == before

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--methods", "NGA,SGB"), "'SGB' is not known; did you mean 'SGA'?"),
            (("--methods", "NGA"), "expected two or more"),
            (("--methods", "NGA,PGA", "--geometry", "engine"), "no driven muscle touches a wrapping surface"),
            ((), "LSGA frees nothing"),
        ],
    )
    def test_methods(self, run, subject, tmp_path, no_work, options, words):
        outcome = run("compare", subject, *options, "--out", tmp_path / "out", "--quiet")
        assert outcome.status == 2 and words in outcome.progress and outcome.output == ""
        assert outcome.progress.count("\n") == 1
        assert content(tmp_path) == {}

    def test_nothing_to_resume(self, run, subject, tmp_path, no_work):
        outcome = run("compare", subject, *METHODS, "--out", tmp_path / "out", "--resume", "--quiet")
        assert outcome.status == 2 and "no interrupted work" in outcome.progress
        assert content(tmp_path) == {}

    def test_no_subject(self, run, tmp_path):
        assert run("compare", "--out", tmp_path / "out").status == 2


@pytest.mark.slow
def test_a_full_disk_leaves_the_checkpoints(run, subject, tmp_path, monkeypatch):
    """Finished calibrations must not be lost if the report cannot be written."""

    def refuse(*arguments):
        raise OSError(28, "No space left on device", "report.html")

    with monkeypatch.context() as patched:
        patched.setattr("wrapjax.report.comparison.page.render_comparison", refuse)
        outcome = run("compare", subject, *METHODS, "--out", tmp_path / "out", "--quiet")
    assert outcome.status == 2 and "No space left" in outcome.progress
    assert [path.name for path in tmp_path.iterdir()] == [".out.unfinished"]
    assert run("compare", subject, *METHODS, "--out", tmp_path / "out", "--resume", "--quiet").status == 0
