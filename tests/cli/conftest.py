"""Fixtures that run commands in this process, and a small subject with its fit and calibration."""

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
    """Exit status of a command, and what it printed."""

    status: int
    output: str
    progress: str


@contextlib.contextmanager
def settings_restored():
    """Restore settings that a command changes in its process: thread counts and the compilation cache."""
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
        except SystemExit as stopped:  # argparse exits after wrong usage or --help.
            status = stopped.code
    return Outcome(status, output.getvalue(), progress.getvalue())


@pytest.fixture(name="run", scope="session")
def _run():
    return run


@pytest.fixture(scope="session")
def subject(tmp_path_factory) -> Path:
    """Folder of a subject with two muscles, two coordinates and three cycles. Read-only."""
    return write_subject(tmp_path_factory.mktemp("subjects") / "synthetic")


@pytest.fixture(scope="session")
def fitted(subject, tmp_path_factory) -> tuple[Outcome, Path]:
    """Outcome of ``fit`` and its folder. Read-only."""
    folder = tmp_path_factory.mktemp("fits") / "fit"
    return run("fit", subject, "--out", folder, "--threads", "1"), folder


@pytest.fixture(scope="session")
def calibrated(subject, fitted, tmp_path_factory) -> tuple[Outcome, Path]:
    """Outcome of ``calibrate --fit`` and its folder. Read-only."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    return run("calibrate", subject, "--method", "NGA", "--fit", fitted[1], "--out", folder), folder
