"""Invalid input or usage: an error message, exit status 2, nothing written, existing files kept."""

import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from jax.errors import JaxRuntimeError

from tests.cli.folders import METHOD, content
from tests.cli.test_check import assert_only_errors
from tests.subject.synthetic import MODEL, write_subject
from tests.subject.test_broken_folders import BROKEN
from wrapjax.cli.command_line import ADD_COMMANDS
from wrapjax.errors import ComputationError


@pytest.fixture
def no_work(monkeypatch):
    """Fail the test if a command starts to work before it refuses."""

    def started(*arguments, **options):
        raise AssertionError("the command started to work")

    for verb in ("path_sources.path_fitting.fit", "calibration.calibration.calibrate"):
        monkeypatch.setattr(f"wrapjax.{verb}", started)


# ---- Broken subjects


@pytest.mark.parametrize(
    "name", ["settings binary", "no model", "unknown muscle", "EMG cut off", "degrees taken for radians"]
)
@pytest.mark.parametrize("command", [("fit",), ("calibrate", *METHOD)], ids=["fit", "calibrate"])
def test_broken_subject_leaves_nothing(run, tmp_path, no_work, command, name):
    folder = write_subject(tmp_path / "subject")
    BROKEN[name][0](folder)
    before = content(tmp_path)
    assert_only_errors(run(*command, folder, "--out", tmp_path / "out"), folder)
    assert content(tmp_path) == before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("/bodyset/tibia_l</socket_parent_frame>", "/bodyset/fibula_l</socket_parent_frame>"),
        ("<socket_child_frame>tibia_l_offset", "<socket_child_frame>tibia_r_offset"),
    ],
    ids=["muscle on no body", "joint to no frame"],
)
def test_model_error_found_by_opensim_leaves_nothing(run, tmp_path, old, new):
    """Loading checks only parts of a model; OpenSim finds other errors when it opens the file."""
    folder = write_subject(tmp_path / "subject")
    assert old in MODEL
    (folder / "model.osim").write_text(MODEL.replace(old, new))
    before = content(tmp_path)
    outcome = run("fit", folder, "--out", tmp_path / "out", "--threads", "1")
    lines = [line for line in outcome.progress.splitlines() if line.startswith("error: ")]
    assert outcome.status == 2 and outcome.output == ""
    assert len(lines) == 1 and str(folder / "model.osim") in lines[0]
    assert "Traceback" not in outcome.progress
    assert content(tmp_path) == before


# ---- Output folders


@pytest.mark.parametrize("command", [("fit",), ("calibrate", *METHOD)], ids=["fit", "calibrate"])
class TestOut:
    def test_existing_folder_is_refused_before_the_work(self, run, subject, tmp_path, no_work, command):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("mine")
        before = content(tmp_path)
        outcome = run(*command, subject, "--out", tmp_path / "out")
        (line,) = assert_only_errors(outcome, tmp_path / "out")
        assert "exists already and is not overwritten; use --force" in line
        assert content(tmp_path) == before

    @pytest.mark.parametrize("options", [(), ("--force",)])
    def test_file_is_never_replaced(self, run, subject, tmp_path, no_work, command, options):
        (tmp_path / "out").write_text("mine")
        assert_only_errors(run(*command, subject, "--out", tmp_path / "out", *options), tmp_path / "out")
        assert content(tmp_path) == {"out": b"mine"}

    def test_folder_under_a_file(self, run, subject, tmp_path, no_work, command):
        (tmp_path / "file").write_text("mine")
        out = tmp_path / "file" / "deep" / "out"
        (line,) = assert_only_errors(run(*command, subject, "--out", out), out)
        assert "cannot be created" in line and f"{tmp_path / 'file'} is a file" in line
        assert content(tmp_path) == {"file": b"mine"}

    def test_folder_in_a_read_only_place(self, run, subject, tmp_path, no_work, monkeypatch, command):
        """The file system's answers are simulated, because an administrator may write anywhere."""

        def refuse(dir: Path) -> None:
            raise OSError(errno.EROFS, "Read-only file system")

        monkeypatch.setattr("os.access", lambda place, mode: False)
        monkeypatch.setattr("tempfile.TemporaryFile", refuse)
        out = tmp_path / "deep" / "out"
        (line,) = assert_only_errors(run(*command, subject, "--out", out), out)
        assert "cannot be created" in line and f"{tmp_path} is not writable (Read-only" in line
        assert content(tmp_path) == {}


def test_full_disk_is_reported(run, subject, fitted, tmp_path, monkeypatch):
    """A full disk leaves no partial folder."""

    def refuse(path, text):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("wrapjax.io.files.write_text", refuse)
    outcome = run("fit", subject, "--out", tmp_path / "out", "--quiet")
    assert outcome.status == 2 and outcome.output == ""
    assert outcome.progress.startswith("error: ") and "No space left on device" in outcome.progress
    assert content(tmp_path) == {}


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "there is not enough memory for this"),
        (JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory"), "there is not enough memory for this"),
        (
            ComputationError("a worker process died: killed, or out of memory"),
            "a worker process died: killed",
        ),
    ],
)
def test_failures_on_valid_input_have_exit_status_1(run, subject, monkeypatch, error, words):
    def fail(folder):
        raise error

    monkeypatch.setattr("wrapjax.subject.subject.load_subject", fail)
    outcome = run("check", subject)
    assert (outcome.status, outcome.output) == (1, "")
    assert outcome.progress.startswith(f"error: {words}") and outcome.progress.count("\n") == 1


def test_interrupting_a_fit_leaves_nothing(run, tmp_path, monkeypatch):
    folder = write_subject(tmp_path / "subject")
    # Another pose, so that the fit is not in the cache.
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text().replace("[0.6, 1.8]", "[0.7, 1.9]"))
    before = content(tmp_path)

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("wrapjax.path_sources.path_fitting.analyse_muscles", interrupt)
    outcome = run("fit", folder, "--out", tmp_path / "out")
    assert (outcome.status, outcome.output) == (1, "")
    assert outcome.progress.splitlines()[-1] == "interrupted; nothing was written."
    assert content(tmp_path) == before


# ---- Unusable fits


def truncate(file: str):
    def damage(fit: Path) -> None:
        whole = (fit / file).read_bytes()
        (fit / file).write_bytes(whole[: len(whole) // 2])

    return damage


def replace(file: str, new: bytes):
    return lambda fit: (fit / file).write_bytes(new)


def change_json(change):
    def damage(fit: Path) -> None:
        values = json.loads((fit / "fit.json").read_text())
        (fit / "fit.json").write_text(json.dumps(change(values)))

    return damage


def change_arrays(change):
    def damage(fit: Path) -> None:
        with np.load(fit / "fit.npz") as stored:
            arrays = dict(stored)
        np.savez(fit / "fit.npz", **change(arrays))

    return damage


DAMAGES = {
    "no folder": shutil.rmtree,
    "no json": lambda fit: (fit / "fit.json").unlink(),
    "no arrays": lambda fit: (fit / "fit.npz").unlink(),
    "json cut off": truncate("fit.json"),
    "json empty": replace("fit.json", b""),
    "json binary": replace("fit.json", bytes(range(128, 256))),
    "json a list": change_json(lambda values: [values]),
    "json without key": change_json(lambda values: {k: v for k, v in values.items() if k != "key"}),
    "json with unknown error": change_json(
        lambda values: {**values, "muscles": {"recfem_l": {"length": 1.0}}}
    ),
    "arrays empty": replace("fit.npz", b""),
    "arrays binary": replace("fit.npz", bytes(range(256)) * 20),
    "arrays text": replace("fit.npz", b"hello"),
    "an array missing": change_arrays(lambda a: {k: v for k, v in a.items() if k != "coefficients"}),
    "no muscle names": change_arrays(lambda a: {k: v for k, v in a.items() if k != "muscles"}),
    "an array too many": change_arrays(lambda a: a | {"extra": np.zeros(3)}),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_fit(run, subject, fitted, tmp_path, name):
    fit = tmp_path / "fit"
    shutil.copytree(fitted[1], fit)
    DAMAGES[name](fit)
    before = content(tmp_path)
    outcome = run("calibrate", subject, *METHOD, "--fit", fit, "--out", tmp_path / "run")
    assert_only_errors(outcome, fit)
    assert content(tmp_path) == before


def other_model(folder: Path) -> None:
    (folder / "model.osim").write_text(MODEL.replace("<location>0.05 ", "<location>0.06 "))


def other_muscles(folder: Path) -> None:
    """Add a third muscle, which the fit does not contain, to the model."""
    start = MODEL.index('<Millard2012EquilibriumMuscle name="semiten_l">')
    end = MODEL.index("</objects>\n<groups>")
    third = MODEL[start:end].replace("semiten_l", "bflh_l")
    (folder / "model.osim").write_text(MODEL[:end] + third + MODEL[end:])
    settings = folder / "subject.toml"
    settings.write_text(settings.read_text().replace('["semiten_l"]', '["semiten_l", "bflh_l"]'))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (other_model, "another model file"),
        (other_muscles, "lacks muscle 'bflh_l'"),
    ],
)
def test_fit_of_another_subject(run, fitted, tmp_path, change, reason):
    folder = write_subject(tmp_path / "subject")
    change(folder)
    outcome = run("calibrate", folder, *METHOD, "--fit", fitted[1], "--out", tmp_path / "run")
    (line,) = assert_only_errors(outcome, fitted[1])
    assert reason in line and "wrapjax fit" in line
    assert not (tmp_path / "run").exists()


# ---- Usage


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "COMMAND"),
        (["calibarte"], "invalid choice: 'calibarte'"),
        (["check"], "SUBJECT"),
        (["check", "a", "b"], "unrecognized arguments: b"),
        (["fit", "a"], "--out"),
        (["fit", "a", "--out", "b", "--geometry", "guess"], "'guess'"),
        (["fit", "a", "--out", "b", "--seed", "one"], "--seed"),
        (["fit", "a", "--out", "b", "--threads", "0"], "a whole number above 0, found '0'"),
        (["fit", "a", "--out", "b", "--threads", "two"], "--threads"),
        (["calibrate", "a", "--out", "b"], "--method"),
        (["calibrate", "a", "--out", "b", "--method", "nga2"], "'nga2'"),
        (["calibrate", "a", "--out", "b", *METHOD, "--max-iterations", "-1"], "above 0"),
        (["calibrate", "a", "--out", "b", *METHOD, "--curves", "hill"], "'hill'"),
    ],
    ids=" ".join,
)
def test_usage(run, arguments, words):
    outcome = run(*arguments)
    assert outcome.status == 2 and outcome.output == ""
    assert words in outcome.progress and "Traceback" not in outcome.progress


@pytest.mark.parametrize("command", [[], ["check"], ["fit"], ["calibrate"], ["demo"]], ids=" ".join)
def test_help(run, command):
    outcome = run(*command, "--help")
    assert outcome.status == 0 and outcome.progress == ""
    assert outcome.output.startswith(" ".join(["usage: wrapjax", *command]))


@pytest.mark.parametrize("command", [add.__module__.rsplit(".", 1)[-1] for add in ADD_COMMANDS])
def test_every_command_takes_the_common_options(run, command):
    """Scripts may pass these options to any command, even where they have no effect."""
    shown = run(command, "--help").output
    for option in ("--seed N", "--threads N", "--quiet", "--json", "--resume", "--force"):
        assert option in shown, option


def test_version(run):
    import wrapjax

    assert run("--version").output == f"wrapjax {wrapjax.__version__}\n"
