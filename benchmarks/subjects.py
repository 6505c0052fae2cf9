"""Subject that the benchmarks calibrate."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def add_subject_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--subject``, the folder for `default_subject`."""
    parser.add_argument(
        "--subject",
        type=Path,
        metavar="DIR",
        help="subject folder (default: $WRAPJAX_DATA/s1_left if set, otherwise a virtual subject)",
    )


@contextmanager
def default_subject(given: Path | None) -> Iterator[Path]:
    """Return the subject folder given, or ``$WRAPJAX_DATA/s1_left``, or a temporary virtual subject."""
    if given:
        yield given
    elif os.environ.get("WRAPJAX_DATA"):
        yield Path(os.environ["WRAPJAX_DATA"]) / "s1_left"
    else:
        from wrapjax.datasets.virtual_person.virtual_subject import write_virtual_subject

        with tempfile.TemporaryDirectory() as folder:
            write_virtual_subject(Path(folder) / "virtual")
            yield Path(folder) / "virtual"
