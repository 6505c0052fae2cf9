"""``wrapjax fetch``: list of recordings, download and error messages."""

import json

import pytest

from tests.cli.folders import content
from tests.cli.test_check import assert_only_errors


def test_list(run):
    outcome = run("fetch", "--list")
    assert outcome.status == 0
    assert [line.split(":")[0] for line in outcome.output.splitlines()] == [
        "healthy_overground",
        "healthy_treadmill",
    ]
    assert list(json.loads(run("fetch", "--list", "--json").output)) == [
        "healthy_overground",
        "healthy_treadmill",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [((), "expected a recording"), (("healthy_overgrond",), "did you mean 'healthy_overground'?")],
)
def test_unknown_name(run, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    outcome = run("fetch", *words)
    assert outcome.status == 2 and said in outcome.progress
    assert content(tmp_path) == {}


def test_existing_folder_is_refused_before_any_request(run, tmp_path, monkeypatch):
    monkeypatch.setattr("wrapjax.datasets.public_recordings.write_public_subject", None)
    (tmp_path / "healthy_treadmill").mkdir()
    monkeypatch.chdir(tmp_path)
    assert_only_errors(run("fetch", "healthy_treadmill"), "healthy_treadmill")


def test_folder_is_named_like_the_recording(run, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "wrapjax.datasets.public_recordings.write_public_subject",
        lambda recording, place, **how: asked.append((recording.name, str(place), how["force"])),
    )
    monkeypatch.chdir(tmp_path)
    assert run("fetch", "healthy_treadmill").status == 0
    assert run("fetch", "healthy_treadmill", "--out", "there", "--force").status == 0
    assert asked == [("healthy_treadmill", "healthy_treadmill", False), ("healthy_treadmill", "there", True)]
