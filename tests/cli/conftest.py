"""Commands run in this process, and a small subject that was fitted and calibrated by them once."""

import contextlib
import io
import os
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import jax
import pytest

from tests.subject.synthetic import write_subject
from wrapjax.cli.command_line import main


@dataclass(frozen=True)
class Outcome:
    """What a command left: its exit status and what it printed."""

    status: int
    output: str
    progress: str


@contextlib.contextmanager
def settings_restored():
    """Undo what a command sets for its own process: thread counts and where compiled kernels are kept."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    with mock.patch.dict(os.environ):
        yield
    for name, value in before.items():
        jax.config.update(name, value)


def run(*arguments: object) -> Outcome:
    """Run a command as the console script would."""
    output, progress = io.StringIO(), io.StringIO()
    with settings_restored(), contextlib.redirect_stdout(output), contextlib.redirect_stderr(progress):
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as stopped:  # how argparse ends after a wrong usage, or --help
            status = stopped.code
    return Outcome(status, output.getvalue(), progress.getvalue())


@pytest.fixture(name="run", scope="session")
def _run():
    return run


@pytest.fixture(scope="session")
def subject(tmp_path_factory) -> Path:
    """Two muscles, two coordinates, three cycles; OpenSim opens its model. Not to be changed."""
    return write_subject(tmp_path_factory.mktemp("subjects") / "synthetic")


@pytest.fixture(scope="session")
def fitted(subject, tmp_path_factory) -> tuple[Outcome, Path]:
    """What ``fit`` printed, and its folder. Not to be changed."""
    folder = tmp_path_factory.mktemp("fits") / "fit"
    return run("fit", subject, "--out", folder, "--threads", "1"), folder


@pytest.fixture(scope="session")
def calibrated(subject, fitted, tmp_path_factory) -> tuple[Outcome, Path]:
    """What ``calibrate --fit`` printed, and its folder. Not to be changed."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    return run("calibrate", subject, "--method", "NGA", "--fit", fitted[1], "--out", folder), folder
