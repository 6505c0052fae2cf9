"""The files of a cohort beside its subjects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wrapjax.files import write_json, write_text
from wrapjax.report.cohort.page import render_cohort


def write_content(content: dict[str, Any], folder: Path) -> None:
    """Write ``cohort.json``."""
    write_json(folder / "cohort.json", content)


def write_page(content: dict[str, Any], folder: Path) -> None:
    """Write ``report.html``, of which everything is in ``cohort.json``."""
    write_text(folder / "report.html", render_cohort(content))
