"""Whom benchmarks calibrate."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def default_subject(given: Path | None) -> Iterator[Path]:
    """Give the folder of a subject: the one asked for, a recorded one, or a virtual one made up for now."""
    if given:
        yield given
    elif os.environ.get("WRAPJAX_DATA"):
        yield Path(os.environ["WRAPJAX_DATA"]) / "s1_left"
    else:
        from wrapjax.datasets.virtual_person.subject import write_virtual_subject

        with tempfile.TemporaryDirectory() as folder:
            write_virtual_subject(Path(folder) / "virtual")
            yield Path(folder) / "virtual"
