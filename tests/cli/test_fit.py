"""``wrapjax fit``: printed table and output folder."""

import json

import numpy as np

from tests.cli.conftest import run
from tests.cli.folders import COORDINATES, MUSCLES, names, read_json
from tests.subject.synthetic import write_subject
from wrapjax.cli.fit import THRESHOLDS


def test_fit_prints_a_table_and_its_folder(fitted):
    outcome, folder = fitted
    assert outcome.status == 0
    assert "recfem_l" in outcome.output and f"written to {folder}" in outcome.output
    assert f"open {folder / 'report.html'} in a browser" in outcome.output


def test_fit_folder_has_the_documented_files(fitted):
    _, folder = fitted
    assert names(folder) == ["fit.json", "fit.npz", "motion.html", "report.html", "settings.toml"]
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]
    content = read_json(folder / "fit.json")
    assert content["schema"] == 1
    assert content["wraps"] == {} and all(seconds >= 0.0 for seconds in content["seconds"].values())
    assert list(content["muscles"]) == MUSCLES
    for errors in content["muscles"].values():
        assert errors["wrapped"] is False
        # Straight muscles over two pins: the polynomial follows them to a hundredth of a millimeter.
        assert 0.0 < errors["length_rmse_mm"] <= errors["length_max_mm"] < 0.01
        assert 0.0 < errors["moment_arm_rmse_mm"] <= errors["moment_arm_max_mm"] < 0.05
    with np.load(folder / "fit.npz") as arrays:
        assert arrays["muscles"].tolist() == MUSCLES and arrays["coordinates"].tolist() == COORDINATES


def test_fit_again_comes_from_the_cache(run, subject, fitted, tmp_path, monkeypatch):
    def analyse(*arguments, **options):
        raise AssertionError("the cache was not used")

    monkeypatch.setattr("wrapjax.path_sources.path_fitting.analyse_muscles", analyse)
    outcome = run("fit", subject, "--out", tmp_path / "fit", "--json", "--quiet")
    assert (outcome.status, outcome.progress) == (0, "")
    assert json.loads(outcome.output) == read_json(tmp_path / "fit" / "fit.json")
    again, first = (read_json(folder / "fit.json") for folder in (tmp_path / "fit", fitted[1]))
    # Where the subject is, from the folder of each fit.
    assert (tmp_path / "fit" / again.pop("subject_folder")).resolve() == subject.resolve()
    assert (fitted[1] / first.pop("subject_folder")).resolve() == subject.resolve()
    assert again == first


def test_thresholds_are_settings(run, subject, fitted, tmp_path):
    """Thresholds of physiological paths are options; the defaults in the help are those of the fit."""
    defaults = read_json(fitted[1] / "fit.json")["thresholds"]
    assert list(defaults) == list(THRESHOLDS)
    assert all(f"(default: {defaults[name]:g})" in what for name, what in THRESHOLDS.items())
    arguments = ("--out", tmp_path / "fit", "--length-step", "0.002", "--variability", "4", "--quiet")
    assert run("fit", subject, *arguments).status == 0
    expected = defaults | {"length_step": 0.002, "variability": 4.0}
    assert read_json(tmp_path / "fit" / "fit.json")["thresholds"] == expected
    assert "length_step = 0.002" in (tmp_path / "fit" / "settings.toml").read_text()
    settings = ("--settings", tmp_path / "fit" / "settings.toml")
    assert run("fit", subject, "--out", tmp_path / "again", *settings, "--quiet").status == 0
    assert read_json(tmp_path / "again" / "fit.json")["thresholds"] == expected
    refused = run("fit", subject, "--out", tmp_path / "no", "--length-step", "-1")
    assert refused.status == 2 and "expected a number above 0, found '-1'" in refused.progress


def test_seed_determines_the_poses(run, subject, fitted, tmp_path):
    """Another seed gives another fit; the same seed gives the same digits with and without the cache."""
    for seed, name in ((0, "same"), (1, "other")):
        arguments = ("--out", tmp_path / name, "--seed", seed, "--threads", "1", "--quiet")
        assert run("fit", subject, *arguments).status == 0
    same, other = (read_json(tmp_path / name / "fit.json") for name in ("same", "other"))
    first = read_json(fitted[1] / "fit.json")
    assert same["key"] == first["key"] != other["key"]
    assert same["muscles"] == first["muscles"] != other["muscles"]


def test_progress_is_not_printed_with_the_result(run, subject, tmp_path):
    """The seed is used by no other test, so that the cache is empty."""
    arguments = ("--out", tmp_path / "fit", "--seed", "6", "--threads", "1", "--json")
    outcome = run("fit", subject, *arguments)
    assert outcome.status == 0
    assert "OpenSim muscle analysis" in outcome.progress
    assert json.loads(outcome.output) == read_json(tmp_path / "fit" / "fit.json")


def test_quiet_also_silences_opensim(run, subject, tmp_path, capfd):
    """OpenSim writes directly to the process's streams, bypassing Python."""
    arguments = ("--out", tmp_path / "fit", "--seed", "5", "--threads", "1", "--quiet", "--json")
    outcome = run("fit", subject, *arguments)
    assert (outcome.status, outcome.progress) == (0, "")
    assert capfd.readouterr() == ("", "")


def test_threads_are_set_for_every_library(subject, run, monkeypatch):
    """Thread counts are set before JAX is loaded, because the command line does not import it."""
    for variable in ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(variable, "7")
    seen = {}

    def read(folder):
        import os

        seen.update(os.environ)
        raise KeyboardInterrupt

    monkeypatch.setattr("wrapjax.subject.subject.load_subject", read)
    run("check", subject, "--threads", "3")
    assert {seen[name] for name in ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")} == {"3"}


def test_a_missing_folder_of_bones_is_named_before_anything_is_fitted(tmp_path):
    subject, out = write_subject(tmp_path / "synthetic"), tmp_path / "fit"
    outcome = run("fit", subject, "--out", out, "--bones", tmp_path / "nowhere")
    assert (
        outcome.status == 2
        and "nowhere: expected a folder of bones' surfaces, found none" in outcome.progress
    )
    assert not out.exists()
