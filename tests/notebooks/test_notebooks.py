"""Every notebook runs from top to bottom, and its own checks hold."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


#: What each says once its own checks have held, and what it leaves behind.
ENDINGS = {
    "01_calibrate.py": ("slope by jax.grad", ["run/report.html"]),
    "02_wrapping.py": ("by jax.grad and by differences", ["wrapping_modes.png", "moved_cylinder.png"]),
    "03_gap.py": ("gap.json", ["gap/report.html", "gap/gap.json"]),
}


#: A diagnosis takes minutes; `tests/diagnosis/test_diagnosis.py` runs one of few muscles.
SLOW = {"03_gap.py"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.name, marks=[pytest.mark.slow] if path.name in SLOW else [])
        for path in sorted(NOTEBOOKS.glob("*.py"))
    ],
)
def test_runs(name, tmp_path):
    # In a process of its own: a notebook sets JAX up by itself, as its readers would.
    environment = os.environ | {"TMPDIR": str(tmp_path), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(NOTEBOOKS / name)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    words, files = ENDINGS[name]
    assert words in done.stdout
    assert [file for file in files if not list(tmp_path.glob(f"*/{file}"))] == [], "not written"
