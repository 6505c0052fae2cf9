"""Every notebook runs without errors, including its own assertions."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


#: Text that each notebook prints after its assertions, and files that it writes.
EXPECTED_OUTPUT = {
    "01_calibrate.py": ("slope by jax.grad", ["run/report.html"]),
    "02_wrapping.py": ("by jax.grad and by differences", ["wrapping_modes.png", "moved_cylinder.png"]),
    "03_diagnosis.py": ("gap.json", ["gap/report.html", "gap/gap.json"]),
}


#: A diagnosis takes minutes; `tests/diagnosis/test_diagnosis.py` runs one with few muscles.
SLOW = {"03_diagnosis.py"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.name, marks=[pytest.mark.slow] if path.name in SLOW else [])
        for path in sorted(NOTEBOOKS.glob("*.py"))
    ],
)
def test_notebook_runs(name, tmp_path):
    # In a separate process, because a notebook configures JAX itself.
    environment = os.environ | {"TMPDIR": str(tmp_path), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(NOTEBOOKS / name)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    text, files = EXPECTED_OUTPUT[name]
    assert text in done.stdout
    assert [file for file in files if not list(tmp_path.glob(f"*/{file}"))] == [], "not written"
