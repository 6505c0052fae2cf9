"""Every notebook runs without errors, including its own assertions, and is stored as it is written."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


#: Text that each notebook prints after its assertions, and files that it writes.
EXPECTED_OUTPUT = {
    "01_calibrate.py": ("slope by jax.grad", ["run/report.html"]),
    "02_wrapping.py": ("by jax.grad and by differences", []),
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


def _cells(text: str) -> list[tuple[bool, str]]:
    """Whether each cell of a script in the percent format is code, and its text."""
    parts = re.split(r"^# %%(.*)\n", text, flags=re.M)[1:]
    cells = []
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        code = "[markdown]" not in title
        prefix = r"^# (?=%)" if code else r"^# ?"
        cells.append((code, re.sub(prefix, "", body.strip(), flags=re.M)))
    return cells


@pytest.mark.parametrize("name", sorted(EXPECTED_OUTPUT))
def test_stored_notebook_is_that_of_the_script(name):
    """``make notebooks`` stores it anew, with its outputs."""
    stored = json.loads((NOTEBOOKS / name).with_suffix(".ipynb").read_text(encoding="utf-8"))["cells"]
    cells = [(cell["cell_type"] == "code", "".join(cell["source"])) for cell in stored]
    assert cells == _cells((NOTEBOOKS / name).read_text(encoding="utf-8"))
    outputs = [output for cell in stored for output in cell.get("outputs", [])]
    assert {output["output_type"] for output in outputs} <= {"stream", "execute_result", "display_data"}
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert EXPECTED_OUTPUT[name][0] in "".join("".join(output.get("text", "")) for output in outputs)
