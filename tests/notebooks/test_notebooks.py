"""Every notebook runs from top to bottom, and its own checks hold."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


@pytest.mark.parametrize("name", sorted(path.name for path in NOTEBOOKS.glob("*.py")))
def test_runs(name, tmp_path):
    # In a process of its own: a notebook sets JAX up by itself, as its readers would.
    environment = os.environ | {"TMPDIR": str(tmp_path), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(NOTEBOOKS / name)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "slope by jax.grad" in done.stdout
    assert list(tmp_path.glob("*/run/report.html")), "no report was written"
