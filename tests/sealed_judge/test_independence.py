"""The simulator that judges the diagnosis must share no code with it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "sealed_judge"
FILES = sorted(FOLDER.glob("*.py"))
ALLOWED = {
    "__future__", "argparse", "ast", "collections", "concurrent", "contextlib", "copy", "dataclasses",
    "hashlib", "itertools", "json", "typing",
    "numpy", "os", "pathlib", "scipy", "shutil", "sys", "xml",
}  # fmt: skip


def imported(path: Path) -> set[str]:
    """Return the top-level names of absolute imports and the depth of relative ones as dots."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {a.name.split(".")[0] for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level if node.level else (node.module or "").split(".")[0])
    return names


def test_there_are_files() -> None:
    assert len(FILES) > 10


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_imports_only_numpy_scipy_and_itself(path: Path) -> None:
    assert imported(path) <= ALLOWED | {"."}


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_no_dynamic_import(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert "wrapjax" not in source
    assert "importlib" not in source
    assert "__import__" not in source
