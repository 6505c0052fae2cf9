"""An interrupted or killed calibration is resumed from its checkpoints, and leaves no partial run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.subject.synthetic import write_subject
from wrapjax.cli.command_line import main

#: Starts enough that it is still at work when it is stopped.
STARTS = "3"


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    return write_subject(tmp_path_factory.mktemp("subjects") / "synthetic")


def words(subject: Path, run: Path, *more: str) -> list[str]:
    method = ["--method", "SGA", "--starts", STARTS, "--seed", "3"]
    return ["calibrate", str(subject), *method, "--out", str(run), "--quiet", *more]


def checkpoints(run: Path) -> Path:
    return run.with_name(f".{run.name}.unfinished")


def kill_while_running(subject: Path, run: Path) -> None:
    """Start a calibration and kill it as soon as its second start is running."""
    process = subprocess.Popen(
        [sys.executable, "-m", "wrapjax", *words(subject, run)],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    deadline = time.monotonic() + 240.0
    while not (checkpoints(run) / "start_1_stage_1.npz").exists():
        try:
            process.wait(timeout=0.005)
        except subprocess.TimeoutExpired:
            assert time.monotonic() < deadline, "it never began its second start"
        else:
            raise AssertionError(process.stderr.read().decode())
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stderr.close()


@pytest.fixture(scope="module")
def killed(subject, tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "run"
    kill_while_running(subject, run)
    return run


def test_a_killed_run_leaves_no_run_and_is_resumed_to_the_same_optimum(subject, killed, tmp_path, capsys):
    assert not killed.exists()
    assert main(words(subject, killed)) == 2
    assert "--resume" in capsys.readouterr().err
    assert main(words(subject, killed, "--resume")) == 0
    assert [path.name for path in killed.parent.iterdir()] == ["run"]
    undisturbed = tmp_path / "undisturbed"
    assert main(words(subject, undisturbed)) == 0
    ours, theirs = (json.loads((run / "summary.json").read_text()) for run in (killed, undisturbed))
    assert ours["cost"] == pytest.approx(theirs["cost"], rel=1e-10)
    assert ours["starts"] == theirs["starts"] == int(STARTS)
    assert ours["max_constraint_violation"] <= 1e-6
    costs = [[start["cost"] for start in summary["start_costs"]] for summary in (ours, theirs)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


def test_other_settings_are_not_resumed(subject, tmp_path, capsys):
    run = tmp_path / "run"
    kill_while_running(subject, run)
    other = [word if word != "3" else "4" for word in words(subject, run, "--resume")]
    assert main(other) == 2
    assert "other data or settings" in capsys.readouterr().err
    assert checkpoints(run).exists(), "what could still be resumed was thrown away"
    # --force starts again and removes the checkpoints.
    short = [word if word != STARTS else "1" for word in words(subject, run, "--force")]
    assert main(short) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_nothing_to_resume(subject, tmp_path, capsys):
    assert main(words(subject, tmp_path / "run", "--resume")) == 2
    assert "no interrupted work" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_no_muscle_touches_a_surface(subject, tmp_path, capsys):
    """The synthetic leg has no cylinder, so LSGA would be the same as NGA."""
    run = tmp_path / "run"
    assert main(["calibrate", str(subject), "--method", "LSGA", "--out", str(run), "--quiet"]) == 2
    assert "LSGA frees nothing" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
