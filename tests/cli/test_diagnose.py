"""``wrapjax diagnose``: result of a diagnosis, and error messages."""

import json

import pytest

from tests.cli.folders import names, read_json
from tests.cli.test_check import assert_only_errors
from wrapjax.diagnosis.effects.catalogue import CATALOGUE

#: Few effects, one start.
QUICK = ("--starts", "1", "--without", *sorted(set(CATALOGUE) - {"joint_damping", "curve_family"}))


@pytest.fixture
def no_work(monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("the command started to work")

    monkeypatch.setattr("wrapjax.diagnosis.diagnosis.cached_calibration", started)
    monkeypatch.setattr("wrapjax.calibration.problem.fit_paths", started)


def test_three_cycles_are_reported_as_insufficient(run, subject, fitted, tmp_path):
    """Partial results are written, and the exit status is 1."""
    out = tmp_path / "gap"
    done = run("diagnose", subject, "--fit", fitted[1], *QUICK, "--out", out)
    assert done.status == 1
    assert "too few" in done.output and f"written to {out}" in done.output
    content = read_json(out / "gap.json")
    assert content["outcome"] == "insufficient_data" and content["named"] == []
    assert sum(effect["probability"] for effect in content["effects"]) == pytest.approx(1.0)
    assert "report.html" in names(out) and any(name.startswith("moments/") for name in names(out))
    again = run("diagnose", subject, "--fit", fitted[1], *QUICK, "--out", out, "--force", "--json", "--quiet")
    assert (again.status, again.progress) == (1, "")
    assert json.loads(again.output)["subject"] == content["subject"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--without", "joint_dampin"), ("joint_dampin", "did you mean 'joint_damping'")),
        (("--out", "{here}"), ("exists already", "--force")),
        (("--fit", "{here}"), ("fit",)),
    ],
)
def test_bad_input_is_refused_before_any_work(run, subject, tmp_path, no_work, arguments, words):
    given = [argument.format(here=tmp_path) for argument in arguments]
    if "--out" not in given:
        given += ["--out", str(tmp_path / "gap")]
    outcome = run("diagnose", subject, *given)
    (line,) = assert_only_errors(outcome, words[0])
    assert all(word in line for word in words)
    assert list(tmp_path.iterdir()) == []


def test_no_subject_is_a_clear_error(run, tmp_path, no_work):
    outcome = run("diagnose", tmp_path / "nobody", "--out", tmp_path / "gap")
    assert_only_errors(outcome, "nobody")


def test_the_catalogue_is_listed_without_a_subject(run):
    done = run("diagnose", "--list")
    assert done.status == 0
    shown = dict(line.split(": ", 1) for line in done.output.splitlines())
    assert shown.keys() == CATALOGUE.keys()
    assert shown["hip_center_offset"] == "the hip's center lies elsewhere than in the model."
