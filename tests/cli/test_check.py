"""``wrapjax check``: a table of the content, or all errors and exit status 2."""

import json
import os
import subprocess
import sys

import pytest

from tests.subject.synthetic import write_subject
from tests.subject.test_broken_folders import BROKEN


def assert_only_errors(outcome, folder) -> list[str]:
    """Check that a refused command printed only errors, one line each, and return the lines."""
    assert outcome.status == 2
    assert outcome.output == ""
    lines = outcome.progress.splitlines()
    if lines and lines[-1].endswith("problems found; nothing was written."):
        count = int(lines.pop().split()[0])
        assert count == len(lines) > 1
    assert lines
    for line in lines:
        assert line.startswith("error: ") and str(folder) in line, line
        assert line.endswith((".", "?")), line
    return lines


def test_table(run, subject):
    outcome = run("check", subject)
    assert outcome.status == 0
    assert outcome.progress == ""
    for words in ("Subject synthetic", "RecFem", "semiten_l", "walk_a", "knee_angle_l"):
        assert words in outcome.output


def test_json_holds_the_same_cells(run, subject):
    outcome = run("check", subject, "--json")
    assert outcome.status == 0
    tables = json.loads(outcome.output)
    facts = {row["what"]: row["value"] for row in tables["Subject synthetic"]}
    assert facts["mass (kg)"] == 70.0 and facts["calibration cycles"] == 2
    assert [row["trial"] for row in tables["Trials"]] == ["walk_a", "walk_b"]
    assert tables["Trials"][1]["speed (m/s)"] is None  # Not given; NaN is not valid JSON.


@pytest.mark.parametrize("name", BROKEN)
def test_broken_folder(run, tmp_path, name):
    break_it, words = BROKEN[name]
    folder = write_subject(tmp_path / "subject")
    break_it(folder)
    before = sorted(tmp_path.rglob("*"))
    lines = assert_only_errors(run("check", folder), folder)
    # The expected words may be in any of the lines.
    assert [word for word in words if not any(word in line for line in lines)] == []
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("option", ["--json", "--quiet"])
def test_options_do_not_silence_errors(run, tmp_path, option):
    outcome = run("check", tmp_path / "nobody", option)
    assert_only_errors(outcome, tmp_path / "nobody")
    assert "does not exist" in outcome.progress


def test_all_errors_are_reported_together(run, tmp_path):
    folder = write_subject(tmp_path / "subject")
    for name in ("mass in grams", "unknown muscle", "NaN in angles"):
        BROKEN[name][0](folder)
    lines = assert_only_errors(run("check", folder), folder)
    assert len(lines) >= 3


def wrapjax(*arguments, **options) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "wrapjax", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, **options)


def test_as_a_separate_process(subject, tmp_path):
    good = wrapjax("check", subject)
    assert (good.returncode, good.stderr) == (0, "")
    assert "Subject synthetic" in good.stdout
    bad = wrapjax("check", tmp_path)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.startswith(f"error: {tmp_path / 'subject.toml'}: does not exist")
    assert bad.stderr.count("\n") == 1


def test_in_an_ascii_terminal(tmp_path):
    """Batch systems and Windows consoles may have limited encodings, and names may have accents."""
    folder = write_subject(tmp_path / "subject")
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text().replace('"synthetic"', '"Zoë"'), encoding="utf-8")
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    done = wrapjax("check", folder, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Subject Zo" in done.stdout
