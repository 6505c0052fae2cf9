"""Execute the notebooks, and store them with their outputs.

``python docs/execute_notebooks.py [NAME.py ...]`` reads the text of each notebook (`notebooks/*.py`) and
writes the `.ipynb` of the same name beside it. The documentation shows the stored outputs; building it
executes nothing.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


def execute(text: Path) -> None:
    """Execute one notebook from its text, and write it beside that."""
    notebook = jupytext.read(text)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TMPDIR"] = folder
        client = NotebookClient(
            notebook, timeout=None, record_timing=False, coalesce_streams=True, kernel_name="python3"
        )
        client.execute(cwd=str(NOTEBOOKS))
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"  # random identifiers would differ at every execution
        cell.metadata = {}
        if cell.cell_type == "code":
            # Progress and warnings of libraries depend on the machine.
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    nbformat.write(notebook, text.with_suffix(".ipynb"))


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(path.name for path in NOTEBOOKS.glob("*.py")):
        execute(NOTEBOOKS / name)
