"""The files of a comparison beside its runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wrapjax.files import write_json, write_text
from wrapjax.report.comparison.numbers import Row, describe_comparison
from wrapjax.report.comparison.page import render_comparison
from wrapjax.report.comparison.samples import ComparedLeg
from wrapjax.report.comparison.tables import cycles_csv, differences_csv, means_csv


def write_comparison(
    legs: Sequence[ComparedLeg], methods: Sequence[str], rows: Sequence[Row], folder: Path
) -> None:
    """Write ``comparison.json``, ``means.csv``, ``tests.csv``, ``cycles.csv`` and ``report.html``."""
    write_json(folder / "comparison.json", describe_comparison(legs, methods, rows))
    write_text(folder / "means.csv", means_csv(rows))
    write_text(folder / "tests.csv", differences_csv(rows))
    write_text(folder / "cycles.csv", cycles_csv(legs, methods))
    write_text(folder / "report.html", render_comparison(legs, methods, rows))
